"""Metrics of a labelled survey and of tables with one row per split."""

import numpy as np
import pandas as pd

from mlsroad_pipeline.hooks.run_records import label_metrics, stage_metrics

SUMMARY = {
    "n_points": 1000,
    "n_files": 2,
    "classes": {"road": 600, "pole/sign": 200, "unlabelled": 200},
    "confidence": {"median": 0.9, "low_share": 0.1, "class_medians": {"road": 0.95, "car": float("nan")}},
    "objects": {"pole": 3, "tree": 4},
    "warnings": ["no CRS"],
    "unusual": ["points lie 0.9 m apart", "the intensity has 3 distinct values"],
}


def test_counts_shares_confidences_and_speed_become_metrics():
    assert label_metrics(SUMMARY, 4.0) == {
        "points": 1000, "files": 2, "seconds": 4, "points_per_second": 250, "warnings": 1, "objects": 7,
        "confidence/median": 0.9, "confidence/low_share": 0.1, "confidence/median/road": 0.95,
        "points/road": 600, "points/pole_sign": 200, "points/unlabelled": 200,
        "share/road": 0.6, "share/pole_sign": 0.2, "share/unlabelled": 0.2,
        "objects/pole": 3, "objects/tree": 4, "unusual_properties": 2,
    }  # fmt: skip


def test_a_survey_without_labelled_points_has_no_shares_and_no_confidences():
    confidence = {"median": None, "low_share": None, "class_medians": {}}
    summary = {**SUMMARY, "classes": {}, "objects": {}, "confidence": confidence}
    assert set(label_metrics(summary, 1.0)) == {
        "points", "files", "seconds", "points_per_second", "warnings", "objects", "unusual_properties",
    }  # fmt: skip


def test_a_table_of_a_stage_gives_metrics_per_split():
    table = pd.DataFrame({"split": ["train", "test"], "kappa": [0.9, np.nan], "n_ground": [5, 7], "note": ["a", "b"]})
    assert stage_metrics(table, "ground") == {
        "train/ground/kappa": 0.9, "train/ground/n_ground": 5, "test/ground/n_ground": 7,
    }  # fmt: skip
    scores = pd.DataFrame({"kind": ["pole", "tree"], "f_score": [0.75, np.nan], "true": [4, 2]})
    assert stage_metrics(scores, "objects") == {
        "pole/objects/f_score": 0.75,
        "pole/objects/true": 4,
        "tree/objects/true": 2,
    }
