"""Boosting of the object classifier that goes on from a trained one, with the answers of a user about objects.

Trees are added to those of each kind; they learn from the candidates that the answers are about and from a sample of
the candidates that the object classifier was trained on (replay), which reduces catastrophic forgetting. The added
trees start from the calibrated log odds of the object classifier.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import ObjectClassifier
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees
from mlsroad_pipeline.algorithms.models.machines.threshold_codes import ThresholdCodes


@dataclass(frozen=True)
class ClassifierContinuation:
    """Parameters of the boosting from answers about objects."""

    rounds: int = 40  # Trees that are added per kind
    leaves: int = 5  # Maximum leaves of a tree: few, since there are few answers
    learning_rate: float = 0.1  # Factor of the leaf values
    min_child_samples: int = 10  # Minimum candidates of a leaf
    answer_weight: float = 10.0  # Weight of a candidate of an answer; one of the replay has 1
    penalty: float = 10.0  # L2 penalty of the leaf values; larger follows single answers less
    seed: int = 2026  # Seed of the trees

    def __post_init__(self) -> None:
        for name in ("learning_rate", "answer_weight", "penalty"):
            check_positive(getattr(self, name), f"learn.objects.{name}")
        for name, least in (("rounds", 1), ("leaves", 2), ("min_child_samples", 1)):
            check_at_least(getattr(self, name), least, f"learn.objects.{name}")


class LabelledCandidates(NamedTuple):
    """Candidates of one kind, and whether they are objects of this kind."""

    values: NDArray[np.float32]  # Features of the candidates; NaN does not apply
    true: NDArray[np.bool_]  # Whether each is an object of the kind


def continue_classifier(
    classifier: ObjectClassifier,
    answers: Mapping[str, LabelledCandidates],
    replay: Mapping[str, LabelledCandidates],
    *,
    parameters: ClassifierContinuation | None = None,
) -> ObjectClassifier:
    """Return an object classifier that has learned from answers about objects."""
    own = parameters or ClassifierContinuation()
    trees = dict(classifier.trees)
    for kind, found in answers.items():
        if kind not in trees or kind not in replay:
            raise DataError(f"the object classifier has no trees of the kind {kind!r}")
        for what, rows in (("answers", found), ("replay", replay[kind])):
            if rows.values.shape[1:] != (trees[kind].n_features,):
                raise DataError(
                    f"the {what} have {rows.values.shape[1]} features, the object classifier {trees[kind].n_features}"
                )
        if len(found.values):
            trees[kind] = _continued(classifier, kind, found, replay[kind], own)
    return replace(classifier, trees=trees)


def _continued(
    classifier: ObjectClassifier,
    kind: str,
    answers: LabelledCandidates,
    replay: LabelledCandidates,
    own: ClassifierContinuation,
) -> BoostedTrees:
    """Return the trees of a kind with those that are added."""
    import lightgbm  # noqa: PLC0415  # labelling needs none

    values = np.concatenate([replay.values, answers.values]).astype(np.float32)
    true = np.concatenate([replay.true, answers.true]).astype(np.float64)
    weight = np.repeat([1.0, own.answer_weight], [len(replay.values), len(answers.values)])
    codes = ThresholdCodes(classifier.trees[kind])
    settings: dict[str, Any] = {
        "objective": "binary",
        "boost_from_average": False,
        "num_leaves": own.leaves,
        "learning_rate": own.learning_rate,
        "min_child_samples": own.min_child_samples,
        "feature_fraction": 0.4,
        "extra_trees": True,
        "lambda_l2": own.penalty,
        "max_bin": 63,
        "seed": own.seed,
        "deterministic": True,
        "force_row_wise": True,
        "num_threads": 1,
        "verbosity": -1,
    }
    start = classifier.scores(kind, values)[:, 0]
    data = lightgbm.Dataset(codes.encode(values), true, weight=weight, init_score=start, params=settings)
    booster = lightgbm.train(settings, data, own.rounds)
    added = codes.decode(BoostedTrees.from_lightgbm(booster.model_to_string()))
    factor = classifier.calibration[kind][0]
    scaled = replace(added, leaf=(added.leaf / factor).astype(np.float32))
    return BoostedTrees.joined([classifier.trees[kind], scaled])
