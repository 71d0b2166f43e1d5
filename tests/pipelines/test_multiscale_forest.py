"""The multiscale forest from scenes to scores, and through `label`."""

import laspy
import numpy as np
import pandas as pd
import pytest
from helpers.labelled import check_labels
from helpers.wiring import TINY, copied_stages, label, run, session_of

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
SLUG = "multiscale_forest"


def test_it_is_trained_scored_and_used_by_label(shared, tmp_path):
    project = copied_stages(shared, tmp_path / "project")
    own = {"radius": 0.2, "n_scales": 6, "n_trees": 10, "max_per_scene": 200}
    run(project, to_nodes=[f"score_{SLUG}"], **{**TINY, SLUG: own})
    scores = pd.read_csv(project / f"data/08_reporting/scores/{SLUG}.csv")
    scores = scores.set_index(["split", "class", "metric"])["value"]
    assert scores["test", "all", "overall_accuracy"] > 0.7
    with session_of(project, **TINY) as session:
        bundle = session.load_context().catalog.load(f"{SLUG}.registered_model")
    assert bundle.metadata["attributes"] == ["intensity", "rgb"] and bundle.metadata["training_facts"]
    [survey] = (project / "data/01_raw").rglob("test/*.laz")
    labelled = laspy.read(label(project, survey, tmp_path / "labelled", method=SLUG) / survey.name)
    codes, _ = check_labels(labelled, laspy.read(survey).header.point_count)
    assert len(np.unique(codes)) >= 3
