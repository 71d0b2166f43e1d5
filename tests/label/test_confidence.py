"""Confidences of a labelled survey: table and warnings."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.models.familiarity import KINDS
from mlsroad_pipeline.label.confidence import (
    confidence_table,
    confidence_warnings,
    count_confidences,
    ground_warnings,
)
from mlsroad_pipeline.label.result_warnings import spread_scenes, unfamiliar_warnings

CLASSES = ["road", "tree", "sign", "wire"]


def counts_of(label, confidence):
    return count_confidences(np.asarray(label, np.int16), np.asarray(confidence, np.float32), len(CLASSES))


def test_table_has_the_medians_and_shares_of_numpy(rng):
    label, confidence = rng.integers(-1, 3, 20_000), rng.random(20_000).astype(np.float32)
    halves = [counts_of(label[part], confidence[part]) for part in (slice(0, 7000), slice(7000, None))]
    table = confidence_table(np.sum(halves, axis=0), CLASSES)
    assert table["class"].tolist() == ["road", "tree", "sign", "all"]  # no point is a wire
    for name, points, median, share in table.itertuples(index=False):
        mine = confidence[label >= 0 if name == "all" else label == CLASSES.index(name)]
        assert points == len(mine)
        assert median == pytest.approx(np.median(mine), abs=0.011)
        assert share == pytest.approx((mine < 0.5).mean(), abs=0.0006)


def test_ends_of_the_scale_are_counted():
    counts = counts_of([0, 0, 0, -1], [0.0, 1.0, 0.999, 1.0])
    assert counts[0, 0] == 1 and counts[0, -1] == 2 and counts.sum() == 3


@pytest.mark.parametrize(("n_low", "warned"), [(0, False), (1990, False), (2000, True), (10_000, True)])
def test_a_fifth_of_points_with_low_confidence_gives_a_warning(n_low, warned):
    confidence = np.where(np.arange(10_000) < n_low, 0.3, 0.9)
    label = (
        np.arange(10_000) % 2
    )  # both classes alike, so that a class alone is named only where all have low confidence
    found = confidence_warnings(confidence_table(counts_of(label, confidence), CLASSES))
    assert any("of the points have a confidence below 0.5" in text for text in found) == warned


def test_a_class_of_low_median_confidence_is_named_unless_it_is_tiny():
    label = np.repeat([0, 1, 2], [50_000, 1200, 900])
    confidence = np.repeat([0.9, 0.4, 0.2], [50_000, 1200, 900])
    (found,) = confidence_warnings(confidence_table(counts_of(label, confidence), CLASSES))
    assert found == "Classes with a median confidence below 0.5: tree (0.41)."


def test_a_survey_without_labelled_points_has_no_warning():
    table = confidence_table(counts_of([-1, -1], [0, 0]), CLASSES)
    assert table["points"].tolist() == [0]
    assert confidence_warnings(table) == []


@pytest.mark.parametrize(("n_ground", "warned"), [(0, True), (499, True), (500, False), (10_000, False)])
def test_a_survey_without_ground_is_warned_of(n_ground, warned):
    label = np.where(np.arange(10_000) < n_ground, 0, 1)
    is_ground = np.array([True, False, False, False])
    found = ground_warnings(counts_of(label, np.full(10_000, 0.95)), is_ground)
    assert [text.split(" of the points are ground")[0] for text in found] == [f"{n_ground / 10_000:.1%}"] * warned


def test_few_points_and_schemes_without_ground_have_no_warning_of_ground():
    few = counts_of([1] * 500, [0.9] * 500)
    many = counts_of([1] * 5000, [0.9] * 5000)
    assert ground_warnings(few, np.array([True, False, False, False])) == []
    assert ground_warnings(many, np.zeros(4, bool)) == []


def scene_of(points, **kinds):
    """Return the counts of a scene, with the probabilities of some kinds of scenes."""
    probabilities = np.array([kinds.get(name.replace(" ", "_"), 0.0) for name in KINDS])
    return {"counts": np.array([points, 0, 0]), "confidences": counts_of([0], [0.9]), "kinds": probabilities}


def test_scenes_unlike_the_training_data_are_warned_of_with_their_reasons():
    usual = scene_of(7000, familiar=0.9, scale=0.1)
    strange = scene_of(3000, familiar=0.1, turned=0.6, indoors=0.3)
    (text,) = unfamiliar_warnings({"a": usual, "b": strange})
    assert text.startswith("30% of the points") and KINDS["turned"] in text and KINDS["indoors"] in text
    assert KINDS["scale"] not in text
    (short,) = unfamiliar_warnings({"a": usual, "b": strange}, explained=True)
    assert KINDS["turned"] not in short
    assert unfamiliar_warnings({"a": usual, "b": scene_of(1000, familiar=0.1, turned=0.9)}) == []
    assert unfamiliar_warnings({"a": {"counts": np.array([9]), "confidences": counts_of([0], [0.9])}}) == []


def test_facts_are_those_of_scenes_with_most_of_the_points():
    assert spread_scenes([1, 1, 1, 1000, 1000, 1000, 1, 1], 3).tolist() == [3, 4, 5]
    assert spread_scenes([10] * 9, 3).tolist() == [1, 4, 7]
    assert spread_scenes([5], 3).tolist() == [0] and spread_scenes([], 3).tolist() == []
