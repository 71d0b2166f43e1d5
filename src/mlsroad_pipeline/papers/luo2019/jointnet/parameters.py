"""Parameters of JointNet: inputs, layers and training."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Self

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive, parse_groups

VIEWS = ("hssi", "vqai", "vaai")
"""Views of an object: the three kinds of images of the paper."""

N_MEASURES, N_INTENSITY = 42, 8
"""Number of measures of an object, see `measures`, and of those of its intensity, which come last; the last one flags
known intensity."""


def _share(value: float, name: str) -> None:
    if not 0 <= value < 1:
        raise ParameterError(f"{name} must be at least 0 and below 1, got {value!r}")


def _whole(value: int, name: str, least: int = 1) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise ParameterError(f"{name} must be a whole number of at least {least}, got {value!r}")


@dataclass(frozen=True)
class InputParameters:
    """Inputs of the network."""

    # Kinds of images; a single one is a sub-network of the paper
    views: Sequence[str] = field(default_factory=lambda: list(VIEWS))
    # Rows and columns of HSSI, VQAI and VAAI (luo2019: the same). Larger shows finer detail and more noise.
    sizes: Sequence[int] = field(default_factory=lambda: [16, 8, 16])
    isotropic: bool = True  # Scale all axes of an object by the same factor (luo2019: each axis separately)
    # Half width and height, in metres, of a fixed space for all objects, which preserves their size; `isotropic` has no
    # effect then. None scales every object to fill its space. Luo2019 can be read as either.
    window: Sequence[float] | None = None
    # Distribute a point over the four cells around it, as in the spin images of Johnson and Hebert (1999) that HSSI
    # follows; images of few points are less noisy then. Luo2019 prints one cell per point.
    bilinear: bool = False
    # Equations 4, 7 and 8 as printed; rows and cells of equations 4 and 8 leave most of the images empty, see
    # `compute_images`
    printed_equations: bool = False
    relative: bool = True  # Divide counts by the number of points of the object (luo2019: no)
    # Leave out points whose mean distance to their four nearest points is more than this factor times the median of the
    # object (statistical outlier removal); 0 keeps all (luo2019: all)
    clean: float = 2.5
    compress: bool = True  # Take the square root of the counts, which emphasises sparse cells (luo2019: no)
    # Add the mean intensity of each cell as a second channel (luo2019: no). Objects without intensity can be recognised
    # too.
    intensity: bool = True
    # Use the size and shape of the object in metres as an extra input, see `measures` (luo2019: no)
    measures: bool = True

    def __post_init__(self) -> None:
        if not self.views or not set(self.views) <= set(VIEWS) or len(set(self.views)) < len(self.views):
            raise ParameterError(f"inputs.views must be some of {', '.join(VIEWS)}, got {list(self.views)!r}")
        if len(self.sizes) != len(VIEWS):
            raise ParameterError(f"inputs.sizes must be three numbers, got {list(self.sizes)!r}")
        for size in self.sizes:
            _whole(size, "inputs.sizes")
        check_at_least(self.clean, 0.0, "inputs.clean")
        if self.window is not None:
            if len(self.window) != 2:
                raise ParameterError(f"inputs.window must be two lengths, got {list(self.window)!r}")
            for length in self.window:
                check_positive(length, "inputs.window")


@dataclass(frozen=True)
class NetworkParameters:
    """Layers of the network; the paper gives their kinds and kernels, not their widths."""

    # Channels of the five convolutions of the convolutional module
    convolutional_widths: Sequence[int] = field(default_factory=lambda: [8, 16, 16, 16, 32])
    n_hidden: int = 64  # Width of the fully connected layers
    map_channels: int = 4  # Channels, and rows and columns, of the maps that the fully connected values are reshaped to
    map_size: int = 8  # Channels, and rows and columns, of the maps that the fully connected values are reshaped to
    # Channels of the two convolutions of the first fusion module
    fusion_widths: Sequence[int] = field(default_factory=lambda: [16, 16])
    # Channels of the four convolutions of the second fusion module
    cnn3_widths: Sequence[int] = field(default_factory=lambda: [16, 16, 32, 32])
    # Dropout rate before the last two layers (luo2019: 0.7, read as the keep probability of TensorFlow)
    dropout: float = 0.3
    batch_norm: bool = True  # Apply batch normalisation after convolutions (luo2019: no)
    # Use both fusion modules; without them a fully connected layer replaces the reshape layer, as in the sub-networks
    # of section 4.3 (luo2019: both networks)
    fusion: bool = True
    # Initial weights: he (2015) keeps the variance over layers of rectifiers; glorot (2010) starts smaller, which raw
    # counts need (luo2019: not specified; the default of its TensorFlow is glorot)
    initialisation: Literal["he", "glorot"] = "he"

    def __post_init__(self) -> None:
        for name, number in (("convolutional_widths", 5), ("fusion_widths", 2), ("cnn3_widths", 4)):
            if len(getattr(self, name)) != number:
                raise ParameterError(f"network.{name} must be {number} numbers, got {list(getattr(self, name))!r}")
            for width in getattr(self, name):
                _whole(width, f"network.{name}")
        for name in ("n_hidden", "map_channels", "map_size"):
            _whole(getattr(self, name), f"network.{name}")
        _share(self.dropout, "network.dropout")
        if self.initialisation not in ("he", "glorot"):
            raise ParameterError(f"network.initialisation must be he or glorot, got {self.initialisation!r}")


@dataclass(frozen=True)
class AugmentationParameters:
    """Augmentation of training objects in each epoch."""

    rotate: bool = True  # Rotate about z by a random angle, and mirror with probability 0.5
    drop: float = 0.5  # Maximum share of dropped points
    occlude: float = 0.3  # Maximum share of the extent that is cut off from one side, with probability 0.5
    # Maximum standard deviation of the noise on coordinates, as a share of half the extent of the object
    noise: float = 0.0
    scale: float = 0.1  # Maximum relative change of the extent along each axis
    outliers: float = 0.1  # Maximum share of points that become outliers
    hide_intensity: float = 0.2  # Share of the objects whose intensity is hidden, for robustness to missing intensity

    def __post_init__(self) -> None:
        for name in ("drop", "occlude", "noise", "scale", "outliers", "hide_intensity"):
            _share(getattr(self, name), f"augmentation.{name}")


@dataclass(frozen=True)
class TrainingParameters:
    """Parameters of stochastic gradient descent, augmentation and prediction."""

    epochs: int = 80  # Passes over the training objects (luo2019: 150)
    # Augmented copies of each training object per epoch (luo2019: not specified). Larger lengthens the epochs, which
    # the schedule "halving" counts.
    copies: int = 1
    batch_size: int = 32  # Objects per step (luo2019: 32)
    learning_rate: float = 0.05  # Maximum learning rate (luo2019: 0.01 in one place, 0.001 in another)
    momentum: float = 0.9  # Momentum (luo2019: 0.9)
    weight_decay: float = 0.0005  # Weight decay (luo2019: 0.0005)
    # Maximum norm of the gradient; larger gradients are clipped, which prevents dead rectifiers in networks without
    # batch normalisation. 0 disables clipping (luo2019: not specified).
    clip: float = 0.0
    # Learning rate: rising over the first fifth and falling to 0 as a cosine, or halved every 20 epochs (luo2019)
    schedule: Literal["one_cycle", "halving"] = "one_cycle"
    label_smoothing: float = 0.1  # Label smoothing of the cross entropy (luo2019: 0)
    # Mean of the cross entropy over a batch, or its sum (luo2019, equation 11), whose gradients are as many times
    # larger as a batch has objects
    loss: Literal["mean", "sum"] = "mean"
    # Augmentation of the training objects
    augmentation: AugmentationParameters = field(default_factory=AugmentationParameters)
    # Share of a kernel logistic regression on the measures in the class probabilities, beside the networks; 0 for none,
    # and without measures (luo2019: 0)
    regression_share: float = 0.5
    # Augmented copies of each object that the regression is trained on, beside the object itself
    regression_copies: int = 6
    # Networks of the ensemble, from different initial weights; their probabilities are averaged (luo2019: 1)
    n_members: int = 2
    n_turns: int = 4  # Rotations about z over which predictions are averaged (luo2019: 1)
    # Share of the training objects held out for early stopping; 0 trains on all objects to the last epoch
    validation: float = 0.0
    patience: int = 30  # Epochs without improvement of the held-out loss after which training stops
    device: Literal["auto", "cpu", "cuda"] = "auto"  # Device of the network; "auto" is a GPU if there is one
    mixed_precision: bool = False  # Use mixed precision with bfloat16 on a GPU
    seed: int = 2019  # Seed of initial weights, order, augmentation and held-out objects

    def __post_init__(self) -> None:
        parse_groups(self, augmentation=AugmentationParameters)
        for name in ("epochs", "copies", "n_members", "n_turns", "patience"):
            _whole(getattr(self, name), f"training.{name}")
        _whole(self.batch_size, "training.batch_size", 2)
        _whole(self.seed, "training.seed", 0)
        check_positive(self.learning_rate, "training.learning_rate")
        check_at_least(self.clip, 0.0, "training.clip")
        _whole(self.regression_copies, "training.regression_copies", 0)
        for name in ("momentum", "weight_decay", "label_smoothing", "validation", "regression_share"):
            _share(getattr(self, name), f"training.{name}")
        choices = {"schedule": ("one_cycle", "halving"), "device": ("auto", "cpu", "cuda"), "loss": ("mean", "sum")}
        for name, known in choices.items():
            if getattr(self, name) not in known:
                raise ParameterError(f"training.{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")


@dataclass(frozen=True)
class JointNetParameters:
    """Parameters of JointNet."""

    inputs: InputParameters = field(default_factory=InputParameters)  # Inputs of the network
    network: NetworkParameters = field(default_factory=NetworkParameters)  # Layers
    training: TrainingParameters = field(default_factory=TrainingParameters)  # Training and prediction

    def __post_init__(self) -> None:
        parse_groups(self, inputs=InputParameters, network=NetworkParameters, training=TrainingParameters)

    def with_views(self, *views: str) -> Self:
        """Return the parameters with other views."""
        return replace(self, inputs=replace(self.inputs, views=list(views)))
