"""Boosting on the answers of a user about a survey, from the scores of any model.

Three sources of equal weight reduce catastrophic forgetting: the answers, a sample of voxels of known classes (replay),
and voxels of the survey that the model labels with high confidence, the same number of each class (self-training).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import softmax
from mlsroad_pipeline.algorithms.models.boosted_trees.training import partial_label_objective
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees, ThresholdCodes

FULL_WEIGHT = 10
"""Number of answers from which they have their whole weight: a few would shift the shares of the classes."""


@dataclass(frozen=True)
class ContinuationSettings:
    """Settings of the boosting from answers, which models keep in their metadata."""

    rounds: int = 40  # Rounds of boosting, of one tree per class each
    bags: int = 2  # Sets of trees from different samples; their mean is added. More of them vary less and take longer.
    leaves: int = 7  # Maximum leaves of a tree: few, since there are few answers
    learning_rate: float = 0.2  # Factor of the leaf values
    min_child_samples: int = 20  # Minimum training voxels of a leaf
    per_answer: int = 300  # Maximum training voxels of one answer
    per_class: int = 300  # Maximum confident voxels of the survey per class
    # Share of the voxels of a class, those with the highest confidence, that the confident ones are drawn from
    confident: float = 0.5
    replayed: int = 4000  # Maximum voxels of the model's own training data in a set of trees
    # answer_weight, replay_weight, confident_weight: weight of each source
    answer_weight: float = 1.0
    replay_weight: float = 1.0
    confident_weight: float = 1.0
    seed: int = 2026  # Seed of samples and trees


SETTINGS = ContinuationSettings()


class Answer(NamedTuple):
    """One answer of a user: the voxels of an object, or of a supervoxel, and what they are."""

    values: NDArray[np.float32]  # Features of the voxels
    classes: NDArray[np.bool_]  # Classes that the answer allows; several where the user named a kind that holds them
    scores: NDArray[np.float64] | None = None  # Logarithms of the probabilities of a model that is not of boosted trees


class Replay(NamedTuple):
    """Sample of the training voxels of a model, drawn in proportion to their weights."""

    values: NDArray[np.floating]  # Features
    allowed: NDArray[np.bool_]  # Allowed classes


class Scored(NamedTuple):
    """Voxels with the scores of a model, which the boosting goes on from."""

    values: NDArray[np.float32]  # Features
    scores: NDArray[np.float64]  # Logarithms of the probabilities, apart from a constant per voxel


class _Rows(NamedTuple):
    values: NDArray[np.float32]
    allowed: NDArray[np.bool_]
    weight: NDArray[np.float64]
    scores: NDArray[np.float64]


def boost_on_answers(
    answers: Sequence[Answer],
    survey: Scored,
    replay: Replay,
    replayed: Scored,
    *,
    trees: BoostedTrees,
    groups: NDArray[np.integer] | None,
) -> list[BoostedTrees]:
    """Return sets of trees whose mean corrects the scores of a model, whatever its method."""
    used = [answer for answer in answers if len(answer.values)]
    if not used:
        raise DataError("there is no answer to learn from: correct or accept objects, or paint points, first")
    n_classes = survey.scores.shape[1]
    for what, table in (("an answer", np.stack([answer.classes for answer in used])), ("the replay", replay.allowed)):
        if table.shape[1] != n_classes or not table.any(axis=1).all():
            raise DataError(f"{what} must allow one or more of the {n_classes} classes of the model")
    codes, own = ThresholdCodes(trees), SETTINGS
    groups = np.arange(n_classes) if groups is None else groups
    sets = []
    for bag in range(own.bags):
        rng = np.random.default_rng((own.seed, bag))
        rows = [
            _weighted(_of_answers(used, rng), own.answer_weight * min(1.0, len(used) / FULL_WEIGHT)),
            _weighted(_of_replay(replay, replayed, rng), own.replay_weight),
            _weighted(_confident(survey, groups, rng), own.confident_weight),
        ]
        values, allowed, weight, scores = (np.concatenate(part) for part in zip(*rows, strict=True))
        sets.append(_boost(codes, values, allowed, weight * (len(weight) / weight.sum()), scores, bag))
    return sets


def _weighted(rows: _Rows, total: float) -> _Rows:
    """Return rows whose weights have a given sum."""
    return rows._replace(weight=rows.weight * (total / rows.weight.sum())) if len(rows.weight) else rows


def _of_answers(answers: Sequence[Answer], rng: np.random.Generator) -> _Rows:
    """Return the voxels of the answers: an answer weighs as the root of its voxels, a class as the root of its sum."""
    drawn = [rng.permutation(len(answer.values))[: SETTINGS.per_answer] for answer in answers]
    sizes = np.array([len(rows) for rows in drawn])
    each = np.sqrt([len(answer.values) for answer in answers])
    classes = np.stack([answer.classes for answer in answers])
    _, group = np.unique(classes, axis=0, return_inverse=True)
    group = group.reshape(-1)
    each = each / np.sqrt(np.bincount(group, weights=each))[group]
    values = np.concatenate([answer.values[rows] for answer, rows in zip(answers, drawn, strict=True)])
    scores = np.concatenate(
        [answer.scores[rows] for answer, rows in zip(answers, drawn, strict=True) if answer.scores is not None]
    )
    return _Rows(values, np.repeat(classes, sizes, axis=0), np.repeat(each / sizes, sizes), scores)


def _of_replay(replay: Replay, scored: Scored, rng: np.random.Generator) -> _Rows:
    rows = rng.permutation(len(replay.values))[: SETTINGS.replayed]
    return _Rows(scored.values[rows], replay.allowed[rows], np.ones(len(rows)), scored.scores[rows])


def _confident(survey: Scored, groups: NDArray[np.integer], rng: np.random.Generator) -> _Rows:
    """Return voxels of the survey with a high predicted probability; each predicted class has the same weight."""
    member = groups[None, :] == np.arange(int(groups.max()) + 1)[:, None]
    of_group = softmax(survey.scores) @ member.T
    best, probability = of_group.argmax(axis=1), of_group.max(axis=1, initial=0.0)
    chosen, weights = [np.zeros(0, np.int64)], [np.zeros(0)]
    for group in range(len(member)):
        rows = np.flatnonzero(best == group)
        if len(rows) < SETTINGS.min_child_samples:
            continue
        rows = rows[probability[rows] >= np.quantile(probability[rows], 1.0 - SETTINGS.confident)]
        rows = rng.permutation(rows)[: SETTINGS.per_class]
        chosen.append(rows)
        weights.append(np.full(len(rows), 1.0 / max(len(rows), 1)))
    picked = np.concatenate(chosen)
    return _Rows(survey.values[picked], member[best[picked]], np.concatenate(weights), survey.scores[picked])


def _boost(
    codes: ThresholdCodes,
    values: NDArray[np.float32],
    allowed: NDArray[np.bool_],
    weight: NDArray[np.float64],
    scores: NDArray[np.float64],
    bag: int,
) -> BoostedTrees:
    import lightgbm  # noqa: PLC0415  # labelling needs none

    own = SETTINGS
    seed = own.seed + bag
    settings: dict[str, Any] = {
        "num_class": allowed.shape[1],
        "num_leaves": own.leaves,
        "learning_rate": own.learning_rate,
        "min_child_samples": own.min_child_samples,
        "feature_fraction": 0.3,
        "extra_trees": True,
        "lambda_l2": 1.0,
        "max_bin": 31,
        "data_random_seed": seed,
        "feature_fraction_seed": seed,
        "extra_seed": seed,
        "deterministic": True,
        "force_row_wise": True,
        "num_threads": 1,
        "verbosity": -1,
    }
    data = lightgbm.Dataset(codes.encode(values), np.zeros(len(values)), params=settings, init_score=scores)
    booster = lightgbm.train({**settings, "objective": partial_label_objective(allowed, weight)}, data, own.rounds)
    return codes.decode(BoostedTrees.from_lightgbm(booster.model_to_string()))
