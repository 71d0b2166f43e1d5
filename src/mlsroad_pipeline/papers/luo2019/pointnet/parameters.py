"""Parameters of PointNet, importable without PyTorch."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive

SLUG = "pointnet"


@dataclass(frozen=True)
class PointNetParameters:
    """Parameters of PointNet."""

    # Points sampled per object, with repetition if it has fewer (Qi et al.: 1024, of objects with many more points)
    n_points: int = 128
    # Widths of the shared layers after the feature transform (Qi et al.: 64, 128, 1024)
    widths: Sequence[int] = field(default_factory=lambda: [64, 128, 256])
    # Widths of the fully connected layers (Qi et al.: 512, 256)
    hidden: Sequence[int] = field(default_factory=lambda: [128, 64])
    dropout: float = 0.3  # Dropout rate before the last layer (Qi et al.: 0.3)
    regularisation: float = 0.001  # Weight of the orthogonality penalty of the feature transform (Qi et al.: 0.001)
    epochs: int = 100  # Passes over the training objects
    batch_size: int = 32  # Objects per step (Qi et al.: 32)
    learning_rate: float = 0.001  # Maximum learning rate of Adam (Qi et al.: 0.001)
    # Standard deviation of the noise on the coordinates of training objects, which are scaled to a ball of radius 1 and
    # rotated about z (Qi et al.: 0.02)
    jitter: float = 0.02
    n_turns: int = 4  # Rotations about z over which predictions are averaged
    device: str = "auto"  # Device of the network; "auto" is a GPU if there is one
    seed: int = 2019  # Seed of the initial weights, the order and the augmentation

    def __post_init__(self) -> None:
        for name, number in (("widths", 3), ("hidden", 2)):
            values = getattr(self, name)
            if len(values) != number or min(values) < 1:
                raise ParameterError(f"{name} must be {number} numbers of at least 1, got {values!r}")
        for name, least in (("n_points", 1), ("epochs", 1), ("batch_size", 2), ("n_turns", 1)):
            if getattr(self, name) < least:
                raise ParameterError(f"{name} must be at least {least}, got {getattr(self, name)!r}")
        check_positive(self.learning_rate, "learning_rate")
        if not 0 <= self.dropout < 1:
            raise ParameterError(f"dropout must be at least 0 and below 1, got {self.dropout!r}")
