"""Threshold selection of the visual words."""

import numpy as np
import pytest
from references.words import planted

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.papers.shared.detection.thresholds import best_threshold
from mlsroad_pipeline.papers.yu2016.visual_words.detector import VisualWordsDetector
from mlsroad_pipeline.papers.yu2016.visual_words.queries import DetectorParameters


def test_thresholds_are_chosen_on_all_counterexamples_not_the_sample(rng):
    """Counterexamples with the words of a class are rare in the sample and as frequent as its examples in the scenes."""
    counts, labels = planted(rng, 600)
    twin = (labels == 0) & (rng.random(600) < 0.5)
    truth = np.where(twin, -1, labels)  # half of the poles are something else that looks the same
    few = DetectorParameters(max_others=4, size_share=0.0, profile_share=0.0, size_margin=0.0)
    detector = VisualWordsDetector(["pole", "car"], parameters=few).fit(counts, truth, scenes=np.arange(600) % 6)
    assert detector.f_scores_["pole"] < 0.8  # with the four that vote it would be near 1
    assert detector.f_scores_["car"] > 0.95


def test_objects_of_weight_zero_vote_and_are_excluded_from_threshold_selection(rng):
    counts, labels = planted(rng, 600)
    scenes = np.arange(600) % 6
    odd = scenes >= 4  # two scenes in which half of the poles are something else that looks the same
    truth = np.where((labels == 0) & odd & (rng.random(600) < 0.5), -1, labels)
    same = DetectorParameters(size_share=0.0, profile_share=0.0, size_margin=0.0)
    known = {"scenes": scenes, "weights": np.where(odd, 0.0, 1.0)}
    without = VisualWordsDetector(["pole", "car"], parameters=same).fit(counts, truth, **known)
    counted = VisualWordsDetector(["pole", "car"], parameters=same).fit(counts, truth, scenes=scenes)
    assert without.f_scores_["pole"] > 0.95 > counted.f_scores_["pole"]
    for name in ("pole", "car"):  # thresholds alone differ
        one, other = without.queries_[name], counted.queries_[name]
        assert one.weights.tobytes() == other.weights.tobytes() and one.offset == other.offset
    held = without.held_out_
    rows = held.scenes < 4
    for number, name in enumerate(("pole", "car")):  # the thresholds of the objects that count, and of no others
        given = best_threshold(held.scores[rows, number], held.labels[rows] == number)
        assert (without.f_scores_[name], without.queries_[name].threshold) == given
    with pytest.raises(DataError, match="weights"):
        VisualWordsDetector(["pole"]).fit(counts, truth, weights=np.ones(3))
