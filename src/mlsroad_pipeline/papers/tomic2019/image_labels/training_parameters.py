"""Parameters of the image-based labeller and of its training, importable without torch."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from numbers import Real

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive, parse_groups


@dataclass(frozen=True)
class TrainingParameters:
    """Parameters of the training of a PSPNet; the defaults suit the small backbone and five minutes on two cores."""

    # ``small``, ``resnet50`` or ``resnet101``; the PSPNet paper uses ResNets pre-trained on ImageNet
    backbone: str = "small"
    n_steps: int = 1150  # Number of batches. Larger improves the scores and takes longer.
    # Crops per batch; 16 in the PSPNet paper. At equal training time more steps with fewer crops score better, down to
    # 6.
    batch_size: int = 6
    crop: int = 320  # Side of the crops, pixels; 713 on Cityscapes. Larger gives more context.
    # Range of the scale of a crop; 0.5 to 2 in the PSPNet paper. The default suits images of 480 pixels width and 75
    # degrees field of view; halve it for 960 pixels, where objects are twice as large.
    scale: tuple[float, float] = (1.0, 2.2)
    flip: bool = True  # Mirror half of the crops
    # Share of the crops placed around a pixel of a class drawn uniformly; the image is drawn with the root of its
    # pixels of that class as weight. The other crops are placed at random. Larger shows rare classes more often. 0 in
    # the PSPNet paper.
    class_crops: float = 0.5
    # Muon converges fastest from random weights, then AdamW; the PSPNet paper uses stochastic gradient descent
    optimiser: str = "muon"
    # Initial learning rate; it falls as (1 - step / n_steps) ** 0.9. 0.005 and 0.02 score the same with muon; use
    # 0.003 with adamw, 0.01 with sgd for pre-trained ResNets.
    learning_rate: float = 0.01
    warm_up: int = 50  # Steps of linear warm-up of the learning rate
    momentum: float = 0.95  # Momentum of muon and sgd (PSPNet paper: 0.9); adamw does not use it
    weight_decay: float = 0.01  # Weight decay; larger keeps the weights smaller. 0.0001 in the PSPNet paper, with sgd.
    dropout: float = 0.1  # Dropout rate of the channels of the heads
    # Exponent of the inverse class frequency in the weights of pixels; 0 is unweighted, larger favours rare classes
    class_balance: float = 0.4
    # Precision of products in training; weights and sums are float32. ``auto`` is bfloat16 if the processor has
    # instructions for it, which halves the time.
    precision: str = "auto"
    n_threads: int = 1  # Threads of torch; the weights differ in the last digits between numbers of threads
    random_state: int = 0  # Seed of the initial weights and of the crops

    def __post_init__(self) -> None:
        for name, least in (
            ("n_steps", 1), ("batch_size", 2), ("crop", 17), ("warm_up", 1), ("n_threads", 1), ("random_state", 0)
        ):  # fmt: skip
            value = getattr(self, name)
            if isinstance(value, bool) or value != int(value) or value < least:
                raise ParameterError(f"{name} must be an integer >= {least}, got {value!r}")
        check_positive(self.learning_rate, "learning_rate")
        low, high = self.scale
        if not 0 < low <= high < np.inf:
            raise ParameterError(f"scale must be two numbers with 0 < least <= largest, got {self.scale!r}")
        for name in (
            "momentum", "weight_decay", "dropout", "class_balance"
        ):  # fmt: skip
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0:
                raise ParameterError(f"{name} must be a finite number >= 0, got {value!r}")
        if not 0 <= self.class_crops <= 1:
            raise ParameterError(f"class_crops must be in [0, 1], got {self.class_crops!r}")
        for name, known in (("optimiser", ("muon", "adamw", "sgd")), ("precision", ("auto", "float32", "bfloat16"))):
            if getattr(self, name) not in known:
                raise ParameterError(f"{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")


IMAGENET_MEAN, IMAGENET_SPREAD = (123.675, 116.28, 103.53), (58.395, 57.12, 57.375)
"""Mean and standard deviation of colours in the training of published weights, 0 to 255."""

TRAINED_AT = (1.4, 1.8)
"""Magnifications that suit the network of this package on images of 480 pixels width."""


@dataclass(frozen=True)
class ImageLabelsParameters:
    """Parameters of the image-based labeller."""

    # Largest distance of a camera from the bounding box of a scene, metres; images farther away are not segmented.
    # Larger uses more images, which show the points on fewer pixels.
    reach: float = 30.0
    calibration: str = "calibration.json"  # Name of the file of cameras and poses beside the point files
    labels: str = "labels"  # Folder of the label images for training, beside the folder of the images
    # Folder of segmented images (PNG of class numbers or NPZ of probabilities), or the name of such a folder beside the
    # pictures. They take the place of the network.
    masks: str | None = None
    # File of a network to use in place of a trained one: published weights of a PSPNet, or an ONNX model
    weights: str | None = None
    # Class map of `masks` or `weights`: ``cityscapes``, ``scheme`` (the classes of the scheme, then the sky), or a CSV
    # or YAML file
    classes: str = "cityscapes"
    # Class scheme of the points where `label` uses `masks` or `weights` without a registered model
    scheme: str = "road_inventory"
    # Enlargement of images before segmentation; with several factors the geometric mean of the probabilities is taken.
    # Larger improves thin objects and takes longer. None is 1 with `weights`, else (1.4, 1.8), which suits images of
    # 480 pixels width, like ``network.scale``.
    magnification: float | tuple[float, ...] | None = None
    # Height and width of the sliding windows in which an image is segmented, pixels; None segments it as a whole. The
    # paper's network was trained on windows of 713 pixels.
    window: tuple[int, int] | None = None
    # Smallest overlap of neighbouring windows, as a share; larger smooths seams and takes longer
    overlap: float = 1 / 3
    flip: bool = False  # Average with the segmentation of the mirrored image, which takes twice as long
    # Mean of red, green and blue in the training of `weights`, 0 to 255; the default is that of ImageNet
    mean: tuple[float, ...] = IMAGENET_MEAN
    spread: tuple[float, ...] = IMAGENET_SPREAD  # Standard deviation of the same
    device: str = "auto"  # Where the network is trained and images are segmented; ``auto`` is a GPU if there is one
    # Which points an image shows: a depth buffer of discs, or hidden point removal, as in the paper
    visibility: str = "depth_buffer"
    network: TrainingParameters = field(default_factory=TrainingParameters)  # Parameters of the training

    def __post_init__(self) -> None:
        parse_groups(self, network=TrainingParameters)
        check_positive(self.reach, "reach")
        given = (TRAINED_AT if self.weights is None else 1.0) if self.magnification is None else self.magnification
        object.__setattr__(self, "magnification", check_magnifications(given))
        for name in ("calibration", "labels", "classes", "scheme", "masks", "weights"):
            value = getattr(self, name)
            if (value is not None or name not in ("masks", "weights")) and not (isinstance(value, str) and value):
                raise ParameterError(f"{name} must be a name, got {value!r}")
        if self.masks is not None and self.weights is not None:
            raise ParameterError(f"masks {self.masks!r} and weights {self.weights!r} are both given: set one to null")
        self._check_segmentation()

    def _check_segmentation(self) -> None:
        if self.window is not None:
            sides = tuple(self.window) if isinstance(self.window, Sequence) else (self.window,)
            if len(sides) != 2 or any(type(side) is not int or side < 1 for side in sides):
                raise ParameterError(f"window must be height and width in pixels, got {self.window!r}")
            object.__setattr__(self, "window", sides)
        if not _is_number(self.overlap) or not 0 <= self.overlap < 1:
            raise ParameterError(f"overlap must be in [0, 1), got {self.overlap!r}")
        if not isinstance(self.flip, bool):
            raise ParameterError(f"flip must be true or false, got {self.flip!r}")
        for name in ("mean", "spread"):
            object.__setattr__(self, name, _colour(getattr(self, name), name, positive=name == "spread"))
        for name, known in (("device", ("auto", "cpu", "cuda")), ("visibility", ("depth_buffer", "hidden_points"))):
            if getattr(self, name) not in known:
                raise ParameterError(f"{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")

    @property
    def magnifications(self) -> tuple[float, ...]:
        """Return the enlargements of images."""
        return check_magnifications(TRAINED_AT if self.magnification is None else self.magnification)

    @property
    def own_segmentation(self) -> bool:
        """Return whether images are segmented by masks or by a network trained elsewhere."""
        return self.masks is not None or self.weights is not None


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(float(value))


def _colour(given: object, name: str, *, positive: bool) -> tuple[float, ...]:
    """Return three numbers for red, green and blue, or raise ParameterError."""
    values = tuple(given) if isinstance(given, Sequence) else ()
    if len(values) != 3 or not all(_is_number(value) for value in values) or (positive and min(values) <= 0):
        more = " above 0" if positive else ""
        raise ParameterError(f"{name} must be three numbers{more} for red, green and blue, got {given!r}")
    return tuple(float(value) for value in values)


def check_magnifications(given: float | Sequence[float]) -> tuple[float, ...]:
    """Validate magnifications and return them as a tuple."""
    several = tuple(given) if isinstance(given, Sequence) else (given,)
    if not several:
        raise ParameterError("magnification must be a positive number or several, got none")
    for factor in several:
        check_positive(factor, "magnification")
    return several
