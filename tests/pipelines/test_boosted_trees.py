"""Boosted trees from scenes to scores, and through `label`."""

import laspy
import numpy as np
import pandas as pd
import pytest
from helpers.labelled import check_labels
from helpers.wiring import TINY, copied_stages, label, run, session_of

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
SLUG = "boosted_trees"


def test_they_are_trained_scored_and_used_by_label(shared, tmp_path):
    project = copied_stages(shared, tmp_path / "project")
    run(project, to_nodes=[f"score_{SLUG}"], **{**TINY, SLUG: {"rounds": 10, "min_child_samples": 5}})
    report = project / "data/08_reporting"
    scores = pd.read_csv(report / f"scores/{SLUG}.csv").set_index(["split", "class", "metric"])["value"]
    assert scores["test", "all", "overall_accuracy"] > 0.8
    assert not (project / f"data/06_models/{SLUG}_checkpoints").exists()  # removed at the end of the training
    with session_of(project, **TINY) as session:
        bundle = session.load_context().catalog.load(f"{SLUG}.registered_model")
    assert bundle.metadata["attributes"] == ["intensity"]
    assert len(bundle.arrays["n_leaves"]) == 10 * len(bundle.classes)
    [survey] = (project / "data/01_raw").rglob("test/*.laz")
    labelled = laspy.read(label(project, survey, tmp_path / "labelled", method=SLUG) / survey.name)
    codes, _ = check_labels(labelled, laspy.read(survey).header.point_count)
    assert len(np.unique(codes)) >= 3
