"""Pyramid Scene Parsing Network in PyTorch. Importing this module imports torch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet_backbone import (
    BACKBONES,
    make_stages,
    make_stem,
    normalised,
    resized,
)
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import IMAGENET_MEAN, IMAGENET_SPREAD

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
