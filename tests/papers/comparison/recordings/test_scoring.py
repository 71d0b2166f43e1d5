"""Scores of labelled recordings on hand-checked points."""

import numpy as np
import pandas as pd
import pytest
from helpers.conf import base

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.papers.comparison.recordings.parameters import StudyParameters, sources_of
from mlsroad_pipeline.papers.comparison.recordings.plan import Run, StudyPlan
from mlsroad_pipeline.papers.comparison.recordings.preparation import labelled_for, model_arrays, stored_model
from mlsroad_pipeline.papers.comparison.recordings.report import markdown_tables, summary
from mlsroad_pipeline.papers.comparison.recordings.results import shown_rows, study_tables
from mlsroad_pipeline.papers.comparison.recordings.scoring import score_points, unmixed

SCHEME = ClassScheme.from_config("common", base("classes")["schemes"]["common"])
GROUND, BUILDING, VEGETATION, POLE, SIGN = SCHEME.labels_of(["ground", "building", "vegetation", "pole", "sign"])


def test_a_pole_on_a_facade_is_right_where_buildings_hold_poles():
    truth = np.array([BUILDING, BUILDING, GROUND, BUILDING])
    label = np.array([POLE, VEGETATION, POLE, SIGN])
    changed = unmixed(truth, label, SCHEME, {"building": ["pole", "sign"]})
    assert changed.tolist() == [BUILDING, VEGETATION, POLE, BUILDING]
    assert unmixed(truth, label, SCHEME, {}).tolist() == label.tolist()


def test_ignored_points_count_neither_as_right_nor_as_wrong():
    truth, label = np.array([GROUND, GROUND, -1, BUILDING]), np.array([GROUND, BUILDING, GROUND, -1])
    found = score_points(truth, label, np.array([0.95, 0.95, 0.1, 0.0]), len(SCHEME))
    assert found["matrix"].sum() == 3
    assert found["matrix"][GROUND, GROUND] == 1
    assert found["bin_counts"].sum() == 3
    assert found["bin_hits"].sum() == 1
    assert found["auroc"] == pytest.approx(0.75)  # right 0.95; wrong 0.95 and 0


def test_labels_for_other_recordings_leave_out_mixed_classes_and_own_ones_the_test_part():
    names = ["road", "building", "post", "road"]
    cloud = PointCloud(
        np.zeros((4, 3)),
        {"label": np.array([TAXONOMY[name] for name in names], np.uint8), "part": np.array([1, 1, 2, 0], np.uint8)},
    )
    ((_, uses),) = labelled_for(cloud, SCHEME, ["building"])
    encoded = {use: SCHEME.encode(part["label"]).tolist() for use, part in uses.items()}
    assert encoded == {"whole": [GROUND, -1, POLE, GROUND], "own": [GROUND, BUILDING, -1, -1]}


def test_a_model_is_stored_without_loss():
    bundle = ModelBundle("patch_svm", {"a": np.arange(3)}, {"classes": ["x", "y"], "attributes": []})
    again = stored_model(model_arrays(bundle))
    assert again.slug == bundle.slug
    assert again.metadata == bundle.metadata
    assert again.arrays["a"].tolist() == [0, 1, 2]


@pytest.fixture
def plan():
    fields = {"files": "*", "coding": "oakland", "scanner": "S", "licence": "L", "test": {"azimuth": 0, "offset": 0}}
    config = {"toy": {**fields, "title": "Toy", "classes": ["ground", "building", "pole"]}}
    study = StudyParameters(**{**base("recordings_study"), "root": "/none", "sources": config, "least_points": 3})
    return StudyPlan(study, sources_of(config), {}, SCHEME, {})


def result(truth, label, confidence):
    points = score_points(np.array(truth), np.array(label), np.array(confidence), len(SCHEME))
    times = {"points": np.array(len(truth)), "seconds": np.array(4.0), "cpu_seconds": np.array(2.0)}
    return {"all": points, "test": points, "times": times, "finished": {"date": np.array("2026-11-26 03:00")}}


def test_means_are_over_the_classes_of_the_recording_that_have_points(plan):
    truth = [GROUND] * 4 + [BUILDING] * 4 + [POLE] * 2 + [VEGETATION] * 4  # vegetation is no class of the recording
    label = [GROUND] * 4 + [BUILDING] * 2 + [GROUND] * 2 + [POLE] * 2 + [VEGETATION] * 4
    tables = study_tables(plan, {"general.shipped.toy": result(truth, label, [0.5] * 14)}, {"sparse.shipped": {}})
    row = tables["benchmark"].iloc[0]
    assert row["iou_ground"] == pytest.approx(4 / 6)
    assert row["iou_building"] == pytest.approx(2 / 4)
    assert "iou_pole" not in row  # 2 points, at least 3
    assert row["mean_iou"] == pytest.approx((4 / 6 + 2 / 4) / 2)
    assert row["overall_accuracy"] == pytest.approx(12 / 14)
    assert row["calibration_error"] == pytest.approx(12 / 14 - 0.5)
    assert row["cpu_seconds_per_million"] == pytest.approx(2e6 / 14)
    scores = tables["scores"].set_index(["split", "class", "metric"])["value"]
    assert scores["toy/shipped/all", "all", "mean_iou"] == pytest.approx(row["mean_iou"])
    assert len(tables["reliability"]) == 30


def test_reports_show_the_test_part_only_of_runs_that_saw_the_rest(plan):
    truth = [GROUND] * 4 + [BUILDING] * 4
    found = result(truth, truth, [0.9] * 8)
    results = {"general.shipped.toy": found, "patch_svm.own.toy": {k: v for k, v in found.items() if k != "all"}}
    tables = study_tables(plan, results, {"patch_svm.own.toy": {"cpu_seconds": np.array(7.0)}})
    shown = shown_rows(tables["benchmark"])
    assert list(zip(shown["method"], shown["part"], strict=True)) == [("general", "all"), ("patch_svm", "test")]
    assert shown["train_cpu_seconds"].tolist()[1] == 7.0
    text = markdown_tables(plan, tables["benchmark"])
    assert "| general | shipped | 1.00 |" in text
    assert "**Toy** (S, L)" in text
    told = summary(plan, tables["benchmark"])
    assert len(told["runs"]) == 3
    assert told["sources"]["toy"]["classes"] == ["ground", "building", "pole"]
    assert pd.DataFrame(told["runs"])["mean_iou"].tolist() == [1.0, 1.0, 1.0]
    assert Run("patch_svm", "own", "toy").key in results
