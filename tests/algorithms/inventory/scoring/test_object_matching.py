"""Matching of inventories with true objects: brute force, planted outcomes, scores and errors worked out by hand."""

import itertools

import numpy as np
import pandas as pd
import pytest

from mlsroad_pipeline.algorithms.geometry.assignment import assign_one_to_one
from mlsroad_pipeline.algorithms.inventory.scoring.object_scores import (
    errors_of_measures,
    match_objects,
    precision_recall_curve,
    score_objects,
    summarise_measures,
)


def best_by_trial(found, true, reach):
    """Return the largest number of pairs and the least sum of distances with it, over all assignments."""
    gap = np.hypot(*(found[:, None] - true).transpose(2, 0, 1))
    best = (0, 0.0)
    for size in range(1, min(gap.shape) + 1):
        for rows in itertools.combinations(range(len(found)), size):
            for columns in itertools.permutations(range(len(true)), size):
                pairs = gap[rows, columns]
                if (pairs <= reach).all() and (size > best[0] or pairs.sum() < best[1]):
                    best = (size, pairs.sum())
    return best


@pytest.mark.parametrize("seed", range(8))
def test_the_assignment_has_most_pairs_and_least_distance(seed):
    rng = np.random.default_rng(seed)
    found, true = rng.uniform(0, 2.5, (5, 2)), rng.uniform(0, 2.5, (4, 2))
    a, b = assign_one_to_one(found, true, 1.0)
    assert len(set(a)) == len(a) and len(set(b)) == len(b)
    gap = np.hypot(*(found[a] - true[b]).T)
    assert (gap <= 1.0).all()
    assert (len(a), round(gap.sum(), 9)) == (
        best_by_trial(found, true, 1.0)[0],
        round(best_by_trial(found, true, 1.0)[1], 9),
    )


def table(**columns):
    return pd.DataFrame({"y": 0.0, **columns})


OBJECTS = table(
    object_id=[1, 2, 3, 4, 5, 6],
    kind=["pole", "pole", "pole", "sign", "vehicle", "vehicle"],
    score=[0.9, 0.8, 0.4, 0.6, 0.7, 0.5],
    x=[0.0, 10.6, 20.0, 30.3, 40.0, 52.0],
    height=[5.0, 6.0, 7.0, 3.0, 1.5, 1.6],
    facing=[np.nan, np.nan, np.nan, 350.0, np.nan, np.nan],
    facing_from=["", "", "", "unknown", "", ""],
)
TRUTH = table(
    kind=["pole", "pole", "tree", "sign", "vehicle", "vehicle"],
    x=[0.2, 10.0, 20.3, 30.0, 40.9, 50.0],
    height=[5.5, 6.0, 9.0, 3.0, 1.5, 1.5],
    length=[np.nan, np.nan, np.nan, np.nan, 4.0, 4.0],
    counted=[True, True, True, True, True, False],
    facing=[np.nan, np.nan, np.nan, 168.0, np.nan, np.nan],
)


def test_planted_outcomes():
    matched = match_objects(OBJECTS, TRUTH)
    assert matched.objects["outcome"].tolist() == ["right", "false", "false", "right", "right", "ignored"]
    assert matched.objects["true_kind"].tolist() == ["", "", "tree", "", "", ""]
    assert matched.truth["outcome"].tolist() == ["found", "missed", "missed", "found", "found", "ignored"]
    wider = match_objects(OBJECTS, TRUTH, reach={"pole": 0.7})
    assert wider.objects["outcome"].tolist()[:2] == ["right", "right"]


def test_objects_outside_of_the_truth_are_ignored_unless_they_match():
    matched = match_objects(OBJECTS.assign(inside=False), TRUTH)
    assert matched.objects["outcome"].tolist() == ["right", "ignored", "ignored", "right", "right", "ignored"]


def test_scores_of_planted_outcomes():
    scores = score_objects(match_objects(OBJECTS, TRUTH), recall_only=["tree"]).set_index("kind")
    assert scores.loc["pole", ["true", "found", "listed", "right", "false"]].tolist() == [2, 1, 3, 1, 2]
    assert scores.loc["pole", ["precision", "recall", "f_score"]].tolist() == pytest.approx([1 / 3, 1 / 2, 0.4])
    assert scores.loc["pole", "calibration_error"] == pytest.approx((0.1 + 0.8 + 0.4) / 3)
    assert scores.loc["tree", ["true", "recall"]].tolist() == [1, 0.0]
    assert scores.loc["tree", ["precision", "f_score"]].isna().all()
    assert scores.loc["all", ["true", "right", "false", "ignored"]].tolist() == [4, 3, 2, 1]


def test_the_curve_is_matched_anew_at_each_threshold():
    curve = precision_recall_curve(OBJECTS, TRUTH)
    pole = curve[curve["kind"] == "pole"]
    assert pole["least_score"].tolist() == [0.4, 0.8, 0.9]
    assert pole["precision"].tolist() == pytest.approx([1 / 3, 1 / 2, 1.0])
    assert pole["recall"].tolist() == pytest.approx([0.5, 0.5, 0.5])


def test_errors_of_measures():
    errors = errors_of_measures(match_objects(OBJECTS, TRUTH)).set_index("object_id")
    assert errors.loc[1, ["position", "height"]].tolist() == pytest.approx([0.2, -0.5])
    assert errors.loc[4, "facing"] == pytest.approx(2.0)  # of an unknown side: modulo 180 degrees
    summary = summarise_measures(errors.reset_index()).set_index(["kind", "measure"])
    assert summary.loc[("vehicle", "position"), ["n", "median"]].tolist() == pytest.approx([1, 0.9])
    assert summary.loc[("sign", "facing"), "unit"] == "deg"


def test_nothing_listed_and_nothing_true():
    nothing = match_objects(OBJECTS.head(0), TRUTH)
    assert set(nothing.truth["outcome"]) == {"missed", "ignored"}
    assert match_objects(OBJECTS, TRUTH.head(0)).objects["outcome"].eq("false").all()
    assert score_objects(nothing).set_index("kind").loc["pole", "recall"] == 0.0
