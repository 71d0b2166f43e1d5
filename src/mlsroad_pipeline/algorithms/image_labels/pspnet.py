"""The Pyramid Scene Parsing Network on PyTorch. Importing this module imports torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError, ReadError

BINS = (1, 2, 3, 6)
"""Cells along each side of the pyramid's levels."""

MEAN, SPREAD = (123.675, 116.28, 103.53), (58.395, 57.12, 57.375)
"""Of the colours that published weights were trained with, 0 to 255."""


@dataclass(frozen=True)
class Backbone:
    """The sizes of a dilated residual network and of the head on it.

    Parameters
    ----------
    stem : tuple of int
        Channels of the 3 x 3 convolutions before the first stage; the first has stride 2.
    planes : tuple of int
        Channels within the blocks of the four stages.
    blocks : tuple of int
        Blocks per stage.
    expansion : int
        4 for bottlenecks (three convolutions, four times the channels at the end), 1 for basic blocks (two).
    head, auxiliary : int
        Channels of the head and of the auxiliary head.
    fine : int
        Channels taken from the first stage, at a quarter of the image's size, to sharpen the head's result; 0 takes
        none, as in the paper.
    """

    stem: tuple[int, ...]
    planes: tuple[int, int, int, int]
    blocks: tuple[int, int, int, int]
    expansion: int
    head: int
    auxiliary: int
    fine: int = 0


BACKBONES = {
    "resnet50": Backbone((64, 64, 128), (64, 128, 256, 512), (3, 4, 6, 3), 4, 512, 256),
    "resnet101": Backbone((64, 64, 128), (64, 128, 256, 512), (3, 4, 23, 3), 4, 512, 256),
    "small": Backbone((24,), (32, 64, 80, 96), (1, 2, 2, 2), 1, 96, 48, 16),
}
"""ResNet-50 and -101 with the stem of three convolutions that published PSPNets have, and one that a CPU can train."""


class _Block(nn.Module):
    """A residual block; names of the parameters are those of published ResNets."""

    def __init__(self, inputs: int, planes: int, expansion: int, stride: int, dilation: int) -> None:
        super().__init__()
        outputs = planes * expansion
        wide: dict[str, Any] = {"padding": dilation, "dilation": dilation, "bias": False}
        if expansion == 1:
            self.conv1 = nn.Conv2d(inputs, planes, 3, stride, **wide)
            self.conv2 = nn.Conv2d(planes, planes, 3, 1, **wide)
        else:
            self.conv1 = nn.Conv2d(inputs, planes, 1, bias=False)
            self.conv2 = nn.Conv2d(planes, planes, 3, stride, **wide)
            self.conv3 = nn.Conv2d(planes, outputs, 1, bias=False)
            self.bn3 = nn.BatchNorm2d(outputs)
        self.bn1, self.bn2 = nn.BatchNorm2d(planes), nn.BatchNorm2d(planes)
        self.downsample = None
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs))

    def forward(self, x: Tensor) -> Tensor:
        """Return the input plus what the convolutions add."""
        out = self.bn2(self.conv2(functional.relu(self.bn1(self.conv1(x)))))
        if hasattr(self, "conv3"):
            out = self.bn3(self.conv3(functional.relu(out)))
        return functional.relu(out + (x if self.downsample is None else self.downsample(x)))


class _Pyramid(nn.Module):
    """Means over 1 x 1, 2 x 2, 3 x 3 and 6 x 6 regions, laid over the features again."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        outputs = inputs // len(BINS)
        levels = [
            nn.Sequential(
                nn.AdaptiveAvgPool2d(size), nn.Conv2d(inputs, outputs, 1, bias=False), nn.BatchNorm2d(outputs),
                nn.ReLU(inplace=True),
            )
            for size in BINS
        ]  # fmt: skip
        self.features = nn.ModuleList(levels)

    def forward(self, x: Tensor) -> Tensor:
        """Return the features and, beside them, each level of the pyramid."""
        return torch.cat([x, *(_resized(level(x), x.shape[2:]) for level in self.features)], dim=1)


class PSPNet(nn.Module):
    """The Pyramid Scene Parsing Network.

    A dilated ResNet (stages 3 and 4 keep an eighth of the image's size), the pyramid pooling module and a head; an
    auxiliary head on stage 3 helps training. Parameters are named as in published PyTorch weights.

    Parameters
    ----------
    n_classes : int
        Classes, at least 2.
    backbone : str, default "small"
        One of `BACKBONES`.
    dropout : float, default 0.1
        Share of the heads' channels that is left out in training.

    Raises
    ------
    ParameterError
        If the backbone is unknown, there are fewer than 2 classes, or the dropout is outside [0, 1).

    References
    ----------
    .. [1] H. Zhao et al., "Pyramid scene parsing network", CVPR, 2017.
    .. [2] F. Yu, V. Koltun, "Multi-scale context aggregation by dilated convolutions", ICLR, 2016.
    """

    def __init__(self, n_classes: int, *, backbone: str = "small", dropout: float = 0.1) -> None:
        super().__init__()
        if backbone not in BACKBONES:
            raise ParameterError(f"backbone {backbone!r} is unknown (known: {', '.join(BACKBONES)})")
        if n_classes < 2:
            raise ParameterError(f"n_classes must be at least 2, got {n_classes}")
        if not 0 <= dropout < 1:
            raise ParameterError(f"dropout must be in [0, 1), got {dropout!r}")
        size = BACKBONES[backbone]
        self.n_classes, self.backbone = n_classes, backbone
        self.layer0 = _stem(size)
        widths = [size.stem[-1], *(planes * size.expansion for planes in size.planes)]
        # The small network has no pooling in its stem: its first stage halves the image instead.
        strides, dilations = (2 if size.fine else 1, 2, 1, 1), (1, 1, 2, 4)
        stages = [
            _stage(inputs, planes, size, k, strides[k], dilations[k])
            for k, ((inputs, _), planes) in enumerate(zip(pairwise(widths), size.planes, strict=True))
        ]
        self.layer1, self.layer2, self.layer3, self.layer4 = stages
        self.ppm = _Pyramid(widths[-1])
        self.cls = _head(2 * widths[-1], size.head, n_classes, dropout)
        self.aux = _head(widths[-2], size.auxiliary, n_classes, dropout)
        if size.fine:
            self.fine = nn.Sequential(
                nn.Conv2d(widths[1], size.fine, 1, bias=False), nn.BatchNorm2d(size.fine), nn.ReLU(inplace=True)
            )
            self.sharpen = nn.Sequential(
                nn.Conv2d(size.fine + n_classes, 2 * size.fine, 3, padding=1, bias=False),
                nn.BatchNorm2d(2 * size.fine), nn.ReLU(inplace=True), nn.Conv2d(2 * size.fine, n_classes, 1),
            )  # fmt: skip

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return the log odds of the classes.

        Parameters
        ----------
        x : Tensor of shape (images, 3, height, width)
            Colours less `MEAN`, divided by `SPREAD`.

        Returns
        -------
        main, auxiliary : Tensor of shape (images, n_classes, height, width)
            Log odds of the head and of the auxiliary head.
        """
        size = x.shape[2:]
        first = self.layer1(self.layer0(x))
        third = self.layer3(self.layer2(first))
        out = self.cls(self.ppm(self.layer4(third)))
        if hasattr(self, "fine"):
            out = _resized(out, first.shape[2:])
            out = out + self.sharpen(torch.cat([self.fine(first), out], dim=1))
        return _resized(out, size), _resized(self.aux(third), size)


def _stem(size: Backbone) -> nn.Sequential:
    parts: list[nn.Module] = []
    for k, (inputs, outputs) in enumerate(pairwise((3, *size.stem))):
        stride = 2 if k == 0 else 1
        parts += [nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)]
    return nn.Sequential(*parts, *([] if size.fine else [nn.MaxPool2d(3, 2, 1)]))


def _stage(inputs: int, planes: int, size: Backbone, number: int, stride: int, dilation: int) -> nn.Sequential:
    outputs = planes * size.expansion
    first = _Block(inputs, planes, size.expansion, stride, dilation)
    rest = [_Block(outputs, planes, size.expansion, 1, dilation) for _ in range(size.blocks[number] - 1)]
    return nn.Sequential(first, *rest)


def _head(inputs: int, width: int, n_classes: int, dropout: float) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, width, 3, padding=1, bias=False), nn.BatchNorm2d(width), nn.ReLU(inplace=True),
        nn.Dropout2d(dropout), nn.Conv2d(width, n_classes, 1),
    )  # fmt: skip


def _resized(x: Tensor, size: Sequence[int]) -> Tensor:
    return functional.interpolate(x, size=tuple(size), mode="bilinear", align_corners=True)


def network_input(images: NDArray[np.uint8]) -> Tensor:
    """Turn images into what the network takes.

    Parameters
    ----------
    images : ndarray of shape (images, height, width, 3), uint8
        Red, green and blue.

    Returns
    -------
    Tensor of shape (images, 3, height, width)
        Colours less `MEAN`, divided by `SPREAD`.
    """
    scaled = (images.astype(np.float32) - np.array(MEAN, np.float32)) / np.array(SPREAD, np.float32)
    return torch.from_numpy(np.ascontiguousarray(scaled.transpose(0, 3, 1, 2)))


def load_published(path: str | Path, *, n_classes: int = 19, backbone: str = "resnet50") -> PSPNet:
    """Read published PyTorch weights of a PSPNet, such as those trained on Cityscapes.

    Parameters
    ----------
    path : str or Path
        A state dict, bare or below ``state_dict``; names may begin with ``module.``. Nothing but tensors is read from
        the file, no code.
    n_classes : int, default 19
        Classes of the weights.
    backbone : str, default "resnet50"
        ``resnet50`` or ``resnet101``.

    Returns
    -------
    PSPNet
        The network, ready to predict.

    Raises
    ------
    ReadError
        If the file is missing or no state dict.
    DataError
        If names or shapes are not those of the network; see `load_state`.
    """
    source = Path(path)
    if not source.is_file():
        raise ReadError(f"{source}: no such weights")
    try:
        given = torch.load(source, map_location="cpu", weights_only=True)
    except Exception as error:  # torch has no error of its own for a file that is no checkpoint
        raise ReadError(f"{source}: cannot be read as weights without running code: {error}") from error
    state = given.get("state_dict", given) if isinstance(given, dict) else None
    if not isinstance(state, dict) or not all(isinstance(value, Tensor) for value in state.values()):
        raise ReadError(f"{source}: holds no state dict")
    network = PSPNet(n_classes, backbone=backbone)
    load_state(network, state, source=str(source))
    return network.eval()


def load_state(network: PSPNet, state: Mapping[str, Tensor], *, source: str = "weights") -> None:
    """Put weights into a network; those of the auxiliary head may be missing.

    Parameters
    ----------
    network : PSPNet
        The network; changed.
    state : mapping of str to Tensor
        Names, perhaps with ``module.`` before them, to weights.
    source : str, default "weights"
        What messages call them.

    Raises
    ------
    DataError
        If a weight is missing, unknown or of another shape; the message names the first and gives the counts.
    """
    plain = {name.removeprefix("module."): value for name, value in state.items()}
    own = network.state_dict()
    optional = {name for name in own if name.startswith("aux.") or name.endswith("num_batches_tracked")}
    missing = sorted(name for name in own if name not in plain and name not in optional)
    unknown = sorted(name for name in plain if name not in own)
    shapes = [
        f"{name}: {tuple(plain[name].shape)} instead of {tuple(own[name].shape)}"
        for name in own
        if name in plain and plain[name].shape != own[name].shape
    ]
    for what, names in (("missing", missing), ("unknown", unknown), ("of another shape", shapes)):
        if names:
            raise DataError(
                f"{source}: {len(names)} weights are {what} for a PSPNet on {network.backbone} with "
                f"{network.n_classes} classes, the first is {names[0]}"
            )
    network.load_state_dict({**own, **plain})


def to_arrays(network: PSPNet) -> dict[str, NDArray]:
    """Return the weights as arrays, for files that hold no code.

    Parameters
    ----------
    network : PSPNet
        The network.

    Returns
    -------
    dict of str to ndarray
        Name to weights.
    """
    return {name: value.numpy().copy() for name, value in network.state_dict().items()}


def from_arrays(arrays: Mapping[str, NDArray], *, n_classes: int, backbone: str) -> PSPNet:
    """Build a network from the arrays of `to_arrays`.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        Name to weights.
    n_classes : int
        Classes.
    backbone : str
        One of `BACKBONES`.

    Returns
    -------
    PSPNet
        The network, ready to predict.

    Raises
    ------
    DataError
        If names or shapes are not those of the network.
    """
    network = PSPNet(n_classes, backbone=backbone)
    load_state(network, {name: torch.from_numpy(np.array(value)) for name, value in arrays.items()})
    return network.eval()
