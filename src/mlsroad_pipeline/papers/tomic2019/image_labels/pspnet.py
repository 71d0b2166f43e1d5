"""Pyramid Scene Parsing Network in PyTorch, with its backbones. Importing this module imports torch."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import IMAGENET_MEAN, IMAGENET_SPREAD


@dataclass(frozen=True)
class Backbone:
    """Layer sizes of a dilated residual network and of its head."""

    # Channels of the convolutions before the first stage; with a decoder each of them halves the resolution
    stem: tuple[int, ...]
    planes: tuple[int, int, int, int]  # Channels within the blocks of the four stages
    blocks: tuple[int, int, int, int]  # Blocks per stage
    # 4 for bottleneck blocks (three convolutions, four times the channels at the end), 1 for basic blocks (two)
    expansion: int
    # head, auxiliary: channels of the head and of the auxiliary head
    head: int
    auxiliary: int
    # Channels of the decoder at the resolutions of the third, second and first stage and of the stem, with skip
    # connections; each stage then halves the resolution instead of being dilated. Empty for no decoder, as in the
    # paper.
    decoder: tuple[int, ...] = ()
    # Halve the dilation in the first block of a dilated stage, as the dilated ResNets of mmsegmentation and of MIT
    # CSAIL do
    contracted: bool = False
    # Interpolate so that the centres of the corner pixels coincide (PSPNet's own code); otherwise their outer edges
    corners: bool = True

    @property
    def widths(self) -> tuple[int, ...]:
        """Channels after the stem and after each stage."""
        return (self.stem[-1], *(planes * self.expansion for planes in self.planes))


_RESNET_50 = Backbone((64, 64, 128), (64, 128, 256, 512), (3, 4, 6, 3), 4, 512, 256)
_RESNET_101 = replace(_RESNET_50, blocks=(3, 4, 23, 3))

BACKBONES = {
    "resnet50": _RESNET_50,
    "resnet101": _RESNET_101,
    "resnet50_csail": replace(_RESNET_50, contracted=True, corners=False),
    "resnet101_csail": replace(_RESNET_101, contracted=True, corners=False),
    "resnet50_mmseg": replace(_RESNET_50, stem=(32, 32, 64), contracted=True, corners=False),
    "resnet101_mmseg": replace(_RESNET_101, stem=(32, 32, 64), contracted=True, corners=False),
    "small": Backbone((16, 24), (48, 96, 144, 192), (1, 2, 2, 2), 1, 128, 48, (96, 64, 32, 24)),
}
"""ResNet-50 and -101 with the three-convolution stem of published PSPNets (semseg, MIT CSAIL, mmsegmentation), and a
small one for training on CPUs."""


class Block(nn.Module):
    """Residual block; the names of parameters are those of published ResNets."""

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
        """Return the residual sum."""
        out = self.bn2(self.conv2(functional.relu(self.bn1(self.conv1(x)))))
        if hasattr(self, "conv3"):
            out = self.bn3(self.conv3(functional.relu(out)))
        return functional.relu(out + (x if self.downsample is None else self.downsample(x)))


def make_stem(size: Backbone) -> nn.Sequential:
    """Return the convolutions before the first stage, which reduce the image to a quarter of its size."""
    parts: list[nn.Module] = []
    for k, (inputs, outputs) in enumerate(pairwise((3, *size.stem))):
        wide, stride = (5, 2) if k == 0 and size.decoder else (3, 2 if k == 0 or size.decoder else 1)
        parts += [nn.Conv2d(inputs, outputs, wide, stride, wide // 2, bias=False), *normalised(outputs)]
    return nn.Sequential(*parts, *([] if size.decoder else [nn.MaxPool2d(3, 2, 1)]))


def make_stages(size: Backbone) -> list[nn.Sequential]:
    """Return the four stages."""
    strides, dilations = ((2, 2, 2, 2), (1, 1, 1, 1)) if size.decoder else ((1, 2, 1, 1), (1, 1, 2, 4))
    stages = []
    for k, planes in enumerate(size.planes):
        contracted = size.contracted and dilations[k] > 1
        first_dilation = dilations[k] // 2 if contracted else dilations[k]
        first = Block(size.widths[k], planes, size.expansion, strides[k], first_dilation)
        others = [Block(size.widths[k + 1], planes, size.expansion, 1, dilations[k]) for _ in range(size.blocks[k] - 1)]
        stages.append(nn.Sequential(first, *others))
    return stages


def normalised(width: int) -> tuple[nn.Module, nn.Module]:
    """Return batch normalisation and ReLU for the output of a convolution."""
    return nn.BatchNorm2d(width), nn.ReLU(inplace=True)


def resized(x: Tensor, size: Sequence[int], *, corners: bool = True) -> Tensor:
    """Return features interpolated to another size."""
    return functional.interpolate(x, size=tuple(size), mode="bilinear", align_corners=corners)


BINS = (1, 2, 3, 6)
"""Cells along each side of the levels of the pyramid."""

MEAN, SPREAD = IMAGENET_MEAN, IMAGENET_SPREAD


class _Pyramid(nn.Module):
    """Pyramid pooling: means over 1 x 1, 2 x 2, 3 x 3 and 6 x 6 regions, upsampled and concatenated."""

    def __init__(self, inputs: int, corners: bool) -> None:
        super().__init__()
        self.corners, outputs = corners, inputs // len(BINS)
        levels = [
            nn.Sequential(
                nn.AdaptiveAvgPool2d(size), nn.Conv2d(inputs, outputs, 1, bias=False), *normalised(outputs)
            )
            for size in BINS
        ]  # fmt: skip
        self.features = nn.ModuleList(levels)

    def forward(self, x: Tensor) -> Tensor:
        """Return the features concatenated with each level of the pyramid."""
        size = x.shape[2:]
        return torch.cat([x, *(resized(level(x), size, corners=self.corners) for level in self.features)], dim=1)


class _Decoder(nn.Module):
    """Decoder with skip connections from the stages of the backbone."""

    def __init__(self, inputs: int, skipped: Sequence[int], widths: Sequence[int], n_classes: int) -> None:
        super().__init__()
        self.levels = nn.ModuleList(
            nn.Sequential(nn.Conv2d(before + beside, after, 3, padding=1, bias=False), *normalised(after))
            for before, beside, after in zip((inputs, *widths), skipped, widths, strict=False)
        )
        self.pixels = nn.Conv2d(widths[-1], 4 * n_classes, 1)

    def forward(self, x: Tensor, skipped: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
        """Return log odds at twice the size of the last features, and the features of the first level."""
        levels = []
        for level, beside in zip(self.levels, skipped, strict=True):
            rows, columns = beside.shape[2:]
            twice = functional.interpolate(x, scale_factor=2.0)[:, :, :rows, :columns]  # smoothed by the convolution
            x = level(torch.cat([twice, beside], dim=1))
            levels.append(x)
        return functional.pixel_shuffle(self.pixels(x), 2), levels[0]


class PSPNet(nn.Module):
    """Pyramid Scene Parsing Network.

    A dilated ResNet (stages 3 and 4 keep an eighth of the size of the image), the pyramid pooling module and a head,
    with an auxiliary head on stage 3 in training. Parameters are named as in published PyTorch weights.
    """

    def __init__(self, n_classes: int, *, backbone: str = "small", dropout: float = 0.1) -> None:
        super().__init__()
        if backbone not in BACKBONES:
            raise ParameterError(f"backbone {backbone!r} is unknown (known: {', '.join(BACKBONES)})")
        check_at_least(n_classes, 2, "n_classes")
        if not 0 <= dropout < 1:
            raise ParameterError(f"dropout must be in [0, 1), got {dropout!r}")
        size = BACKBONES[backbone]
        self.n_classes, self.backbone = n_classes, backbone
        self.mean, self.spread = MEAN, SPREAD
        self.layer0 = make_stem(size)
        self.layer1, self.layer2, self.layer3, self.layer4 = make_stages(size)
        self.ppm, self.corners = _Pyramid(size.widths[-1], size.corners), size.corners
        self.cls = _head(2 * size.widths[-1], size.head, dropout, None if size.decoder else n_classes)
        self.decoder = _Decoder(size.head, size.widths[-2::-1], size.decoder, n_classes) if size.decoder else None
        self.aux = _head(size.decoder[0] if size.decoder else size.widths[-2], size.auxiliary, dropout, n_classes)

    @property
    def device(self) -> torch.device:
        """Return the device of the weights."""
        return next(self.parameters()).device

    def end_layers(self) -> list[nn.Module]:
        """Return the input layer and the output layers."""
        return [self.layer0[0], self.cls[-1] if self.decoder is None else self.decoder.pixels, self.aux[-1]]

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return the log odds of the classes."""
        height, width = x.shape[2:]
        stem = self.layer0(x)
        first = self.layer1(stem)
        second = self.layer2(first)
        third = self.layer3(second)
        out = self.cls(self.ppm(self.layer4(third)))
        if self.decoder is None:
            whole = [resized(scores, (height, width), corners=self.corners) for scores in (out, self.aux(third))]
            return whole[0], whole[1]
        main, level = self.decoder(out, (third, second, first, stem))
        return main if self.training else _every_pixel(main, height, width), self.aux(level)


def _head(inputs: int, width: int, dropout: float, n_classes: int | None) -> nn.Sequential:
    parts = [nn.Conv2d(inputs, width, 3, padding=1, bias=False), *normalised(width), nn.Dropout2d(dropout)]
    return nn.Sequential(*parts, *([] if n_classes is None else [nn.Conv2d(width, n_classes, 1)]))


def _every_pixel(x: Tensor, height: int, width: int) -> Tensor:
    """Return values of every second pixel, interpolated to all pixels."""
    between = resized(x, [2 * side - 1 for side in x.shape[2:]])
    return functional.pad(between, (0, 1, 0, 1), mode="replicate")[:, :, :height, :width]


def network_input(
    images: NDArray[np.uint8], *, mean: Sequence[float] = MEAN, spread: Sequence[float] = SPREAD
) -> Tensor:
    """Standardise images for the network."""
    colours = torch.tensor(images).permute(0, 3, 1, 2)  # channels last in memory: faster
    middle, scale = (torch.tensor([float(v) for v in values])[:, None, None] for values in (mean, spread))
    return (colours.float() - middle) / scale
