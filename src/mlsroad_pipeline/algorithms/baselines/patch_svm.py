"""Support vector machine on patches, a rival of Luo et al. 2016 (section IV-C): Gaussian kernel, one against one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines.kernel_machine import KernelMachine
from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.algorithms.patch_features import COLOURED, GEOMETRY, patch_features
from mlsroad_pipeline.algorithms.patch_labelling import label_patch_cloud
from mlsroad_pipeline.algorithms.patches import Patches
from mlsroad_pipeline.algorithms.point_cloud import PointCloud

SLUG = "patch_svm"
ENTRY_POINT = "mlsroad_pipeline.algorithms.baselines.patch_svm:label_cloud"


@dataclass(frozen=True)
class PatchSvmParameters:
    """Parameters of the machine.

    Parameters
    ----------
    costs : sequence of float, default [3.0, 30.0, 300.0]
        Values of C to choose from by cross-validation. Larger ones fit single patches more closely.
    gammas : sequence of float, default [0.003, 0.01, 0.03, 0.1]
        Values of gamma to choose from, for features of standard deviation 1. Larger ones look at closer patches only.
    n_folds : int, default 3
        Folds of the cross-validation, at least 2; a scene is in one of them.
    cv_per_class : int, default 150
        Most patches of a class in the cross-validation. Its time grows with the square.
    max_per_class : int, default 2000
        Most patches of a class to train on (luo2016: 10,000). Time of training grows with the square, of labelling
        linearly.
    seed : int, default 2016
        Seed of the samples and of the folds.

    Raises
    ------
    ParameterError
        If a list is empty, a value in one is not above 0, or a number is too small.
    """

    costs: Sequence[float] = field(default_factory=lambda: [3.0, 30.0, 300.0])
    gammas: Sequence[float] = field(default_factory=lambda: [0.003, 0.01, 0.03, 0.1])
    n_folds: int = 3
    cv_per_class: int = 150
    max_per_class: int = 2000
    seed: int = 2016

    def __post_init__(self) -> None:
        for name in ("costs", "gammas"):
            values = getattr(self, name)
            if not len(values) or not all(np.isfinite(value) and value > 0 for value in values):
                raise ParameterError(f"{SLUG}.{name} must be numbers > 0, got {values!r}")
        for name, least in (("n_folds", 2), ("cv_per_class", 2), ("max_per_class", 2)):
            if getattr(self, name) < least:
                raise ParameterError(f"{SLUG}.{name} must be at least {least}, got {getattr(self, name)!r}")


@dataclass(frozen=True)
class PatchSvm:
    """A trained machine, one for each variant of the features; `patch_svm_training` makes it.

    Parameters
    ----------
    n_classes : int
        Classes of the scheme.
    trained_classes : ndarray of int64, shape (t,)
        Those that training saw, ascending.
    machines : mapping of str to KernelMachine
        Variant to machine.
    """

    n_classes: int
    trained_classes: NDArray[np.int64]
    machines: Mapping[str, KernelMachine]

    def predict_proba(self, patches: Patches, edges: NDArray[np.int32] | None = None) -> NDArray[np.float32]:
        """Return the class probabilities of patches.

        Parameters
        ----------
        patches : Patches
            The patches, with or without colour.
        edges : ndarray of int32, shape (m, 2), optional
            Not used: a patch is classified by itself.

        Returns
        -------
        ndarray of float32, shape (n, n_classes)
            Probabilities; 0 for classes that training did not see.

        Raises
        ------
        DataError
            If the patches have other histograms than those of training.
        """
        variant = COLOURED if patches.rgb is not None and COLOURED in self.machines else GEOMETRY
        out = np.zeros((len(patches), self.n_classes), np.float32)
        out[:, self.trained_classes] = self.machines[variant].predict_proba(patch_features(patches, variant))
        return out

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the machines as named plain arrays.

        Returns
        -------
        dict of str to ndarray
            The arrays.
        """
        arrays = {"n_classes": np.array(self.n_classes), "trained_classes": self.trained_classes}
        for variant, machine in self.machines.items():
            arrays |= {f"{variant}.{name}": values for name, values in machine.to_arrays().items()}
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild the machines from what `to_arrays` returned.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            The arrays.

        Returns
        -------
        PatchSvm
            The machines.

        Raises
        ------
        DataError
            If an array is missing.
        """
        machines = {}
        for variant in (GEOMETRY, COLOURED):
            prefix = f"{variant}."
            own = {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}
            if own:
                machines[variant] = KernelMachine.from_arrays(own)
        if GEOMETRY not in machines or "n_classes" not in arrays or "trained_classes" not in arrays:
            raise DataError("the arrays of a patch SVM lack n_classes, trained_classes or a machine")
        return cls(int(arrays["n_classes"]), np.asarray(arrays["trained_classes"]), machines)


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
    return label_patch_cloud(cloud, bundle, PatchSvm)
