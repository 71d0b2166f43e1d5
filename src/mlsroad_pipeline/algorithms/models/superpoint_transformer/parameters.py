"""Parameters of the superpoint transformer, importable without PyTorch."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Self

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive, parse_groups

SLUG = "superpoint_transformer"
N_LEVELS = 3
"""Levels of superpoints above the points."""


@dataclass(frozen=True)
class HierarchyParameters:
    """Parameters of the hierarchy of superpoints and of its features."""

    # Edge of the voxels whose centroids are the points of level 0, metres (robert2023: 0.03 to 0.1). Smaller voxels
    # resolve thinner objects and cost time.
    voxel_size: float = 0.1
    # Radii of the neighbourhoods of the shape features of a point, metres (robert2023: 45 nearest neighbours). Larger
    # radii bridge the gaps of sparse scans and blur small objects.
    ball_radii: Sequence[float] = field(default_factory=lambda: [0.5])
    # Edge of the voxels that are counted in these neighbourhoods, metres. Smaller values depend more on the density.
    ball_voxel_size: float = 0.2
    # Gain per removed edge of merging superpoints into level 2 and level 3 (robert2023: 0.1 to 0.6). Larger values give
    # fewer, larger superpoints.
    regularisation: Sequence[float] = field(default_factory=lambda: [0.05, 0.15])
    # Weight of coordinates beside the shape features in the merging, per metre (robert2023: 0.1 and 0.01). Larger
    # values give more compact superpoints.
    spatial_weight: Sequence[float] = field(default_factory=lambda: [0.1, 0.03])
    # Nearest superpoints that each superpoint of levels 1, 2 and 3 attends to, beside those that it touches
    # (robert2023: up to 30 within a gap). Time grows with them.
    n_neighbors: Sequence[int] = field(default_factory=lambda: [5, 8, 8])

    def __post_init__(self) -> None:
        for name in ("voxel_size", "ball_voxel_size"):
            check_positive(getattr(self, name), f"{SLUG}.hierarchy.{name}")
        _check_list(self.ball_radii, "hierarchy.ball_radii", None, 0.0)
        _check_list(self.regularisation, "hierarchy.regularisation", N_LEVELS - 1, 0.0)
        _check_list(self.spatial_weight, "hierarchy.spatial_weight", N_LEVELS - 1, 0.0)
        _check_list(self.n_neighbors, "hierarchy.n_neighbors", N_LEVELS, 1)


@dataclass(frozen=True)
class NetworkParameters:
    """Parameters of the layers."""

    # Features of a superpoint (robert2023: 64; 128 for KITTI-360). Weights and time grow with its square.
    width: int = 64
    # Widths of the layers on single points below the first pooling (robert2023: 32, 64, 64)
    point_widths: Sequence[int] = field(default_factory=lambda: [32, 64])
    n_heads: int = 16  # Heads of the attention, a divisor of `width` (robert2023: 16)
    key_width: int = 2  # Features of a key and of a query per head (robert2023: 4). Time grows with it.
    edge_width: int = 32  # Features of an edge (robert2023: 32)
    # Attention blocks of levels 1, 2 and 3 on the way up the hierarchy (robert2023: 3 per level, two levels)
    blocks_down: Sequence[int] = field(default_factory=lambda: [1, 3, 3])
    blocks_up: int = 1  # Attention blocks of levels 2 and 1 on the way back (robert2023: 1)

    def __post_init__(self) -> None:
        for name in ("width", "n_heads", "key_width", "edge_width"):
            check_at_least(getattr(self, name), 1, f"{SLUG}.network.{name}")
        check_at_least(self.blocks_up, 0, f"{SLUG}.network.blocks_up")
        _check_list(self.point_widths, "network.point_widths", None, 1)
        _check_list(self.blocks_down, "network.blocks_down", N_LEVELS, 0)
        if self.width % self.n_heads:
            raise ParameterError(
                f"{SLUG}.network.n_heads must divide network.width = {self.width}, got {self.n_heads!r}"
            )


@dataclass(frozen=True)
class AugmentationParameters:
    """Changes of the training scenes."""

    # Copies of each training scene that lack the points above the view of a virtual scanner; their ground, supervoxels
    # and features are computed anew (robert2023: none). Each copy takes the time of a scene.
    cuts: int = 1
    # Range of the largest elevation angle of the virtual scanners, degrees
    elevation: Sequence[float] = field(default_factory=lambda: [1.0, 20.0])
    # Maximum share of points that a copy lacks besides (robert2023: none). Larger values suit sparser scanners.
    thin: float = 0.7
    rotate: bool = True  # Rotate about the vertical by any angle, mirror with probability 0.5 (robert2023: the same)
    # Maximum relative change of heights and vertical offsets, and of horizontal offsets (robert2023: 0.2)
    stretch: float = 0.1
    # Standard deviation of the noise on features, in standard deviations of the feature (robert2023: 0.05 m on
    # coordinates)
    jitter: float = 0.05
    drop: float = 0.2  # Maximum share of dropped superpoints of level 1 (robert2023: 0.2)
    hide_intensity: float = 0.3  # Share of the scenes with hidden intensity (robert2023: no intensity)
    hide_colour: float = 0.5  # Share of the scenes with hidden colour (robert2023: 0.3)

    def __post_init__(self) -> None:
        check_at_least(self.cuts, 0, f"{SLUG}.augmentation.cuts")
        check_at_least(self.jitter, 0, f"{SLUG}.augmentation.jitter")
        for name in ("thin", "stretch", "drop", "hide_intensity", "hide_colour"):
            check_at_least(getattr(self, name), 0, f"{SLUG}.augmentation.{name}")
            if getattr(self, name) > 1:
                raise ParameterError(f"{SLUG}.augmentation.{name} must be in [0, 1], got {getattr(self, name)!r}")
        for name in ("thin", "stretch", "drop"):
            if getattr(self, name) >= 1:
                raise ParameterError(f"{SLUG}.augmentation.{name} must be below 1, got {getattr(self, name)!r}")
        low, high = _check_list(self.elevation, "augmentation.elevation", 2, -90.0)
        if not low <= high < 90:
            raise ParameterError(
                f"{SLUG}.augmentation.elevation must be two ascending angles below 90, got {self.elevation!r}"
            )


@dataclass(frozen=True)
class TrainingParameters:
    """Parameters of the training."""

    # Number of batches (robert2023: 200 to 2000 epochs). Larger improves the scores; time grows with it.
    n_steps: int = 3000
    batch_size: int = 4  # Crops per batch, each of another scene (robert2023: 4)
    # Radius of a crop in plan, metres (robert2023: 7 to 50). Larger gives more context and takes longer.
    crop: float = 15.0
    # Points of level 0 per superpoint of level 1, drawn at random in training and evenly in use (robert2023: 32 to 128)
    n_points: int = 24
    learning_rate: float = 0.005  # Maximum learning rate of AdamW, with warm-up and cosine decay (robert2023: 0.01)
    weight_decay: float = 0.0001  # Weight decay (robert2023: 0.0001)
    clip: float = 5.0  # Maximum norm of the gradient (robert2023: none)
    # Weights of the losses of levels 1, 2 and 3 (robert2023: 1 and 50 for two levels)
    level_weights: Sequence[float] = field(default_factory=lambda: [1.0, 1.0, 0.5])
    # Exponent of the inverse class frequency in the weights of classes; 0 is unweighted, larger favours rare classes.
    # Confidences are corrected for the weights.
    class_balance: float = 0.5
    checkpoint_seconds: float = 300.0  # Time between checkpoints
    # Threads of PyTorch; the weights differ in the last digits between numbers of threads. Another thread prepares the
    # next batch.
    n_threads: int = 1
    # Device of the training; "auto" is a GPU if there is one. The bytes of a model are reproducible on "cpu" alone.
    device: Literal["auto", "cpu", "cuda"] = "cpu"
    seed: int = 2023  # Seed of the initial weights, the crops and the augmentation

    def __post_init__(self) -> None:
        for name in ("n_steps", "batch_size", "n_points", "n_threads"):
            check_at_least(getattr(self, name), 1, f"{SLUG}.training.{name}")
        for name in ("crop", "learning_rate", "clip", "checkpoint_seconds"):
            check_positive(getattr(self, name), f"{SLUG}.training.{name}")
        for name in ("weight_decay", "class_balance", "seed"):
            check_at_least(getattr(self, name), 0, f"{SLUG}.training.{name}")
        _check_list(self.level_weights, "training.level_weights", N_LEVELS, 0.0)
        if self.device not in ("auto", "cpu", "cuda"):
            raise ParameterError(f"{SLUG}.training.device must be auto, cpu or cuda, got {self.device!r}")


@dataclass(frozen=True)
class SuperpointTransformerParameters:
    """Parameters of the superpoint transformer."""

    hierarchy: HierarchyParameters = field(default_factory=HierarchyParameters)  # Superpoints and features
    network: NetworkParameters = field(default_factory=NetworkParameters)  # Layers
    # Changes of the training scenes
    augmentation: AugmentationParameters = field(default_factory=AugmentationParameters)
    training: TrainingParameters = field(default_factory=TrainingParameters)  # Training

    def __post_init__(self) -> None:
        parse_groups(
            self,
            hierarchy=HierarchyParameters,
            network=NetworkParameters,
            augmentation=AugmentationParameters,
            training=TrainingParameters,
        )

    def of_graphs(self) -> Self:
        """Return the parameters with defaults for those of network and training, which change no graph."""
        return replace(self, network=NetworkParameters(), training=TrainingParameters(seed=self.training.seed))


def _check_list(values: Sequence[float], name: str, length: int | None, least: float) -> Sequence[float]:
    """Check the length of a list and that no value is below the least one."""
    if not len(values) or (length is not None and len(values) != length):
        wanted = "at least one number" if length is None else f"{length} numbers"
        raise ParameterError(f"{SLUG}.{name} must be {wanted}, got {values!r}")
    for i, value in enumerate(values):
        check_at_least(value, least, f"{SLUG}.{name}[{i}]")
    return values
