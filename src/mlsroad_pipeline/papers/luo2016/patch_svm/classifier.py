"""Support vector machine with a Gaussian kernel on patches (Luo et al. 2016, section IV-C), and its training."""

import logging
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from sklearn.model_selection import StratifiedGroupKFold

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.models.machines import kernel_machine
from mlsroad_pipeline.papers.shared.patches.features import (
    PatchVariants,
    draw_training_patches,
    patch_features,
    variants_of,
)
from mlsroad_pipeline.papers.shared.patches.table import Patches

SLUG = "patch_svm"

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class PatchSvmParameters:
    """Parameters of the support vector machine."""

    # Values of C in the grid search. Larger values fit single patches more closely.
    costs: Sequence[float] = field(default_factory=lambda: [3.0, 30.0, 300.0])
    # Values of gamma in the grid search, for standardised features. Larger values narrow the kernel.
    gammas: Sequence[float] = field(default_factory=lambda: [0.003, 0.01, 0.03, 0.1])
    n_folds: int = 3  # Folds of the cross-validation, at least 2; the patches of a scene share a fold
    cv_per_class: int = 150  # Maximum patches per class in the cross-validation; its time grows quadratically
    # Maximum patches per class in training (luo2016: 10,000). Training time grows quadratically, prediction time
    # linearly.
    max_per_class: int = 2000
    seed: int = 2016  # Seed of the samples and of the folds

    def __post_init__(self) -> None:
        for name in ("costs", "gammas"):
            values = getattr(self, name)
            if not len(values) or not all(np.isfinite(value) and value > 0 for value in values):
                raise ParameterError(f"{SLUG}.{name} must be numbers > 0, got {values!r}")
        for name, least in (("n_folds", 2), ("cv_per_class", 2), ("max_per_class", 2)):
            if getattr(self, name) < least:
                raise ParameterError(f"{SLUG}.{name} must be at least {least}, got {getattr(self, name)!r}")


class PatchSvm(PatchVariants):
    """Trained support vector machine for each feature set."""

    kind, slug = kernel_machine.KernelMachine, SLUG
    choice: kernel_machine.Choice | None = None  # C and gamma of a newly trained classifier; None after loading

    @classmethod
    def fit(
        cls,
        patches: Patches,
        edges: NDArray[np.int32] | None = None,
        *,
        parameters: PatchSvmParameters,
        n_classes: int,
        n_threads: int = 1,
    ) -> Self:
        """Train on labelled patches.

        C and gamma maximise the mean F1 on held-out scenes; ties go to the smaller values. With fewer scenes than
        folds, each scene is cut across its longer side into one part per fold, and a warning is logged.
        """
        sample = draw_training_patches(patches, parameters.max_per_class, seed=parameters.seed)
        trained = np.unique(sample.label).astype(np.int64)
        if len(trained) < 2:
            raise DataError(f"{SLUG} needs patches of at least two classes, got only class {int(trained[0])}")
        small = draw_training_patches(patches, parameters.cv_per_class, seed=parameters.seed)
        folds = _folds(small, parameters)
        if not folds:
            raise DataError(f"{SLUG}: no fold has training patches of two classes: add training scenes")
        machines = {}
        choice: kernel_machine.Choice | None = None
        for variant in reversed(variants_of(sample)):
            features = patch_features(sample, variant)
            shift, scale = kernel_machine.standardise(features)
            held_out = (patch_features(small, variant) - shift) / scale
            if choice is None:
                choice = kernel_machine.choose_machine(
                    held_out, small.label, folds, costs=parameters.costs, gammas=parameters.gammas, n_threads=n_threads
                )
            machines[variant] = kernel_machine.fit_machine(
                features, sample.label, choice, held_out=held_out, held_out_labels=small.label, folds=folds
            )
        classifier = cls(n_classes, trained, machines)
        classifier.choice = choice
        return classifier

    def describe(self) -> dict[str, Any]:
        """Return the choice of cross-validation of a newly trained classifier."""
        return {} if self.choice is None else {"chosen": asdict(self.choice)}


def _groups(patches: Patches, n_folds: int) -> NDArray[np.int64]:
    """Return the scene of each patch or, with fewer scenes than folds, its part of the scene."""
    scenes, groups = np.unique(patches.scene, return_inverse=True)
    if len(scenes) >= n_folds:
        return groups.astype(np.int64)
    logger.warning(
        "%s: %d training scenes are fewer than %d folds: each is cut into %d adjacent parts",
        SLUG, len(scenes), n_folds, n_folds,
    )  # fmt: skip
    parts = np.zeros(len(groups), np.int64)
    for scene in range(len(scenes)):
        rows = np.flatnonzero(groups == scene)
        plan = patches.centroid[rows, :2]
        along = plan[:, int(np.ptp(plan, axis=0).argmax())]
        rank = np.argsort(np.argsort(along, kind="stable"), kind="stable")
        parts[rows] = scene * n_folds + rank * n_folds // len(rows)
    return parts


def _folds(patches: Patches, parameters: PatchSvmParameters) -> list[tuple[NDArray, NDArray]]:
    groups = _groups(patches, parameters.n_folds)
    if len(np.unique(groups)) < parameters.n_folds:
        raise DataError(
            f"{SLUG}: {len(patches)} labelled patches are too few for {parameters.n_folds} folds: add training scenes"
        )
    splitter = StratifiedGroupKFold(parameters.n_folds, shuffle=True, random_state=parameters.seed)
    # Rare classes may be absent from a fold; the stratification treats them as one class.
    frequent = np.where(np.bincount(patches.label)[patches.label] >= parameters.n_folds, patches.label, -1)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The least populated class")
        parts = list(splitter.split(groups, frequent, groups))
    filled = [(train, test) for train, test in parts if len(train) and len(test)]
    return [fold for fold in filled if len(np.unique(patches.label[fold[0]])) > 1]
