"""Segments against reference instances, by closed forms and brute force."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.metrics.instances import find_overlaps, score_segmentation


def brute_force(instances, segments, threshold=0.5):
    """Coverage, weighted coverage, precision and recall by sets."""
    truth = {i: set(np.flatnonzero(instances == i)) for i in np.unique(instances) if i != 0}
    found = {s: set(np.flatnonzero(segments == s)) for s in np.unique(segments) if s != -1}
    objects = set().union(*truth.values())
    judged = {s: points for s, points in found.items() if 2 * len(points & objects) > len(points)}
    best = {i: max((len(t & f) / len(t | f) for f in found.values()), default=0.0) for i, t in truth.items()}
    hits = sum(len(t & f) / len(t | f) > threshold for t in truth.values() for f in judged.values())
    weight = {i: len(t) for i, t in truth.items()}
    return (
        np.mean(list(best.values())),
        sum(best[i] * weight[i] for i in best) / sum(weight.values()),
        hits / len(judged),
        hits / len(truth),
    )


@pytest.mark.parametrize("seed", range(6))
def test_equals_brute_force(seed):
    rng = np.random.default_rng(seed)
    truth = np.repeat(rng.integers(0, 7, 40), 12)
    found = np.where(rng.random(480) < 0.75, truth, rng.integers(-1, 9, 480)).astype(np.int32)
    scores = score_segmentation(truth, found)
    assert (scores.coverage, scores.weighted_coverage, scores.precision, scores.recall) == pytest.approx(
        brute_force(truth, found)
    )


def test_perfect_split_and_merged_segments():
    truth = np.repeat([1, 2, 3], 10)
    perfect = score_segmentation(truth, truth + 40)
    assert (perfect.coverage, perfect.precision, perfect.recall) == (1.0, 1.0, 1.0)
    assert (perfect.over_segmentation, perfect.under_segmentation) == (0.0, 0.0)
    halves = score_segmentation(truth, np.repeat(np.arange(6), 5))
    assert (halves.coverage, halves.recall, halves.over_segmentation, halves.under_segmentation) == (0.5, 0.0, 1.0, 0.0)
    joined = score_segmentation(truth, np.repeat([0, 1], [20, 10]))
    assert joined.under_segmentation == 0.5 and joined.over_segmentation == 0.0
    assert joined.recall == pytest.approx(1 / 3)  # an IoU of exactly a half is no match
    crumbs = score_segmentation(truth, np.concatenate([np.zeros(9, int), [1], np.repeat([2, 3], 10)]))
    assert crumbs.over_segmentation == pytest.approx(1 / 3)


def test_background_counts_to_segments_but_segments_of_it_are_not_judged():
    truth = np.array([0] * 10 + [1] * 10)
    scores = score_segmentation(truth, np.array([5] * 10 + [6] * 10))
    assert (scores.precision, scores.n_segments) == (1.0, 1)
    leaking = score_segmentation(truth, np.array([-1] * 5 + [6] * 15))
    assert leaking.coverage == pytest.approx(10 / 15)


def test_small_instances_and_segments_are_left_out():
    truth, found = np.array([1] * 10 + [2] * 2), np.array([1] * 10 + [2, 3])
    scores = score_segmentation(truth, found, min_points=3)
    assert (scores.n_instances, scores.n_segments, scores.recall) == (1, 1, 1.0)


def test_nothing_found_or_nothing_there():
    nothing = score_segmentation([1, 1, 2], [-1, -1, -1])
    assert nothing.coverage == 0.0 and nothing.recall == 0.0 and np.isnan(nothing.precision)
    empty = score_segmentation([0, 0], [1, 1])
    assert np.isnan(empty.coverage) and np.isnan(empty.recall) and empty.n_segments == 0


def test_order_of_points_and_names_do_not_matter(rng):
    truth, found = rng.integers(0, 5, 300), rng.integers(-1, 6, 300)
    order = rng.permutation(300)
    names = rng.permutation(6) + 100
    renamed = np.where(found < 0, -1, names[found])
    assert score_segmentation(truth, found) == score_segmentation(truth[order], renamed[order])


def test_bad_input():
    with pytest.raises(DataError, match=r"instances have shape \(2,\), segments \(3,\)"):
        find_overlaps([1, 2], [1, 2, 3])
    with pytest.raises(DataError, match=r"segments .*got float64"):
        find_overlaps([1, 2], [1.0, 2.0])
    with pytest.raises(ParameterError, match=r"iou_threshold .*got 0\.3"):
        score_segmentation([1], [1], iou_threshold=0.3)
