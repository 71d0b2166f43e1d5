"""Parameters of the images' labeller and of its network's training, readable without torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mlsroad_pipeline.algorithms.exceptions import ParameterError
from mlsroad_pipeline.algorithms.validation import check_positive


@dataclass(frozen=True)
class TrainingParameters:
    """How a PSPNet is trained; defaults suit the small backbone on two cores.

    Parameters
    ----------
    backbone : str, default "small"
        ``small``, ``resnet50`` or ``resnet101``; the paper's are ResNets that were trained on ImageNet before.
    n_steps : int, default 1000
        Batches. More is better and takes longer.
    batch_size : int, default 6
        Crops per batch; 16 in the PSPNet's paper.
    crop : int, default 225
        Side of the crops, pixels; 713 on Cityscapes. Larger shows more of a scene.
    scale : tuple of float, default (0.5, 1.5)
        Least and largest scale of a crop; 0.5 to 2 in the PSPNet's paper.
    flip : bool, default True
        Whether half of the crops are mirrored.
    learning_rate : float, default 0.04
        At the start; falls as (1 - step / n_steps) ** `power`. 0.01 for ResNets that were trained before.
    power : float, default 0.9
        Of that polynomial.
    warm_up : int, default 30
        Steps in which the rate rises to its start.
    momentum : float, default 0.9
        Of the stochastic gradient descent.
    weight_decay : float, default 0.0001
        Of the stochastic gradient descent; larger keeps the weights smaller.
    auxiliary_weight : float, default 0.4
        Weight of the auxiliary head's loss.
    dropout : float, default 0.1
        Share of the heads' channels that is left out.
    class_balance : float, default 0.3
        Power of the inverse class frequency by which pixels weigh; 0 is none, larger favours rare classes.
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
    n_steps: int = 1000
    batch_size: int = 6
    crop: int = 225
    scale: tuple[float, float] = (0.5, 1.5)
    flip: bool = True
    learning_rate: float = 0.04
    power: float = 0.9
    warm_up: int = 30
    momentum: float = 0.9
    weight_decay: float = 1e-4
    auxiliary_weight: float = 0.4
    dropout: float = 0.1
    class_balance: float = 0.3
    n_threads: int = 1
    random_state: int = 0

    def __post_init__(self) -> None:
        for name, least in (
            ("n_steps", 1),
            ("batch_size", 2),
            ("crop", 17),
            ("warm_up", 1),
            ("n_threads", 1),
            ("random_state", 0),
        ):
            value = getattr(self, name)
            if isinstance(value, bool) or value != int(value) or value < least:
                raise ParameterError(f"{name} must be an integer >= {least}, got {value!r}")
        check_positive(self.learning_rate, "learning_rate")
        low, high = self.scale
        if not 0 < low <= high < np.inf:
            raise ParameterError(f"scale must be two numbers with 0 < least <= largest, got {self.scale!r}")
        for name in ("power", "momentum", "weight_decay", "auxiliary_weight", "dropout", "class_balance"):
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0:
                raise ParameterError(f"{name} must be a finite number >= 0, got {value!r}")


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
    network: TrainingParameters = field(default_factory=TrainingParameters)

    def __post_init__(self) -> None:
        if isinstance(self.network, Mapping):
            object.__setattr__(self, "network", TrainingParameters(**self.network))
        check_positive(self.reach, "reach")
        for name in ("calibration", "labels"):
            if not getattr(self, name):
                raise ParameterError(f"{name} must be a name, got {getattr(self, name)!r}")
