"""Random forest on supervoxel features (Tomic et al. 2019, sections 2.1 and 3.3)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.ensemble import RandomForestClassifier
from sklearn.exceptions import NotFittedError
from sklearn.tree import DecisionTreeClassifier

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_arrays
from mlsroad_pipeline.algorithms.features.supervoxel_features import SupervoxelFeatures
from mlsroad_pipeline.algorithms.models.machines.class_balance import (
    EXPONENTS,
    check_weight,
    class_weights,
    draw_per_class,
)
from mlsroad_pipeline.algorithms.models.machines.flat_forest import FlatForest


def out_of_bag_curves(
    model: RandomForestClassifier, values: NDArray[np.float32], target: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the out-of-bag error of the first 1, 2, ... trees, overall and averaged over classes."""
    n_trees = len(model.estimators_)
    votes = np.zeros((len(values), len(model.classes_)))
    per_class = np.bincount(target, minlength=votes.shape[1])
    curve, balanced = np.empty(n_trees), np.empty(n_trees)
    for at, (tree, drawn) in enumerate(zip(model.estimators_, model.estimators_samples_, strict=True)):
        left_out = np.ones(len(values), dtype=bool)
        left_out[drawn] = False
        leaves = tree.tree_.predict(np.ascontiguousarray(values[left_out]))
        votes[left_out] += leaves / leaves.sum(axis=1, keepdims=True)
        voted = votes.any(axis=1)
        wrong = voted & (votes.argmax(axis=1) != target)
        curve[at] = wrong.sum() / max(1, voted.sum())
        seen = np.bincount(target[voted], minlength=len(per_class))
        with np.errstate(invalid="ignore"):
            rates = np.bincount(target[wrong], minlength=len(per_class)) / seen
        balanced[at] = np.nanmean(rates) if seen.any() else np.nan
    return curve, balanced


Features = SupervoxelFeatures | ArrayLike


class DetrendedForestClassifier(BaseEstimator):
    """Random forest on detrended supervoxel features.

    Examples
    --------
    >>> import numpy as np
    >>> features = np.arange(40, dtype=np.float32).reshape(-1, 1)
    >>> labels = np.repeat([0, 1], 20)
    >>> model = DetrendedForestClassifier(n_classes=2, n_trees=10).fit(features, labels)
    >>> model.predict(features[[0, -1]]).tolist()
    [0, 1]
    """

    def __init__(
        self,
        n_classes: int | None = None,
        *,
        n_trees: int = 200,
        max_depth: int | None = None,
        min_samples_leaf: int = 5,
        max_features: str | float | None = "sqrt",
        class_weight: str | None = "balanced",
        max_per_class: int | None = None,
        out_of_bag: bool = True,
        random_state: int = 0,
        n_jobs: int = 1,
    ) -> None:
        self.n_classes = n_classes
        self.n_trees = n_trees
        self.max_depth = max_depth
        self.min_samples_leaf = min_samples_leaf
        self.max_features = max_features
        self.class_weight = class_weight
        self.max_per_class = max_per_class
        self.out_of_bag = out_of_bag
        self.random_state = random_state
        self.n_jobs = n_jobs

    def fit(
        self, features: Features, labels: ArrayLike, *, sample_weight: ArrayLike | None = None
    ) -> DetrendedForestClassifier:
        """Grow the forest."""
        self._check_parameters()
        values, names = _as_table(features)
        target = np.asarray(labels)
        if target.shape != (len(values),):
            raise DataError(f"labels must have shape ({len(values)},), got {target.shape}")
        n_classes = self.n_classes or int(target.max(initial=0)) + 1
        if len(target) and not -1 <= int(target.min()) <= int(target.max()) < n_classes:
            raise DataError(f"labels must be in -1..{n_classes - 1}, got {target.min()}..{target.max()}")
        classes = np.unique(target[target >= 0])
        if len(classes) == 0:
            raise DataError(f"none of {len(target)} supervoxels is labelled: training needs labels")
        if len(classes) == 1:
            raise DataError(
                f"all {(target >= 0).sum()} labelled supervoxels have class {classes[0]}: a forest needs two classes"
            )
        weight = check_weight(sample_weight, len(values))
        model, used = self._grow(values, target, weight)
        self.n_classes_ = n_classes
        self.feature_names_in_ = names
        self.trained_classes_ = classes.astype(np.int64)
        self.missing_classes_ = np.setdiff1d(np.arange(n_classes), classes)
        self.forest_ = FlatForest.from_trees(model.estimators_)
        importances = model.feature_importances_.tolist()
        self.feature_importances_ = dict(zip(names, importances, strict=True))
        if self.out_of_bag:
            in_order = np.searchsorted(classes, target[used])
            self.oob_error_curve_, self.oob_balanced_error_curve_ = out_of_bag_curves(model, values[used], in_order)
            self.oob_score_ = float(1.0 - self.oob_error_curve_[-1])
        if len(self.missing_classes_):
            warnings.warn(
                f"no supervoxels of classes {self.missing_classes_.tolist()}: they are never predicted", stacklevel=2
            )
        return self

    def predict_proba(self, features: Features) -> NDArray[np.float32]:
        """Return the class probabilities of supervoxels."""
        if not hasattr(self, "forest_"):
            raise NotFittedError("this DetrendedForestClassifier is not fitted yet: call fit first")
        values, names = _as_table(features)
        if isinstance(features, SupervoxelFeatures) and names != self.feature_names_in_:
            differing = sorted(set(names) ^ set(self.feature_names_in_)) or "their order"
            raise DataError(f"features differ from those of training: {differing}")
        out = np.zeros((len(values), self.n_classes_), np.float32)
        out[:, self.trained_classes_] = self.forest_.predict_proba(values, n_threads=max(1, self.n_jobs))
        return out

    def predict(self, features: Features) -> NDArray[np.int16]:
        """Return the most probable class of each supervoxel, the lowest of equally probable ones."""
        return self.predict_proba(features).argmax(axis=1).astype(np.int16)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the parameters for prediction as named arrays, for an NPZ file without pickles."""
        return {
            **self.forest_.to_arrays(),
            "n_classes": np.array(self.n_classes_),
            "trained_classes": self.trained_classes_,
            "feature_names": np.array(self.feature_names_in_, dtype=np.str_),
            "feature_importances": np.array(list(self.feature_importances_.values())),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], *, n_jobs: int = 1) -> DetrendedForestClassifier:
        """Rebuild a fitted classifier, with identical predictions, from the arrays of `to_arrays`."""
        check_arrays(arrays, _OWN_ARRAYS, "a classifier")
        forest = FlatForest.from_arrays(arrays)
        n_classes = int(arrays["n_classes"])
        model = cls(n_classes, n_trees=len(forest), n_jobs=n_jobs)
        model.forest_ = forest
        model.n_classes_ = n_classes
        model.trained_classes_ = np.asarray(arrays["trained_classes"])
        model.missing_classes_ = np.setdiff1d(np.arange(n_classes), model.trained_classes_)
        model.feature_names_in_ = tuple(np.asarray(arrays["feature_names"]).tolist())
        importances = np.asarray(arrays["feature_importances"]).tolist()
        model.feature_importances_ = dict(zip(model.feature_names_in_, importances, strict=True))
        return model

    def _grow(
        self, values: NDArray[np.float32], target: NDArray[np.integer], weight: NDArray[np.float64] | None
    ) -> tuple[RandomForestClassifier, NDArray[np.int64]]:
        """Grow the trees; return the forest and the training supervoxels."""
        used = draw_per_class(target, self.max_per_class, seed=self.random_state)
        sizes, drawn = np.unique_counts(target[target >= 0])[1], np.unique_counts(target[used])[1]
        model = RandomForestClassifier(
            self.n_trees, max_depth=self.max_depth, min_samples_leaf=self.min_samples_leaf,
            max_features=self.max_features, random_state=self.random_state,
            class_weight="balanced_subsample" if self.class_weight == "balanced" else None,
            n_jobs=self.n_jobs,
        )  # fmt: skip
        if self.class_weight != "balanced":
            # Class weights of the trees, unlike those of the forest, do not affect the bootstrap.
            model.estimator = DecisionTreeClassifier(class_weight=class_weights(sizes, drawn, self.class_weight))
        model.fit(values[used], target[used], sample_weight=None if weight is None else weight[used])
        return model, used

    def _check_parameters(self) -> None:
        for name in ("n_trees", "min_samples_leaf", "n_jobs", "max_depth", "n_classes", "max_per_class"):
            value = getattr(self, name)
            optional = name in ("max_depth", "n_classes", "max_per_class") and value is None
            if not optional and (not isinstance(value, Integral) or isinstance(value, bool) or value < 1):
                raise ParameterError(f"{name} must be an integer of at least 1, got {value!r}")
        if self.class_weight not in EXPONENTS:
            raise ParameterError(f"class_weight must be 'balanced', 'sqrt' or None, got {self.class_weight!r}")


_OWN_ARRAYS = ("n_classes", "trained_classes", "feature_names", "feature_importances")


def _as_table(features: Features) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """Return the values as float32 (s, f) and the names of the columns."""
    table = features.values if isinstance(features, SupervoxelFeatures) else features
    values = np.ascontiguousarray(table, dtype=np.float32)
    if values.ndim != 2:
        raise DataError(f"features must have shape (s, f), got {values.shape}")
    if np.isinf(values).any():
        raise DataError(f"features contain infinity in row {int(np.argwhere(np.isinf(values))[0, 0])}")
    if isinstance(features, SupervoxelFeatures):
        return values, features.names
    return values, tuple(f"feature_{j}" for j in range(values.shape[1]))
