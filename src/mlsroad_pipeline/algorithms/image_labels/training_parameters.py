"""Parameters of the image-based labeller and of its training, importable without torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive


@dataclass(frozen=True)
class TrainingParameters:
    """Parameters of the training of a PSPNet; the defaults suit the small backbone and five minutes on two cores.

    Parameters
    ----------
    backbone : str, default "small"
        ``small``, ``resnet50`` or ``resnet101``; the PSPNet paper uses ResNets pre-trained on ImageNet.
    n_steps : int, default 1150
        Number of batches. Larger improves the scores and takes longer.
    batch_size : int, default 6
        Crops per batch; 16 in the PSPNet paper. At equal training time more steps with fewer crops score better, down
        to 6.
    crop : int, default 320
        Side of the crops, pixels; 713 on Cityscapes. Larger gives more context.
    scale : tuple of float, default (1.0, 2.2)
        Range of the scale of a crop; 0.5 to 2 in the PSPNet paper. The default suits images of 480 pixels width and 75
        degrees field of view; halve it for 960 pixels, where objects are twice as large.
    flip : bool, default True
        Mirror half of the crops.
    class_crops : float, default 0.5
        Share of the crops placed around a pixel of a class drawn uniformly; the image is drawn with the root of its
        pixels of that class as weight. The other crops are placed at random. Larger shows rare classes more often. 0 in
        the PSPNet paper.
    optimiser : {"muon", "adamw", "sgd"}, default "muon"
        Muon converges fastest from random weights, then AdamW; the PSPNet paper uses stochastic gradient descent.
    learning_rate : float, default 0.01
        Initial learning rate; it falls as (1 - step / n_steps) ** `power`. 0.005 and 0.02 score the same with muon; use
        0.003 with adamw, 0.01 with sgd for pre-trained ResNets.
    power : float, default 0.9
        Exponent of that polynomial.
    warm_up : int, default 50
        Steps of linear warm-up of the learning rate.
    momentum : float, default 0.95
        Momentum of muon and sgd (PSPNet paper: 0.9); adamw does not use it.
    weight_decay : float, default 0.01
        Weight decay; larger keeps the weights smaller. 0.0001 in the PSPNet paper, with sgd.
    auxiliary_weight : float, default 0.4
        Weight of the auxiliary head's loss.
    overlap_weight : float, default 1.0
        Weight of the soft IoU loss beside the cross entropy; 0 in the PSPNet paper. Larger favours rare classes, since
        all classes have the same weight in the mean IoU.
    dropout : float, default 0.1
        Dropout rate of the channels of the heads.
    class_balance : float, default 0.4
        Exponent of the inverse class frequency in the weights of pixels; 0 is unweighted, larger favours rare classes.
    precision : {"auto", "float32", "bfloat16"}, default "auto"
        Precision of products in training; weights and sums are float32. ``auto`` is bfloat16 if the processor has
        instructions for it, which halves the time.
    n_threads : int, default 1
        Threads of torch; the weights differ in the last digits between numbers of threads.
    random_state : int, default 0
        Seed of the initial weights and of the crops.

    Raises
    ------
    ParameterError
        If a value is outside its domain.
    """

    backbone: str = "small"
    n_steps: int = 1150
    batch_size: int = 6
    crop: int = 320
    scale: tuple[float, float] = (1.0, 2.2)
    flip: bool = True
    class_crops: float = 0.5
    optimiser: str = "muon"
    learning_rate: float = 0.01
    power: float = 0.9
    warm_up: int = 50
    momentum: float = 0.95
    weight_decay: float = 0.01
    auxiliary_weight: float = 0.4
    overlap_weight: float = 1.0
    dropout: float = 0.1
    class_balance: float = 0.4
    precision: str = "auto"
    n_threads: int = 1
    random_state: int = 0

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
            "power", "momentum", "weight_decay", "auxiliary_weight", "overlap_weight", "dropout", "class_balance"
        ):  # fmt: skip
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0:
                raise ParameterError(f"{name} must be a finite number >= 0, got {value!r}")
        if not 0 <= self.class_crops <= 1:
            raise ParameterError(f"class_crops must be in [0, 1], got {self.class_crops!r}")
        for name, known in (("optimiser", ("muon", "adamw", "sgd")), ("precision", ("auto", "float32", "bfloat16"))):
            if getattr(self, name) not in known:
                raise ParameterError(f"{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")


@dataclass(frozen=True)
class ImageLabelsParameters:
    """Parameters of the image-based labeller.

    Parameters
    ----------
    reach : float, default 30.0
        Largest distance of a camera from the bounding box of a scene, metres; images farther away are not segmented.
        Larger uses more images, which show the points on fewer pixels.
    calibration : str, default "calibration.json"
        Name of the file of cameras and poses beside the point files.
    labels : str, default "labels"
        Folder of the label images for training, beside the folder of the images.
    magnification : float or tuple of float, default (1.4, 1.8)
        Enlargement of images before segmentation; with several factors the geometric mean of the probabilities is
        taken. The default suits images of 480 pixels width, like that of ``network.scale``. Larger improves thin
        objects and takes longer.
    network : TrainingParameters or mapping
        Parameters of the training.

    Raises
    ------
    ParameterError
        If a value is outside its domain.
    """

    reach: float = 30.0
    calibration: str = "calibration.json"
    labels: str = "labels"
    magnification: float | tuple[float, ...] = (1.4, 1.8)
    network: TrainingParameters = field(default_factory=TrainingParameters)

    def __post_init__(self) -> None:
        if isinstance(self.network, Mapping):
            object.__setattr__(self, "network", TrainingParameters(**self.network))
        check_positive(self.reach, "reach")
        object.__setattr__(self, "magnification", check_magnifications(self.magnification))
        for name in ("calibration", "labels"):
            if not getattr(self, name):
                raise ParameterError(f"{name} must be a name, got {getattr(self, name)!r}")


def check_magnifications(given: float | Sequence[float]) -> tuple[float, ...]:
    """Validate magnifications and return them as a tuple.

    Parameters
    ----------
    given : float or sequence of float
        Enlargements of images before segmentation.

    Returns
    -------
    tuple of float
        The factors, at least one.

    Raises
    ------
    ParameterError
        If there are none, or one is not a positive, finite number.
    """
    several = tuple(given) if isinstance(given, Sequence) else (given,)
    if not several:
        raise ParameterError("magnification must be a positive number or several, got none")
    for factor in several:
        check_positive(factor, "magnification")
    return several
