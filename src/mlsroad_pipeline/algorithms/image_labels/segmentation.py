"""A PSPNet applied to images of any size. Importing this module imports torch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.image_labels.pspnet import PSPNet, network_input
from mlsroad_pipeline.algorithms.image_labels.training_parameters import check_magnifications
from mlsroad_pipeline.algorithms.models.torch_training import limited_threads


def segment_image(
    network: PSPNet, image: NDArray[np.uint8], *, window: tuple[int, int] | None = None, overlap: float = 1 / 3,
    flip: bool = False, magnification: float | Sequence[float] = 1.0, n_threads: int = 1,
) -> NDArray[np.float32]:  # fmt: skip
    """Give every pixel the probabilities of the classes.

    Parameters
    ----------
    network : PSPNet
        The network.
    image : ndarray of shape (height, width, 3), uint8
        The image.
    window : tuple of int, optional
        Height and width of the windows that slide over the image, pixels; None shows the network all of it at once.
        Published weights were trained on windows of 713 pixels and do best with them.
    overlap : float, default 1/3
        Least share of a window that overlaps the next, in [0, 1); more smooths seams and takes longer.
    flip : bool, default False
        Whether the mirrored image is segmented too, and the geometric mean taken.
    magnification : float or sequence of float, default 1.0
        Factor by which the network sees the image enlarged. Above 1 thin things are found better and it takes longer.
        With several the network looks as often, and the geometric mean of the probabilities is taken.
    n_threads : int, default 1
        Threads that torch may use.

    Returns
    -------
    ndarray of shape (height, width, classes), float32
        Probabilities; means where windows overlap.

    Raises
    ------
    DataError
        If the image is not (height, width, 3) of uint8.
    ParameterError
        If a window's side is below 1, the overlap outside [0, 1), or no magnification is given or one is not positive.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise DataError(f"an image must have shape (height, width, 3) and be uint8, got {image.shape} {image.dtype}")
    if not 0 <= overlap < 1:
        raise ParameterError(f"overlap must be in [0, 1), got {overlap!r}")
    magnifications = check_magnifications(magnification)
    height, width = image.shape[:2]
    rows, columns = (height, width) if window is None else window
    if min(rows, columns) < 1:
        raise ParameterError(f"a window's sides must be at least 1 pixel, got {window}")
    rows, columns = min(rows, height), min(columns, width)
    total = np.zeros((height, width, network.n_classes), dtype=np.float32)
    count = np.zeros((height, width, 1), dtype=np.float32)
    with limited_threads(n_threads):
        for top in _starts(height, rows, overlap):
            for left in _starts(width, columns, overlap):
                part = np.s_[top : top + rows, left : left + columns]
                total[part] += _probabilities(network, image[part], flip, magnifications)
                count[part] += 1
    return total / count


def _starts(size: int, window: int, overlap: float) -> list[int]:
    """Return where windows begin that cover a side evenly, overlapping by at least a share."""
    step = max(1, int(window * (1 - overlap)))
    steps = int(np.ceil((size - window) / step))
    return sorted({round(k * (size - window) / max(steps, 1)) for k in range(steps + 1)})


def _probabilities(
    network: PSPNet, image: NDArray[np.uint8], flip: bool, magnifications: Sequence[float]
) -> NDArray[np.float32]:  # fmt: skip
    height, width = image.shape[:2]
    looks = []
    with torch.inference_mode():
        given = network_input(image[None])
        for magnification in magnifications:
            shown = _scaled(given, [max(1, round(side * magnification)) for side in (height, width)])
            looks.append(_scaled(network(shown)[0], (height, width)))
            if flip:
                looks.append(_scaled(network(shown.flip(3))[0], (height, width)).flip(3))
        mean = torch.stack([torch.log_softmax(look, dim=1) for look in looks]).mean(dim=0)
        out = torch.softmax(mean, dim=1)
    probabilities: NDArray[np.float32] = out[0].permute(1, 2, 0).numpy()
    return probabilities


def _scaled(x: Tensor, size: Sequence[int]) -> Tensor:
    """Return pixels interpolated to another size; the outer edges of the corner pixels stay where they are."""
    if tuple(x.shape[2:]) == tuple(size):
        return x
    return functional.interpolate(x, size=tuple(size), mode="bilinear", align_corners=False)
