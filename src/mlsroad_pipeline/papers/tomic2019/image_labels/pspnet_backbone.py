"""Dilated residual networks, the backbones of PSPNet. Importing this module imports torch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from torch import Tensor, nn
from torch.nn import functional


@dataclass(frozen=True)
class Backbone:
    """Layer sizes of a dilated residual network and of its head."""

    # Channels of the convolutions before the first stage; with a decoder each of them halves the resolution
    stem: tuple[int, ...]
    planes: tuple[int, int, int, int]  # Channels within the blocks of the four stages
    blocks: tuple[int, int, int, int]  # Blocks per stage
    # 4 for bottleneck blocks (three convolutions, four times the channels at the end), 1 for basic blocks (two)
    expansion: int
    head: int  # Channels of the head and of the auxiliary head
    auxiliary: int  # Channels of the head and of the auxiliary head
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
