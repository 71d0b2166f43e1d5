"""Parameters of the images' labeller and of its network's training, readable without torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive


@dataclass(frozen=True)
class TrainingParameters:
    """How a PSPNet is trained; defaults suit the small backbone and five minutes on two cores.

    Parameters
    ----------
    backbone : str, default "small"
        ``small``, ``resnet50`` or ``resnet101``; the paper's are ResNets that were trained on ImageNet before.
    n_steps : int, default 1150
        Batches. More is better and takes longer.
    batch_size : int, default 6
        Crops per batch; 16 in the PSPNet's paper. In a given time more steps of fewer crops do
        better, down to 6.
    crop : int, default 320
        Side of the crops, pixels; 713 on Cityscapes. Larger shows more of a scene.
    scale : tuple of float, default (1.0, 2.2)
        Least and largest scale of a crop; 0.5 to 2 in the PSPNet's paper. The default suits images of 480 pixels width
        and 75 degrees; those of 960 want half of it, since things are twice as large on them.
    flip : bool, default True
        Whether half of the crops are mirrored.
    class_crops : float, default 0.5
        Share of the crops that are laid around a pixel of a class drawn evenly from all, in an image drawn by the root
        of its pixels of that class; the others lie anywhere. Larger shows more of the rare classes, which are few and
        small. 0 in the PSPNet's paper.
    optimiser : {"muon", "adamw", "sgd"}, default "muon"
        Muon learns fastest from random weights, AdamW faster than stochastic gradient descent, which is the PSPNet's.
    learning_rate : float, default 0.01
        At the start; falls as (1 - step / n_steps) ** `power`. 0.005 and 0.02 do as well with
        muon; 0.003 with adamw, 0.01 with sgd for ResNets that were trained before.
    power : float, default 0.9
        Of that polynomial.
    warm_up : int, default 50
        Steps in which the rate rises to its start.
    momentum : float, default 0.95
        Share of the former gradients in a step of muon and of sgd, where the PSPNet has 0.9; adamw does not use it.
    weight_decay : float, default 0.01
        Larger keeps the weights smaller; 0.0001 in the PSPNet's paper, with sgd.
    auxiliary_weight : float, default 0.4
        Weight of the auxiliary head's loss.
    overlap_weight : float, default 1.0
        Weight of 1 less the mean IoU of probabilities, beside the cross-entropy; 0 in the PSPNet's paper. Larger
        favours rare classes, each of which counts as much as a common one.
    dropout : float, default 0.1
        Share of the heads' channels that is left out.
    class_balance : float, default 0.4
        Power of the inverse class frequency by which pixels weigh; 0 is none, larger favours rare classes.
    precision : {"auto", "float32", "bfloat16"}, default "auto"
        Of products in training; weights and sums are float32. ``auto`` is bfloat16 where the processor has
        instructions for it, which takes half the time.
    n_threads : int, default 1
        Threads that torch may use; sums, and so the weights, differ in their last digits with it.
    random_state : int, default 0
        Weights, crops and their order follow from it.

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
    """How points are labelled through the images of a survey.

    Parameters
    ----------
    reach : float, default 30.0
        Farthest camera from the points of a scene whose images are looked at, metres. Farther images show the points
        on fewer pixels, and each one costs a segmentation.
    calibration : str, default "calibration.json"
        Name of the file of cameras and poses in the folder of the points.
    labels : str, default "labels"
        Folder of the label images beside that of the pictures; the network learns from them.
    magnification : float or tuple of float, default (1.4, 1.8)
        Factors by which the network sees the images enlarged; with several it looks as often, and the geometric mean of
        the probabilities is taken. The default suits images of 480 pixels width, as that of the network's `scale` does.
        Larger finds thin things better and takes longer.
    network : TrainingParameters or mapping
        How the network is trained.

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
    """Return one factor or several as several.

    Parameters
    ----------
    given : float or sequence of float
        Factors by which a network sees images enlarged.

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
