"""Committees of support vector machines: held-out scores and the mean machine."""

import numpy as np
import pytest

from mlsroad_pipeline.papers.yu2016.visual_words.weights import assign_folds, held_out_scores, train_committee, weigh


def test_objects_are_scored_by_machines_trained_without_their_scene(rng):
    places = np.concatenate([rng.normal(0, 1, (40, 3)), rng.normal(1.5, 1, (20, 3))])
    truth = np.arange(60) >= 40
    alike = np.exp(-((places[:, None] - places[None]) ** 2).sum(axis=2))
    folds = np.stack([assign_folds(np.arange(60) // 2, 5, seed) for seed in (1, 2, 3)])
    committee = train_committee(alike, truth, folds, penalty=10.0)
    assert committee.present.all()
    for r, f in np.ndindex(3, 5):
        assert (committee.weights[r, f][folds[r] == f] == 0).all()
    scores = held_out_scores([committee], lambda rows: alike[:, rows], folds)[:, 0]
    row = 17
    sums = [committee.weights[r, folds[r, row]] @ alike[:, row] + committee.offsets[r, folds[r, row]] for r in range(3)]
    assert scores[row] == pytest.approx(1 / (1 + np.exp(-np.mean(sums))))
    mean = committee.mean()
    every = [
        w @ alike[:, row] + b for w, b in zip(committee.weights.reshape(15, 60), committee.offsets.ravel(), strict=True)
    ]
    assert weigh(alike[mean.chosen], mean.values, mean.offset)[row] == pytest.approx(1 / (1 + np.exp(-np.mean(every))))


def test_a_class_in_one_scene_has_no_held_out_score():
    truth, folds = np.arange(9) >= 6, np.arange(9)[None] // 3
    alike = np.eye(9) + 0.1
    committee = train_committee(alike, truth, folds, penalty=1.0)
    assert committee.present.tolist() == [[True, True, False]]
    scores = held_out_scores([committee], lambda rows: alike[:, rows], folds)[:, 0]
    assert (scores[:6] > 0).all() and (scores[6:] == 0).all()
    assert train_committee(alike, truth, np.zeros((1, 9), int), penalty=1.0).mean() is None
