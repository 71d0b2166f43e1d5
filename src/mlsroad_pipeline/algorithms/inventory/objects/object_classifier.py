"""Boosted trees that classify candidates of the inventory, and their continuation from answers of a user."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.array_checks import check_model_arrays
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees, ThresholdCodes

STEM = "stem"
"""Name of the classifier of upright lines: trunk, pole or post, or neither."""

TRUNK, POLE, NEITHER = range(3)
"""Columns of the probabilities of stems."""


class Classifier(Protocol):
    """A trained object classifier: `ObjectClassifier`."""

    def probabilities(self, classifier: str, features: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the probabilities of the classes of a classifier."""

    def reasons(self, classifier: str, features: NDArray[np.float32]) -> list[str]:
        """Return what the score of each candidate rests on."""


_MOST, _LEAST_EFFECT = 3, 0.15  # largest number of reasons, and the least change of the score (log odds) of each

REASONS: dict[str, tuple[tuple[str, str, tuple[str, ...]], ...]] = {
    "pole": (
        ("upright line", "no upright line", ("tilt", "linearity", "planarity", "deviation_", "plan_dev", "radius_",
                                             "low_width", "middle_width", "top_width", "low_share", "middle_share",
                                             "top_share", "foot_width")),
        ("height of a pole", "height unusual for a pole", ("height", "span", "width", "extent")),
        ("points classified as pole", "few points classified as pole", ("own ", "from_signs")),
        ("stands free", "touches other things", ("beside",)),
        ("free above", "other things above", ("above",)),
        ("stands on the ground", "does not reach the ground", ("below", "clearance")),
        ("round shaft", "no round shaft", ("diameter",)),
        ("well covered by points", "few points", ("log_", "own_cells", "visible_share", "filled")),
    ),
    "sign": (
        ("plate above the ground", "no plate", ("panel_", "planarity", "deviation_", "plan_dev", "linearity")),
        ("size of a sign", "size unusual for a sign", ("height", "span", "width", "extent", "radius_", "low_width",
                                                       "middle_width", "top_width", "low_share", "middle_share",
                                                       "top_share", "foot_width")),
        ("points classified as sign", "few points classified as sign", ("own ", "from_signs")),
        ("stands free", "touches other things", ("beside",)),
        ("free above", "other things above", ("above",)),
        ("height of a sign above the ground", "height above the ground unusual for a sign", ("below", "clearance")),
        ("upright post", "no upright post", ("tilt", "visible_share", "diameter")),
        ("well covered by points", "few points", ("log_", "own_cells", "filled")),
    ),
    "vehicle": (
        ("size of a vehicle", "size unusual for a vehicle", ("height", "width", "length", "span", "extent", "radius_",
                                                             "plan_dev")),
        ("shape of a vehicle", "shape unusual for a vehicle", ("deviation_", "linearity", "planarity", "low_width",
                                                               "middle_width", "top_width", "low_share",
                                                               "middle_share", "top_share", "foot_width", "filled")),
        ("points classified as vehicle", "few points classified as vehicle", ("own ",)),
        ("stands free", "touches other things", ("beside",)),
        ("free above", "other things above", ("above",)),
        ("stands on the road or pavement", "does not stand on pavement", ("below", "clearance")),
        ("well covered by points", "few points", ("log_", "own_cells", "visible_share")),
    ),
    "tree": (
        ("trunk below a crown", "no trunk", ("trunk", "diameter", "low_width", "foot_width", "low_share")),
        ("size of a tree", "size unusual for a tree", ("height", "span", "extent", "crown_diameter", "width",
                                                       "radius_", "plan_dev")),
        ("shape of a crown", "shape unusual for a crown", ("deviation_", "linearity", "planarity", "middle_width",
                                                           "top_width", "middle_share", "top_share", "filled")),
        ("points classified as tree", "few points classified as tree", ("own ",)),
        ("stands free", "touches other things", ("beside",)),
        ("free above", "other things above", ("above",)),
        ("reaches the ground", "does not reach the ground", ("below", "clearance")),
        ("well covered by points", "few points", ("log_", "own_cells", "visible_share")),
    ),
}  # fmt: skip
"""Reasons for and against each kind, and the features (by the first letters of their names) that they rest on."""


_FAR = 1e3
"""Limit of the calibration of log odds."""


@dataclass(frozen=True)
class ObjectClassifier:
    """Classifiers of candidates: `classifying.Classifier`."""

    features: Mapping[str, Sequence[str]]  # Classifier to the names of its features
    trees: Mapping[str, BoostedTrees]  # Classifier to its trees: one score for two classes, else one per class
    # Classifier to factor and summand of the scores, which make probabilities of them
    calibration: Mapping[str, tuple[float, float]]
    # Classifier to the medians of the features of false candidates; the effect of a feature is measured against them
    typical: Mapping[str, NDArray[np.float32]]

    def check_features(self, classifier: str, names: Sequence[str]) -> None:
        """Check that the object classifier was trained on given features."""
        if classifier not in self.trees or list(self.features[classifier]) != list(names):
            raise DataError(
                f"the object classifier has other features of {classifier!r} than this version: train it again"
            )

    def scores(self, classifier: str, features: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the calibrated log odds, shape (n, 1), or log probabilities but for a constant, shape (n, classes)."""
        factor, summand = self.calibration[classifier]
        return factor * self.trees[classifier].scores(features) + summand

    def probabilities(self, classifier: str, features: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the probabilities of the classes of a classifier."""
        scores = self.scores(classifier, features)
        if scores.shape[1] == 1:
            with np.errstate(over="ignore"):  # of a score far below 0, whose probability is 0
                return 1.0 / (1.0 + np.exp(-scores))
        powers = np.exp(scores - scores.max(axis=1, keepdims=True))
        return powers / powers.sum(axis=1, keepdims=True)

    def reasons(self, classifier: str, features: NDArray[np.float32]) -> list[str]:
        """Return what the score of each candidate rests on.

        A group of features has the effect by which the log odds fall when these features get the medians of false
        candidates. The groups with the largest effects are named, the largest first.
        """
        groups = REASONS[classifier]
        table = np.asarray(features, dtype=np.float32)
        whole = self.scores(classifier, table)[:, 0]
        effects = np.zeros((len(table), len(groups)))
        for k, (_, _, prefixes) in enumerate(groups):
            columns = [i for i, name in enumerate(self.features[classifier]) if name.startswith(prefixes)]
            changed = table.copy()
            changed[:, columns] = self.typical[classifier][columns]
            effects[:, k] = whole - self.scores(classifier, changed)[:, 0]
        phrases = []
        for row in effects:
            order = np.argsort(-np.abs(row), kind="stable")[:_MOST]
            named = [groups[k][0 if row[k] > 0 else 1] for k in order if abs(row[k]) >= _LEAST_EFFECT]
            phrases.append("; ".join(named))
        return phrases

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the object classifier as named arrays, for an NPZ file."""
        arrays: dict[str, NDArray] = {"questions": np.array(list(self.trees))}
        for classifier, trees in self.trees.items():
            arrays |= {f"{classifier}/{name}": values for name, values in trees.to_arrays().items()}
            arrays[f"{classifier}/features"] = np.array(list(self.features[classifier]))
            arrays[f"{classifier}/calibration"] = np.array(self.calibration[classifier])
            arrays[f"{classifier}/typical"] = self.typical[classifier]
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> ObjectClassifier:
        """Rebuild an object classifier from the arrays of `to_arrays`."""
        check_model_arrays(arrays)
        try:
            classifiers = [str(name) for name in arrays["questions"]]
            parts = {
                classifier: {
                    name.removeprefix(f"{classifier}/"): values
                    for name, values in arrays.items()
                    if name.startswith(f"{classifier}/")
                }
                for classifier in classifiers
            }
            trees = {classifier: BoostedTrees.from_arrays(part) for classifier, part in parts.items()}
            for classifier, part in parts.items():
                _check_classifier(classifier, part)
            return cls(
                {classifier: [str(name) for name in part["features"]] for classifier, part in parts.items()},
                trees,
                {
                    classifier: (float(part["calibration"][0]), float(part["calibration"][1]))
                    for classifier, part in parts.items()
                },
                {classifier: part["typical"] for classifier, part in parts.items()},
            )
        except KeyError as error:
            raise DataError(f"the object classifier lacks the array {error}") from error


def _check_classifier(classifier: str, part: Mapping[str, NDArray]) -> None:
    """Check the arrays of a classifier that are no trees."""
    n_features = int(part["n_features"])
    calibration, typical = part["calibration"], part["typical"]
    near = calibration.dtype.kind == "f" and bool((np.abs(calibration) < _FAR).all())
    finite = typical.dtype.kind == "f" and not np.isinf(typical).any()
    for name, fits in (
        ("features", part["features"].shape == (n_features,)),
        ("calibration", calibration.shape == (2,) and near),
        ("typical", typical.shape == (n_features,) and finite),
    ):
        if not fits:
            raise DataError(f"the object classifier is damaged: array '{classifier}/{name}' has other values")


ADDED_TREES = 40
"""Trees that the answers about objects add per kind."""

ANSWER_WEIGHT = 10.0
"""Weight of a candidate of an answer; one of the replay has 1."""


class LabelledCandidates(NamedTuple):
    """Candidates of one kind, and whether they are objects of this kind."""

    values: NDArray[np.float32]  # Features of the candidates; NaN does not apply
    true: NDArray[np.bool_]  # Whether each is an object of the kind


def continue_classifier(
    classifier: ObjectClassifier,
    answers: Mapping[str, LabelledCandidates],
    replay: Mapping[str, LabelledCandidates],
) -> ObjectClassifier:
    """Return an object classifier that has learned from answers about objects."""
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
            trees[kind] = _continued(classifier, kind, found, replay[kind])
    return replace(classifier, trees=trees)


def _continued(
    classifier: ObjectClassifier, kind: str, answers: LabelledCandidates, replay: LabelledCandidates
) -> BoostedTrees:
    """Return the trees of a kind with those that are added."""
    import lightgbm  # noqa: PLC0415  # labelling needs none

    values = np.concatenate([replay.values, answers.values]).astype(np.float32)
    true = np.concatenate([replay.true, answers.true]).astype(np.float64)
    weight = np.repeat([1.0, ANSWER_WEIGHT], [len(replay.values), len(answers.values)])
    codes = ThresholdCodes(classifier.trees[kind])
    settings: dict[str, Any] = {
        "objective": "binary",
        "boost_from_average": False,
        "num_leaves": 5,  # few, since there are few answers
        "learning_rate": 0.1,
        "min_child_samples": 10,
        "feature_fraction": 0.4,
        "extra_trees": True,
        "lambda_l2": 10.0,  # larger follows single answers less
        "max_bin": 63,
        "seed": 2026,
        "deterministic": True,
        "force_row_wise": True,
        "num_threads": 1,
        "verbosity": -1,
    }
    start = classifier.scores(kind, values)[:, 0]
    data = lightgbm.Dataset(codes.encode(values), true, weight=weight, init_score=start, params=settings)
    booster = lightgbm.train(settings, data, ADDED_TREES)
    added = codes.decode(BoostedTrees.from_lightgbm(booster.model_to_string()))
    factor = classifier.calibration[kind][0]
    scaled = replace(added, leaf=(added.leaf / factor).astype(np.float32))
    return BoostedTrees.joined([classifier.trees[kind], scaled])
