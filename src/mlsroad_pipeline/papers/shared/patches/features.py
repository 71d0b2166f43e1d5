"""Feature vectors of patches, and classifiers of single patches with one model per feature set (Luo et al. 2016)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.bundle import arrays_under
from mlsroad_pipeline.algorithms.models.machines.class_balance import draw_per_class
from mlsroad_pipeline.papers.shared.patches.table import Patches

GEOMETRY, COLOURED = "geometry", "geometry+rgb"
"""Feature sets without and with colour."""


def variants_of(patches: Patches) -> tuple[str, ...]:
    """Return the feature sets available for patches, the largest last."""
    return (GEOMETRY,) if patches.rgb is None else (GEOMETRY, COLOURED)


def patch_features(patches: Patches, variant: str) -> NDArray[np.float32]:
    """Return the feature vectors of patches."""
    parts = [patches.fpfh, patches.height[:, None]]
    if variant == COLOURED:
        if patches.rgb is None:
            raise DataError("patches have no colour: features with colour cannot be computed")
        parts.append(patches.rgb)
    return np.concatenate(parts, axis=1)


def draw_training_patches(patches: Patches, max_per_class: int, *, seed: int) -> Patches:
    """Draw a random sample with a maximum size per class (Luo et al. 2016, section IV-C: 10,000)."""
    rows = draw_per_class(patches.label, max_per_class, seed=seed)
    if len(rows) == 0:
        raise DataError("no labelled patches to train on")
    return patches.take(rows)


@dataclass(eq=False)
class PatchVariants:
    """Trained classifier of patches with one model per feature set."""

    kind: ClassVar[Any]
    slug: ClassVar[str]

    n_classes: int
    trained_classes: NDArray[np.int64]
    models: Mapping[str, Any]  # feature set to model

    def predict_proba(self, patches: Patches, edges: NDArray[np.int32] | None = None) -> NDArray[np.float32]:
        """Return the class probabilities (n, n_classes) of patches, 0 for classes without training samples.

        `edges` is unused: patches are classified independently. `DataError` if the histograms have another length than
        those of training.
        """
        variant = COLOURED if patches.rgb is not None and COLOURED in self.models else GEOMETRY
        out = np.zeros((len(patches), self.n_classes), np.float32)
        out[:, self.trained_classes] = self.models[variant].predict_proba(patch_features(patches, variant))
        return out

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the models as named arrays."""
        arrays = {"n_classes": np.array(self.n_classes), "trained_classes": self.trained_classes}
        for variant, model in self.models.items():
            arrays |= {f"{variant}.{name}": values for name, values in model.to_arrays().items()}
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild a classifier from the arrays of `to_arrays`; `DataError` if one is missing."""
        models = {}
        for variant in (GEOMETRY, COLOURED):
            own = arrays_under(arrays, f"{variant}.")
            if own:
                models[variant] = cls.kind.from_arrays(own)
        if GEOMETRY not in models or "n_classes" not in arrays or "trained_classes" not in arrays:
            raise DataError(f"the arrays of a {cls.slug} lack n_classes, trained_classes or a model")
        return cls(int(arrays["n_classes"]), np.asarray(arrays["trained_classes"]), models)
