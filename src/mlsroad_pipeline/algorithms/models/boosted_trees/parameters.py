"""Parameters of the boosted trees, importable without LightGBM."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive

SLUG = "boosted_trees"
_MAX_LEAVES, _MAX_BIN = 64, 255


@dataclass(frozen=True)
class BoostedTreesParameters:
    """Parameters of the boosted trees."""

    # Edge of a voxel, metres. Smaller voxels resolve thinner objects, and time grows with their number.
    voxel_size: float = 0.2
    # Share of the mean probabilities around a voxel in its own probabilities; 0 disables the smoothing
    smoothing: float = 0.5
    smoothing_level: int = 1  # Level of the 27 cells of this mean: their edge is that of a voxel times 2 to this power
    rounds: int = 120  # Rounds of boosting, of one tree per class each. Time and size of the model grow with them.
    leaves: int = 31  # Maximum leaves of a tree, at most 64; above 32 the prediction takes twice as long
    learning_rate: float = 0.1  # Factor of the leaf values. Smaller values need more rounds.
    min_child_samples: int = 40  # Minimum training voxels of a leaf
    feature_fraction: float = 0.5  # Share of the features that a tree may use; training time grows with it
    extra_trees: bool = True  # Draw one threshold per feature and node at random in place of the best one
    lambda_l2: float = 1.0  # Penalty on the square of the leaf values
    max_bin: int = 127  # Maximum bins of a feature, at most 255
    max_per_class: int = 2000  # Maximum training voxels per scene and class
    # Class to its share of the training weight in each source; empty for the shares as found
    prior: Mapping[str, float] = field(default_factory=dict)
    # Share of the training voxels whose intensity is hidden; models then label surveys without intensity
    intensity_dropout: float = 0.4
    checkpoint_rounds: int = 20  # Rounds between two checkpoints. The trees depend on it.
    seed: int = 2026  # Seed of samples, dropout and trees

    def __post_init__(self) -> None:
        for name in ("voxel_size", "learning_rate"):
            check_positive(getattr(self, name), f"{SLUG}.{name}")
        for name in ("rounds", "min_child_samples", "max_per_class", "checkpoint_rounds"):
            check_at_least(getattr(self, name), 1, f"{SLUG}.{name}")
        for name in ("smoothing_level", "lambda_l2"):
            check_at_least(getattr(self, name), 0, f"{SLUG}.{name}")
        for name in ("smoothing", "intensity_dropout"):
            if not 0 <= getattr(self, name) <= 1:
                raise ParameterError(f"{SLUG}.{name} must be in [0, 1], got {getattr(self, name)!r}")
        if not 0 < self.feature_fraction <= 1:
            raise ParameterError(f"{SLUG}.feature_fraction must be in (0, 1], got {self.feature_fraction!r}")
        for name, most in (("leaves", _MAX_LEAVES), ("max_bin", _MAX_BIN)):
            if not 2 <= getattr(self, name) <= most:
                raise ParameterError(f"{SLUG}.{name} must be in 2..{most}, got {getattr(self, name)!r}")
        for name, share in self.prior.items():
            check_positive(share, f"{SLUG}.prior.{name}")

    def of_sample(self) -> BoostedTreesParameters:
        """Return the parameters that training voxels depend on, with the defaults of all others."""
        return BoostedTreesParameters(voxel_size=self.voxel_size, max_per_class=self.max_per_class, seed=self.seed)
