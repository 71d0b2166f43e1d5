"""Modules that a command or a worker must not load; `make lint` checks the import contracts of the layers."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

from helpers.page_output import write_output

REPOSITORY = Path(__file__).resolve().parents[1]
SOURCE = REPOSITORY / "src"
ORCHESTRATION = {"kedro", "kedro_datasets", "kedro_mlflow", "mlflow"}
HEAVY = ["torch", "open3d", "mlflow", "distributed", "tensorflow", "IPython", "plotly"]


def environment():
    return {**os.environ, "PYTHONPATH": str(SOURCE)}


def loaded_by(statement):
    code = f"{statement}\nimport json, sys; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], env=environment(), capture_output=True, text=True, check=True
    )
    return set(json.loads(done.stdout.splitlines()[-1]))


LABEL = (
    "execution.worker", "surveys.reading", "label.joined_objects", "label.written_file", "algorithms.stages",
    "papers.tomic2019.detrended_forest.labeller", "pipelines.label", "pipelines.ingest",
)  # fmt: skip
"""Modules that label a survey."""


def test_what_labels_a_survey_loads_nothing_heavy_that_it_does_not_use():
    loaded = loaded_by("import " + ", ".join(f"mlsroad_pipeline.{module}" for module in LABEL))
    assert sorted(set(HEAVY) & loaded) == []


def test_algorithms_load_no_orchestration_by_way_of_another_package():
    loaded = loaded_by("import mlsroad_pipeline.label.scene, mlsroad_pipeline.papers.shared.evaluation")
    assert sorted(ORCHESTRATION & loaded) == []


LABELLED = """
import numpy as np
from mlsroad_pipeline.algorithms.models.labelling import label_softly
from mlsroad_pipeline.model_store.shipped_models import load_shipped
from mlsroad_pipeline.label.warm_up import run_stages, small_street
run_stages()
labels = label_softly(load_shipped("pool"), small_street()).labels
assert (labels >= 0).all()
"""


def test_labelling_with_the_default_model_does_not_load_pytorch():
    assert sorted(set(HEAVY) & loaded_by(LABELLED)) == []


def test_the_light_installation_is_a_part_of_the_whole_one_without_what_labelling_does_not_load():
    locks = (Path(name).read_text() for name in ("requirements.lock", "requirements-label.lock"))
    whole, light = ({*re.findall(r"^[\w.-]+==\S+", text.lower().replace("_", "-"), re.M)} for text in locks)
    assert len(light) > 50 and light <= whole
    assert not {pin.partition("==")[0] for pin in light} & {*HEAVY, "dask"}


FIRST_PICTURE = """
from pathlib import Path
from mlsroad_pipeline.review.page_server import server
from mlsroad_pipeline.review.page_server.output_folder import OutputFolder
from mlsroad_pipeline.review.page_server.served_survey import ServedSurvey
survey = ServedSurvey(OutputFolder.find(Path({folder!r})), user="ann")
assert survey.survey()["lines"] and survey.first.chunk
"""


def test_the_first_picture_of_the_page_does_not_wait_for_tables_and_kernels(tmp_path):
    write_output(tmp_path)
    loaded = loaded_by(FIRST_PICTURE.format(folder=str(tmp_path)))
    assert sorted({"pandas", "scipy", "numba", "shapely", "pyarrow"} & loaded) == []
