"""Training of detrended forests on labelled scenes (Tomic et al. 2019, section 2.1)."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import RandomForestClassifier
from sklearn.tree import DecisionTreeClassifier

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.labels import core_labels
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import StageParameters
from mlsroad_pipeline.algorithms.core.stage_results import SupervoxelPartition, SupervoxelTable
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.algorithms.features.supervoxel_features import SupervoxelFeatures
from mlsroad_pipeline.algorithms.features.supervoxel_moments import COLOUR_FEATURES, INTENSITY_FEATURES
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.machines.class_balance import (
    EXPONENTS,
    class_weights,
    draw_per_class,
    majority_labels,
)
from mlsroad_pipeline.algorithms.models.machines.flat_forest import FlatForest
from mlsroad_pipeline.algorithms.stages import inliers
from mlsroad_pipeline.papers.tomic2019.detrended_forest.labeller import SLUG

_ATTRIBUTES = {"rgb": COLOUR_FEATURES, "intensity": INTENSITY_FEATURES}

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ForestParameters:
    """Parameters of the forest."""

    # Trees; training and prediction time grow with them (tomic2019: 200, where the out-of-bag error converges)
    n_trees: int = 200
    fallback_trees: int = 50  # Trees of each forest for surveys without colour or intensity
    # Minimum supervoxels per leaf. Larger values give smoother probabilities and a smaller model.
    min_samples_leaf: int = 2
    max_features: float = 0.1  # Fraction of the features tried at each split; training time grows with it
    # Total weight of a class: equal for all classes, the square root of its supervoxels, or their number
    class_weight: Literal["balanced", "sqrt", "none"] = "balanced"
    max_per_class: int = 3000  # Maximum supervoxels of a class to train on; bounds the training time
    # Weight of the first-order neighbours in a supervoxel's class probabilities, see `smooth_probabilities`; 0 disables
    # it
    smoothing: float = 0.3
    # Supervoxel whose label a point takes: the one with the nearest centroid (tomic2019, 3.3) or its own
    rule: Literal["nearest", "own"] = "nearest"
    seed: int = 2019  # Seed of the bootstrap and of the splits

    def __post_init__(self) -> None:
        for name in ("n_trees", "fallback_trees", "min_samples_leaf", "max_per_class"):
            check_at_least(getattr(self, name), 1, f"detrended_forest.{name}")
        if not 0 < self.max_features <= 1:
            raise ParameterError(f"detrended_forest.max_features must be in (0, 1], got {self.max_features!r}")
        if self.class_weight not in EXPONENTS:
            raise ParameterError(
                f"detrended_forest.class_weight must be 'sqrt', 'balanced' or 'none', got {self.class_weight!r}"
            )
        if not 0 <= self.smoothing < 1:
            raise ParameterError(f"detrended_forest.smoothing must be in [0, 1), got {self.smoothing!r}")
        if self.rule not in ("nearest", "own"):
            raise ParameterError(f"detrended_forest.rule must be 'nearest' or 'own', got {self.rule!r}")


class TrainingRows(SupervoxelTable):
    """Labelled supervoxels of a training scene, with their features."""

    labels: NDArray[np.int16]  # Class of each supervoxel
    columns: NDArray[np.str_]  # Those of ``"rgb"`` and ``"intensity"`` that the scene has


def training_rows(
    scene: PointCloud, supervoxels: SupervoxelPartition, features: SupervoxelTable, *, scheme: ClassScheme
) -> TrainingRows:
    """Return the labelled supervoxels of a training scene.

    A supervoxel takes the majority class of its core points. Supervoxels without labelled core points are excluded.
    """
    keep = inliers(scene)
    labels = core_labels(scene, scheme)
    majority, _ = majority_labels(labels[keep], supervoxels["labels"][keep], len(scheme))
    rows = majority != IGNORE
    columns = np.array([name for name in _ATTRIBUTES if name in scene], dtype=np.str_)
    return {
        "values": features["values"][rows],
        "labels": majority[rows],
        "centroids": features["centroids"][rows],
        "counts": features["counts"][rows],
        "names": features["names"],
        "columns": columns,
    }


def feature_columns(names: Sequence[str], attributes: Sequence[str]) -> NDArray[np.int64]:
    """Return the columns of the features that need no attributes but the given ones."""
    excluded = {name for attribute, group in _ATTRIBUTES.items() if attribute not in attributes for name in group}
    return np.flatnonzero([name.removesuffix("_detrended") not in excluded for name in names])


def fit(
    rows: Sequence[TrainingRows],
    *,
    parameters: ForestParameters,
    stages: StageParameters,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
    n_jobs: int = 1,
    fallbacks: bool = True,
) -> tuple[ModelBundle, GrownForest]:
    """Train the forests."""
    if not rows:
        raise DataError("no training scenes: the split 'train' is empty")
    attributes = [name for name in _ATTRIBUTES if all(name in row["columns"] for row in rows)]
    table, labels = _join_rows(rows, attributes)
    arrays: dict[str, NDArray] = {}
    variants: dict[str, list[str]] = {}
    forest: GrownForest | None = None
    for size in range(0 if fallbacks else len(attributes), len(attributes) + 1):
        for subset in combinations(attributes, size):
            chosen = _restrict(table, subset)
            fallback = size < len(attributes)
            forest = grow_forest(chosen, labels, parameters, n_classes=len(scheme), n_jobs=n_jobs, fallback=fallback)
            variant = "+".join(("geometry", *subset))
            variants[variant] = list(chosen.names)
            arrays |= {f"{variant}.{key}": array for key, array in forest.arrays.items()}
    assert forest is not None  # the set of all attributes is always trained
    missing = [scheme.classes[label] for label in forest.missing]
    if missing:
        logger.warning("No training supervoxels of %s: they are never predicted", ", ".join(missing))
    metadata = {
        "classes": list(scheme.classes),
        "scheme": asdict(scheme),
        "parameters": {"forest": asdict(parameters), **asdict(stages)},
        "feature_names": variants,
        "attributes": attributes,
        "trained_on": {**trained_on, "supervoxels": len(labels)},
        "out_of_bag_accuracy": float(1.0 - forest.oob_error[-1]),
    }
    return ModelBundle(SLUG, arrays, metadata), forest


def _join_rows(rows: Sequence[TrainingRows], attributes: Sequence[str]) -> tuple[SupervoxelFeatures, NDArray[np.int16]]:
    """Concatenate the supervoxels of all scenes, with their common features in one order."""
    names = [str(name) for name in rows[0]["names"][feature_columns(rows[0]["names"].tolist(), attributes)]]
    tables = []
    for row in rows:
        where = {str(name): i for i, name in enumerate(row["names"])}
        missing = [name for name in names if name not in where]
        if missing:
            raise DataError(f"a training scene lacks the features {', '.join(missing)}")
        tables.append(row["values"][:, [where[name] for name in names]])
    centroids = np.concatenate([row["centroids"] for row in rows])
    counts = np.concatenate([row["counts"] for row in rows])
    labels = np.concatenate([row["labels"] for row in rows])
    return SupervoxelFeatures(np.concatenate(tables), tuple(names), centroids, counts), labels


def _restrict(table: SupervoxelFeatures, attributes: Sequence[str]) -> SupervoxelFeatures:
    columns = feature_columns(table.names, attributes)
    values = np.ascontiguousarray(table.values[:, columns])
    return replace(table, values=values, names=tuple(table.names[i] for i in columns))


@dataclass(frozen=True, eq=False)
class GrownForest:
    """Forest with the facts of its training."""

    arrays: dict[str, NDArray]  # parameters for prediction, as a model stores them
    missing: list[int]  # classes without training supervoxels
    importances: dict[str, float]  # feature to importance
    # Out-of-bag error of the first 1, 2, ... trees, see `out_of_bag_error`; empty for a fallback
    oob_error: NDArray[np.float64]


def grow_forest(
    table: SupervoxelFeatures,
    labels: NDArray[np.integer],
    parameters: ForestParameters,
    *,
    n_classes: int,
    n_jobs: int = 1,
    fallback: bool = False,
) -> GrownForest:
    """Grow a forest on labelled supervoxels; those with label -1 are left out."""
    classes, sizes = np.unique_counts(labels[labels >= 0])
    if len(classes) == 0:
        raise DataError(f"none of {len(labels)} supervoxels is labelled: training needs labels")
    if len(classes) == 1:
        raise DataError(f"all {sizes[0]} labelled supervoxels have class {classes[0]}: a forest needs two classes")
    used = draw_per_class(labels, parameters.max_per_class, seed=parameters.seed)
    values, target = np.ascontiguousarray(table.values, dtype=np.float32)[used], labels[used]
    balanced = parameters.class_weight == "balanced"
    model = RandomForestClassifier(
        parameters.fallback_trees if fallback else parameters.n_trees, min_samples_leaf=parameters.min_samples_leaf,
        max_features=parameters.max_features, random_state=parameters.seed,
        class_weight="balanced_subsample" if balanced else None, n_jobs=n_jobs,
    )  # fmt: skip
    if not balanced:
        # Class weights of the trees, unlike those of the forest, do not affect the bootstrap.
        weights = class_weights(sizes, np.unique_counts(target)[1], parameters.class_weight)
        model.estimator = DecisionTreeClassifier(class_weight=weights)
    model.fit(values, target)
    importances = model.feature_importances_
    arrays = {
        **FlatForest.from_trees(model.estimators_).to_arrays(),
        "n_classes": np.array(n_classes),
        "trained_classes": classes.astype(np.int64),
        "feature_names": np.array(table.names, dtype=np.str_),
        "feature_importances": importances,
    }
    error = np.empty(0) if fallback else out_of_bag_error(model, values, np.searchsorted(classes, target))
    missing = np.setdiff1d(np.arange(n_classes), classes).tolist()
    return GrownForest(arrays, missing, dict(zip(table.names, importances.tolist(), strict=True)), error)


def out_of_bag_error(
    model: RandomForestClassifier, values: NDArray[np.float32], target: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Return the out-of-bag error of the first 1, 2, ... trees."""
    votes = np.zeros((len(values), len(model.classes_)))
    curve = np.empty(len(model.estimators_))
    for at, (tree, drawn) in enumerate(zip(model.estimators_, model.estimators_samples_, strict=True)):
        left_out = np.ones(len(values), dtype=bool)
        left_out[drawn] = False
        leaves = tree.tree_.predict(np.ascontiguousarray(values[left_out]))
        votes[left_out] += leaves / leaves.sum(axis=1, keepdims=True)
        voted = votes.any(axis=1)
        wrong = voted & (votes.argmax(axis=1) != target)
        curve[at] = wrong.sum() / max(1, voted.sum())
    return curve
