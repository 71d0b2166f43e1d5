"""Parameters of JointNet: what it sees of an object, its layers, and how it is trained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive

VIEWS = ("hssi", "vqai", "vaai")
"""Kinds of images: the three of the paper."""

N_MEASURES, N_INTENSITY = 42, 8
"""Numbers that describe the size of an object and its intensity, see `measures`; the last are of the intensity, and the
very last is whether it is known."""


def _share(value: float, name: str) -> None:
    if not 0 <= value < 1:
        raise ParameterError(f"{name} must be at least 0 and below 1, got {value!r}")


def _whole(value: int, name: str, least: int = 1) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise ParameterError(f"{name} must be a whole number of at least {least}, got {value!r}")


@dataclass(frozen=True)
class InputParameters:
    """What the network sees of an object.

    Parameters
    ----------
    views : sequence of str, default ["hssi", "vqai", "vaai"]
        Kinds of images; one alone is a sub-network of the paper.
    sizes : sequence of int, default [16, 8, 16]
        Rows and columns of HSSI, VQAI and VAAI (luo2019: the same). More show finer detail, and more noise.
    isotropic : bool, default True
        Whether proportions are kept when an object is scaled (luo2019: not).
    window : sequence of float, optional
        Half of the width and the height, in metres, of a space that is the same for all objects, so that their size is
        seen; `isotropic` has no effect then. By default every object fills its space. Luo2019 can be read as either.
    bilinear : bool, default False
        Whether a point is shared between the four cells around it, as in the spin images of Johnson and Hebert (1999)
        that HSSI follows; images of few points are steadier then. Luo2019 prints one cell per point, and compares its
        images with spin images without saying whether they are interpolated alike.
    compress : bool, default True
        Whether the square root of the counts is taken, so that few points beside many are seen (luo2019: not).
    intensity : bool, default True
        Whether the mean intensity of each cell is a second channel (luo2019: not). Objects without intensity can be
        recognised all the same.
    measures : bool, default True
        Whether the size of the object in metres is told beside its images, which do not show it (luo2019: not).

    Raises
    ------
    ParameterError
        If a view is unknown or there is none, a size is below 1, or the window is not two lengths above 0.
    """

    views: Sequence[str] = field(default_factory=lambda: list(VIEWS))
    sizes: Sequence[int] = field(default_factory=lambda: [16, 8, 16])
    isotropic: bool = True
    window: Sequence[float] | None = None
    bilinear: bool = False
    compress: bool = True
    intensity: bool = True
    measures: bool = True

    def __post_init__(self) -> None:
        if not self.views or not set(self.views) <= set(VIEWS) or len(set(self.views)) < len(self.views):
            raise ParameterError(f"inputs.views must be some of {', '.join(VIEWS)}, got {list(self.views)!r}")
        if len(self.sizes) != len(VIEWS):
            raise ParameterError(f"inputs.sizes must be three numbers, got {list(self.sizes)!r}")
        for size in self.sizes:
            _whole(size, "inputs.sizes")
        if self.window is not None:
            if len(self.window) != 2:
                raise ParameterError(f"inputs.window must be two lengths, got {list(self.window)!r}")
            for length in self.window:
                check_positive(length, "inputs.window")


@dataclass(frozen=True)
class NetworkParameters:
    """The layers; the paper prints their kinds and kernels, and not their widths.

    Parameters
    ----------
    convolutional_widths : sequence of int, default [8, 16, 16, 16, 32]
        Channels of the five convolutions that every image goes through.
    n_hidden : int, default 64
        Width of the fully connected layers.
    map_channels, map_size : int, default 4, 8
        Channels, rows and columns of the maps that these layers' values are reshaped to.
    fusion_widths : sequence of int, default [16, 16]
        Channels of the two convolutions of the first fusion module.
    cnn3_widths : sequence of int, default [16, 16, 32, 32]
        Channels of the four convolutions of the second fusion module.
    dropout : float, default 0.3
        Share of the values that are dropped before the last two layers (luo2019: 0.7 was chosen; read as the share that
        is kept, as TensorFlow had it).
    batch_norm : bool, default True
        Whether convolutions are followed by batch normalisation (not in luo2019).

    Raises
    ------
    ParameterError
        If a width is below 1, there is another number of them, or `dropout` is not in [0, 1).
    """

    convolutional_widths: Sequence[int] = field(default_factory=lambda: [8, 16, 16, 16, 32])
    n_hidden: int = 64
    map_channels: int = 4
    map_size: int = 8
    fusion_widths: Sequence[int] = field(default_factory=lambda: [16, 16])
    cnn3_widths: Sequence[int] = field(default_factory=lambda: [16, 16, 32, 32])
    dropout: float = 0.3
    batch_norm: bool = True

    def __post_init__(self) -> None:
        for name, number in (("convolutional_widths", 5), ("fusion_widths", 2), ("cnn3_widths", 4)):
            if len(getattr(self, name)) != number:
                raise ParameterError(f"network.{name} must be {number} numbers, got {list(getattr(self, name))!r}")
            for width in getattr(self, name):
                _whole(width, f"network.{name}")
        for name in ("n_hidden", "map_channels", "map_size"):
            _whole(getattr(self, name), f"network.{name}")
        _share(self.dropout, "network.dropout")


@dataclass(frozen=True)
class AugmentationParameters:
    """How training objects are changed, anew in every epoch.

    Parameters
    ----------
    rotate : bool, default True
        Whether they are turned about z by any angle, and mirrored half of the time.
    drop : float, default 0.5
        Greatest share of the points that is left out.
    occlude : float, default 0.3
        Greatest share of the extent that is cut off from one side, half of the time.
    noise : float, default 0.0
        Greatest standard deviation of noise on the coordinates, as a share of half of the object's extent.
    scale : float, default 0.1
        Greatest change of the extent along each axis, as a share.
    outliers : float, default 0.0
        Greatest share of the points that are outliers afterwards.
    hide_intensity : float, default 0.2
        Share of the objects whose intensity is hidden, so that the network can do without.

    Raises
    ------
    ParameterError
        If a share is not in [0, 1), or the noise is negative.
    """

    rotate: bool = True
    drop: float = 0.5
    occlude: float = 0.3
    noise: float = 0.0
    scale: float = 0.1
    outliers: float = 0.0
    hide_intensity: float = 0.2

    def __post_init__(self) -> None:
        for name in ("drop", "occlude", "noise", "scale", "outliers", "hide_intensity"):
            _share(getattr(self, name), f"augmentation.{name}")


@dataclass(frozen=True)
class TrainingParameters:
    """Stochastic gradient descent, and what it sees.

    Parameters
    ----------
    epochs : int, default 80
        Passes over the training objects (luo2019: 150).
    copies : int, default 1
        How often each training object is met in an epoch, changed anew each time (luo2019 does not say). More make
        training longer in the same number of epochs, which the schedule "halving" counts.
    batch_size : int, default 32
        Objects per step (luo2019: 32).
    learning_rate : float, default 0.05
        Greatest rate (luo2019: 0.01 in one place, 0.001 in another).
    momentum : float, default 0.9
        Of the gradient (luo2019: 0.9).
    weight_decay : float, default 0.0005
        Of all weights (luo2019: 0.0005).
    clip : float, default 0.0
        Greatest norm of a step's gradient; longer ones are shortened to it, so that no step of a network without batch
        normalisation leaves rectifiers without any input that moves them. 0 leaves all as they are (luo2019: not said).
    schedule : {"one_cycle", "halving"}, default "one_cycle"
        The rate rises over the first fifth and falls to 0 as a cosine; or it is halved every 20 epochs (luo2019).
    label_smoothing : float, default 0.1
        Share of a target's weight that goes to all classes alike (luo2019: 0).
    augmentation : AugmentationParameters or mapping
        How training objects are changed.
    n_members : int, default 2
        Networks that are trained from different starts; their probabilities are averaged (luo2019: 1).
    n_turns : int, default 4
        Headings that an object is looked at from when it is recognised (luo2019: 1).
    validation : float, default 0.0
        Share of the training objects that are held out for early stopping; 0 trains on all to the last epoch.
    patience : int, default 30
        Epochs without a lower loss on the held-out objects after which training stops.
    device : {"auto", "cpu", "cuda"}, default "auto"
        Where the network runs; "auto" takes a GPU where there is one.
    mixed_precision : bool, default True
        Whether a GPU computes in bfloat16 where that is enough.
    seed : int, default 2019
        Seed of starts, order, changes and held-out objects.

    Raises
    ------
    ParameterError
        If a number is outside its range or a name is unknown.
    """

    epochs: int = 80
    copies: int = 1
    batch_size: int = 32
    learning_rate: float = 0.05
    momentum: float = 0.9
    weight_decay: float = 0.0005
    clip: float = 0.0
    schedule: Literal["one_cycle", "halving"] = "one_cycle"
    label_smoothing: float = 0.1
    augmentation: AugmentationParameters = field(default_factory=AugmentationParameters)
    n_members: int = 2
    n_turns: int = 4
    validation: float = 0.0
    patience: int = 30
    device: Literal["auto", "cpu", "cuda"] = "auto"
    mixed_precision: bool = True
    seed: int = 2019

    def __post_init__(self) -> None:
        if isinstance(self.augmentation, Mapping):
            object.__setattr__(self, "augmentation", AugmentationParameters(**self.augmentation))
        for name in ("epochs", "copies", "n_members", "n_turns", "patience"):
            _whole(getattr(self, name), f"training.{name}")
        _whole(self.batch_size, "training.batch_size", 2)
        _whole(self.seed, "training.seed", 0)
        check_positive(self.learning_rate, "training.learning_rate")
        check_at_least(self.clip, 0.0, "training.clip")
        for name in ("momentum", "weight_decay", "label_smoothing", "validation"):
            _share(getattr(self, name), f"training.{name}")
        for name, known in (("schedule", ("one_cycle", "halving")), ("device", ("auto", "cpu", "cuda"))):
            if getattr(self, name) not in known:
                raise ParameterError(f"training.{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")


@dataclass(frozen=True)
class JointNetParameters:
    """Parameters of JointNet.

    Parameters
    ----------
    inputs : InputParameters or mapping
        What it sees of an object.
    network : NetworkParameters or mapping
        Its layers.
    training : TrainingParameters or mapping
        How it is trained.
    """

    inputs: InputParameters = field(default_factory=InputParameters)
    network: NetworkParameters = field(default_factory=NetworkParameters)
    training: TrainingParameters = field(default_factory=TrainingParameters)

    def __post_init__(self) -> None:
        kinds: dict[str, Any] = {
            "inputs": InputParameters,
            "network": NetworkParameters,
            "training": TrainingParameters,
        }
        for name, kind in kinds.items():
            if isinstance(getattr(self, name), Mapping):
                object.__setattr__(self, name, kind(**getattr(self, name)))

    def with_views(self, *views: str) -> Self:
        """Return the parameters of a network that sees other images.

        Parameters
        ----------
        *views : str
            Kinds of images.

        Returns
        -------
        JointNetParameters
            The parameters, all else alike.
        """
        return replace(self, inputs=replace(self.inputs, views=list(views)))
