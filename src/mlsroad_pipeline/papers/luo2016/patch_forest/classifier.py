"""Random forest on patches (Luo et al. 2016, section IV-C: ten trees of depth fifteen)."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.algorithms.models.machines.flat_forest import FlatForest
from mlsroad_pipeline.papers.shared.patches.features import (
    PatchVariants,
    draw_training_patches,
    patch_features,
    variants_of,
)
from mlsroad_pipeline.papers.shared.patches.table import Patches

SLUG = "patch_forest"


@dataclass(frozen=True)
class PatchForestParameters:
    """Parameters of the forest."""

    n_trees: int = 10  # Trees (luo2016: 10). More trees give smoother probabilities; time grows linearly.
    max_depth: int = 15  # Maximum depth of a tree (luo2016: 15). Deeper trees fit rare patches, and noise.
    max_per_class: int = 10_000  # Maximum patches per class in training (luo2016: 10,000)
    seed: int = 2016  # Seed of the sample, the bootstrap and the splits

    def __post_init__(self) -> None:
        for name in ("n_trees", "max_depth", "max_per_class"):
            check_at_least(getattr(self, name), 1, f"{SLUG}.{name}")


class PatchForest(PatchVariants):
    """Trained forest for each feature set."""

    kind, slug = FlatForest, SLUG

    @classmethod
    def fit(
        cls,
        patches: Patches,
        edges: NDArray[np.int32] | None = None,
        *,
        parameters: PatchForestParameters,
        n_classes: int,
        n_threads: int = 1,
    ) -> Self:
        """Train on labelled patches."""
        from sklearn.ensemble import RandomForestClassifier  # noqa: PLC0415  not needed for prediction

        sample = draw_training_patches(patches, parameters.max_per_class, seed=parameters.seed)
        forests = {}
        for variant in variants_of(sample):
            model = RandomForestClassifier(
                parameters.n_trees, max_depth=parameters.max_depth, random_state=parameters.seed, n_jobs=n_threads
            )
            model.fit(patch_features(sample, variant), sample.label)
            forests[variant] = FlatForest.from_trees(model.estimators_)
        return cls(n_classes, np.unique(sample.label).astype(np.int64), forests)
