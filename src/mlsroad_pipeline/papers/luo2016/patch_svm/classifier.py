"""One-against-one support vector machine with a Gaussian kernel on patches (Luo et al. 2016, section IV-C)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.models.machines.kernel_machine import Choice, KernelMachine
from mlsroad_pipeline.papers.shared.patches.labelling import label_patch_cloud
from mlsroad_pipeline.papers.shared.patches.variants import PatchVariants

SLUG = "patch_svm"


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
    """Trained support vector machine for each feature set; see `training.fit_patch_svm`."""

    kind, slug = KernelMachine, SLUG
    choice: Choice | None = None  # C and gamma of a newly trained classifier; None after loading


label_cloud = partial(label_patch_cloud, classifier=PatchSvm)
"""Entry point of the models."""
