"""Plan of the scenes: scattered points are refused before the labelling."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.algorithms.scenes.splits import SplitPart
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.surveys.files import SurveyFile
from mlsroad_pipeline.surveys.plan import plan_pass, plan_survey


def planned(tmp_path, counts):
    file = SurveyFile(str(tmp_path / "damaged.las"), "damaged.las", "", None)
    ingest = IngestParameters()
    plan = plan_survey({"survey": [file]}, {"survey": SplitPart()}, options=ReadOptions(), labels=False, ingest=ingest)
    key = f"{plan.files[0].key}"
    step = 20 * round(ingest.scene_length / ingest.bin_length)
    bins = np.arange(len(counts), dtype=np.int32) * step
    piece = str(SceneKey.parse(key)._replace(part=f"{0:012d}"))
    return plan_pass(plan.files[0].pass_key, plan, {piece: {"bins": bins, "counts": np.array(counts)}}, ingest)


def test_scattered_points_are_refused(tmp_path):
    with pytest.raises(DataError, match=r"damaged\.las: 600 points would become 600 scenes"):
        planned(tmp_path, [1] * 600)


def test_few_or_filled_scenes_are_planned(tmp_path):
    assert len(planned(tmp_path, [1] * 30)) == 30
    assert len(planned(tmp_path, [5000] * 60)) == 60
