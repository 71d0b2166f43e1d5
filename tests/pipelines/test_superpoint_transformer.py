"""The superpoint transformer from scenes to scores, and through `label`."""

import laspy
import numpy as np
import pandas as pd
import pytest
from helpers.labelled import check_labels
from helpers.wiring import TINY, copied_stages, label, run, session_of

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
SLUG = "superpoint_transformer"


def test_it_is_trained_scored_and_used_by_label(shared, tmp_path):
    project = copied_stages(shared, tmp_path / "project")
    own = {"augmentation": {"cuts": 1}, "training": {"n_steps": 30, "batch_size": 2, "crop": 8.0}}
    run(project, to_nodes=[f"score_{SLUG}"], **{**TINY, SLUG: own})
    report = project / "data/08_reporting"
    scores = pd.read_csv(report / f"scores/{SLUG}.csv").set_index(["split", "class", "metric"])["value"]
    assert scores["test", "all", "overall_accuracy"] > 0.5
    losses = pd.read_csv(report / f"{SLUG}_objective.csv")["loss"]
    assert len(losses) == 30 and losses[-5:].mean() < losses[:5].mean()
    assert not (project / f"data/06_models/{SLUG}_checkpoints").exists()  # removed at the end of the training
    with session_of(project, **TINY) as session:
        bundle = session.load_context().catalog.load(f"{SLUG}.registered_model")
    assert bundle.metadata["attributes"] == ["rgb", "intensity"]
    assert bundle.metadata["trained_on"]["graphs"] == 2 * bundle.metadata["trained_on"]["scenes"]
    [survey] = (project / "data/01_raw").rglob("test/*.laz")
    labelled = laspy.read(label(project, survey, tmp_path / "labelled", method=SLUG) / survey.name)
    codes, _ = check_labels(labelled, laspy.read(survey).header.point_count)
    assert len(np.unique(codes)) >= 3
