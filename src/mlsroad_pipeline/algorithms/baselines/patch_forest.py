"""Random forest on patches, a rival of Luo et al. 2016 (section IV-C): ten trees of depth fifteen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.flat_forest import FlatForest
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.algorithms.patch_features import (
    COLOURED,
    GEOMETRY,
    draw_training_patches,
    patch_features,
    variants_of,
)
from mlsroad_pipeline.algorithms.patch_labelling import label_patch_cloud
from mlsroad_pipeline.algorithms.patches import Patches
from mlsroad_pipeline.algorithms.point_cloud import PointCloud

SLUG = "patch_forest"
ENTRY_POINT = "mlsroad_pipeline.algorithms.baselines.patch_forest:label_cloud"


@dataclass(frozen=True)
class PatchForestParameters:
    """Parameters of the forest.

    Parameters
    ----------
    n_trees : int, default 10
        Trees (luo2016: 10). More smooth the probabilities and cost time.
    max_depth : int, default 15
        Greatest depth of a tree (luo2016: 15). Deeper trees follow rarer patches, and noise.
    max_per_class : int, default 10000
        Most patches of a class to train on (luo2016: 10,000).
    seed : int, default 2016
        Seed of the sample, of the bootstrap and of the splits.

    Raises
    ------
    ParameterError
        If a number is below 1.
    """

    n_trees: int = 10
    max_depth: int = 15
    max_per_class: int = 10_000
    seed: int = 2016

    def __post_init__(self) -> None:
        for name in ("n_trees", "max_depth", "max_per_class"):
            if getattr(self, name) < 1:
                raise ParameterError(f"{SLUG}.{name} must be at least 1, got {getattr(self, name)!r}")


@dataclass(frozen=True)
class PatchForest:
    """A trained forest, one for each variant of the features.

    Parameters
    ----------
    n_classes : int
        Classes of the scheme.
    trained_classes : ndarray of int64, shape (t,)
        Those that training saw, ascending.
    forests : mapping of str to FlatForest
        Variant to forest.
    """

    n_classes: int
    trained_classes: NDArray[np.int64]
    forests: Mapping[str, FlatForest]

    @classmethod
    def fit(
        cls,
        patches: Patches,
        edges: NDArray[np.int32] | None = None,
        *,
        parameters: PatchForestParameters,
        n_classes: int,
        n_jobs: int = 1,
    ) -> Self:
        """Train on labelled patches.

        Parameters
        ----------
        patches : Patches
            Patches of the training scenes; those with label -1 are left out.
        edges : ndarray of int32, shape (m, 2), optional
            Not used: a patch is classified by itself.
        parameters : PatchForestParameters
            Parameters of the forest.
        n_classes : int
            Classes of the scheme.
        n_jobs : int, default 1
            Processors to train with; the model does not depend on it.

        Returns
        -------
        PatchForest
            The forest.

        Raises
        ------
        DataError
            If no patch is labelled.
        """
        from sklearn.ensemble import RandomForestClassifier  # noqa: PLC0415  labelling does without

        sample = draw_training_patches(patches, parameters.max_per_class, seed=parameters.seed)
        forests = {}
        for variant in variants_of(sample):
            model = RandomForestClassifier(
                parameters.n_trees, max_depth=parameters.max_depth, random_state=parameters.seed, n_jobs=n_jobs
            )
            model.fit(patch_features(sample, variant), sample.label)
            forests[variant] = FlatForest.from_trees(model.estimators_)
        return cls(n_classes, np.unique(sample.label).astype(np.int64), forests)

    def predict_proba(self, patches: Patches, edges: NDArray[np.int32] | None = None) -> NDArray[np.float32]:
        """Return the class probabilities of patches.

        Parameters
        ----------
        patches : Patches
            The patches, with or without colour.
        edges : ndarray of int32, shape (m, 2), optional
            Not used.

        Returns
        -------
        ndarray of float32, shape (n, n_classes)
            Probabilities; 0 for classes that training did not see.

        Raises
        ------
        DataError
            If the patches have other histograms than those of training.
        """
        variant = COLOURED if patches.rgb is not None and COLOURED in self.forests else GEOMETRY
        if variant not in self.forests:
            raise DataError(f"the model has no forest for {variant}")
        out = np.zeros((len(patches), self.n_classes), np.float32)
        out[:, self.trained_classes] = self.forests[variant].predict_proba(patch_features(patches, variant))
        return out

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the forests as named plain arrays.

        Returns
        -------
        dict of str to ndarray
            The arrays.
        """
        arrays = {"n_classes": np.array(self.n_classes), "trained_classes": self.trained_classes}
        for variant, forest in self.forests.items():
            arrays |= {f"{variant}.{name}": values for name, values in forest.to_arrays().items()}
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild the forests from what `to_arrays` returned.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            The arrays.

        Returns
        -------
        PatchForest
            The forests.

        Raises
        ------
        DataError
            If an array is missing.
        """
        forests = {}
        for variant in (GEOMETRY, COLOURED):
            prefix = f"{variant}."
            own = {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}
            if own:
                forests[variant] = FlatForest.from_arrays(own)
        if not forests or "n_classes" not in arrays or "trained_classes" not in arrays:
            raise DataError("the arrays of a patch forest lack n_classes, trained_classes or a forest")
        return cls(int(arrays["n_classes"]), np.asarray(arrays["trained_classes"]), forests)


def label_cloud(cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Give every point of a cloud a class and a confidence; see `label_patch_cloud`.

    Parameters
    ----------
    cloud : PointCloud
        Points.
    bundle : ModelBundle
        A model of this method.

    Returns
    -------
    labels : ndarray of int16, shape (n,)
        Labels of the model's scheme, -1 for outliers.
    confidence : ndarray of float32, shape (n,)
        0 to 1.
    """
    return label_patch_cloud(cloud, bundle, PatchForest)
