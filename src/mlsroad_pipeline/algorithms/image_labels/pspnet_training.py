"""Training a PSPNet, and applying it to images of any size. Importing this module imports torch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image as Picture
from torch import nn

from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.image_labels.pspnet import MEAN, PSPNet, network_input
from mlsroad_pipeline.algorithms.image_labels.training_parameters import TrainingParameters

_COUNTED = 60  # images that class frequencies are counted in

Sample = tuple[NDArray[np.uint8], NDArray[np.integer]]
"""An image (height, width, 3) and its labels (height, width), -1 where they are not to be learned."""


@contextmanager
def _threads(count: int) -> Iterator[None]:
    """Let torch use so many threads meanwhile: on busy cores its threads wait for each other more than they help."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def train_network(
    samples: Sequence[Sample], *, n_classes: int, parameters: TrainingParameters | None = None,
    network: PSPNet | None = None,
) -> tuple[PSPNet, list[float]]:  # fmt: skip
    """Train a PSPNet.

    Parameters
    ----------
    samples : sequence of (ndarray, ndarray)
        Images and labels; each is taken from the sequence when it is needed, so it may read them from files.
    n_classes : int
        Number of classes.
    parameters : TrainingParameters, optional
        How; the defaults where none are given.
    network : PSPNet, optional
        A network to go on with, such as one of published weights; it is changed. A new one by default.

    Returns
    -------
    network : PSPNet
        The network, ready to predict.
    losses : list of float
        Loss of every step.

    Raises
    ------
    DataError
        If there are no images, an image and its labels differ in size, or a label is outside -1 to ``n_classes - 1``.
    ParameterError
        If `network` has another number of classes.
    """
    how = TrainingParameters() if parameters is None else parameters
    if not len(samples):
        raise DataError("training needs at least one image")
    rng = np.random.default_rng(how.random_state)
    torch.manual_seed(how.random_state)
    model = PSPNet(n_classes, backbone=how.backbone, dropout=how.dropout) if network is None else network
    if model.n_classes != n_classes:
        raise ParameterError(f"the network has {model.n_classes} classes, not {n_classes}")
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    model.to(device).train()
    criterion = nn.CrossEntropyLoss(_class_weights(samples, n_classes, how).to(device), ignore_index=-1)
    optimiser = torch.optim.SGD(
        model.parameters(), how.learning_rate, momentum=how.momentum, weight_decay=how.weight_decay, nesterov=True
    )
    schedule = torch.optim.lr_scheduler.LambdaLR(
        optimiser, lambda step: min(1.0, (step + 1) / how.warm_up) * (1 - step / how.n_steps) ** how.power
    )
    losses = []
    with _threads(how.n_threads):
        for images, labels in _batches(samples, n_classes, how, rng):
            main, auxiliary = model(images.to(device))
            target = labels.to(device)
            loss = criterion(main, target) + how.auxiliary_weight * criterion(auxiliary, target)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            losses.append(float(loss.detach()))
    return model.to("cpu").eval(), losses


def _class_weights(samples: Sequence[Sample], n_classes: int, how: TrainingParameters) -> torch.Tensor:
    """Return weights of classes: a power of their inverse frequency, 1 on average over pixels; 0 for absent ones."""
    rows = np.linspace(0, len(samples) - 1, min(_COUNTED, len(samples))).round().astype(int)
    count = np.zeros(n_classes)
    for row in rows:
        labels = samples[int(row)][1]
        count += np.bincount(labels[(labels >= 0) & (labels < n_classes)].astype(np.int64), minlength=n_classes)
    share = count / max(count.sum(), 1)
    weights = np.where(share > 0, np.maximum(share, 1e-5) ** -how.class_balance, 0.0)
    return torch.from_numpy((weights / max((weights * share).sum(), 1e-12)).astype(np.float32))


def _batches(
    samples: Sequence[Sample], n_classes: int, how: TrainingParameters, rng: np.random.Generator
) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    order: list[int] = []
    for _ in range(how.n_steps):
        while len(order) < how.batch_size:
            order += rng.permutation(len(samples)).tolist()
        taken, order = order[: how.batch_size], order[how.batch_size :]
        pairs = [_crop(samples[row], row, n_classes, how, rng) for row in taken]
        yield (
            network_input(np.stack([image for image, _ in pairs])),
            torch.from_numpy(np.stack([labels for _, labels in pairs])),
        )


def _crop(
    sample: Sample, row: int, n_classes: int, how: TrainingParameters, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Return a random part of an image, scaled and perhaps mirrored; what lies beyond the image is ignored."""
    image, labels = sample
    if image.shape[:2] != labels.shape:
        raise DataError(f"image {row} has {image.shape[:2]} pixels, its labels {labels.shape}")
    if labels.size and not -1 <= int(labels.min()) <= int(labels.max()) < n_classes:
        raise DataError(f"labels of image {row} must be in -1..{n_classes - 1}, got {labels.min()}..{labels.max()}")
    scale = float(np.exp(rng.uniform(*np.log(how.scale))))
    size = [min(side, max(1, round(how.crop / scale))) for side in labels.shape]
    top, left = (int(rng.integers(0, side - part + 1)) for side, part in zip(labels.shape, size, strict=True))
    shape = [min(how.crop, max(1, round(part * scale))) for part in size]
    window = np.s_[top : top + size[0], left : left + size[1]]
    picture = Picture.fromarray(np.ascontiguousarray(image[window])).resize(shape[::-1], Picture.Resampling.BILINEAR)
    marks = Picture.fromarray((labels[window] + 1).astype(np.uint8)).resize(shape[::-1], Picture.Resampling.NEAREST)
    out = np.empty((how.crop, how.crop, 3), dtype=np.uint8)
    out[:] = np.round(MEAN).astype(np.uint8)
    target = np.full((how.crop, how.crop), -1, dtype=np.int64)
    out[: shape[0], : shape[1]] = np.asarray(picture)
    target[: shape[0], : shape[1]] = np.asarray(marks).astype(np.int64) - 1
    if how.flip and rng.random() < 0.5:
        out, target = out[:, ::-1].copy(), target[:, ::-1].copy()
    return out, target


def segment_image(
    network: PSPNet, image: NDArray[np.uint8], *, window: tuple[int, int] | None = None, overlap: float = 1 / 3,
    flip: bool = False, n_threads: int = 1,
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
        Whether the mirrored image is segmented too, and the mean taken.
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
        If a window's side is below 1 or the overlap outside [0, 1).
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise DataError(f"an image must have shape (height, width, 3) and be uint8, got {image.shape} {image.dtype}")
    if not 0 <= overlap < 1:
        raise ParameterError(f"overlap must be in [0, 1), got {overlap!r}")
    height, width = image.shape[:2]
    rows, columns = (height, width) if window is None else window
    if min(rows, columns) < 1:
        raise ParameterError(f"a window's sides must be at least 1 pixel, got {window}")
    rows, columns = min(rows, height), min(columns, width)
    total = np.zeros((height, width, network.n_classes), dtype=np.float32)
    count = np.zeros((height, width, 1), dtype=np.float32)
    with _threads(n_threads):
        for top in _starts(height, rows, overlap):
            for left in _starts(width, columns, overlap):
                part = np.s_[top : top + rows, left : left + columns]
                total[part] += _probabilities(network, image[part], flip)
                count[part] += 1
    return total / count


def _starts(size: int, window: int, overlap: float) -> list[int]:
    """Return where windows begin that cover a side evenly, overlapping by at least a share."""
    step = max(1, int(window * (1 - overlap)))
    steps = int(np.ceil((size - window) / step))
    return sorted({round(k * (size - window) / max(steps, 1)) for k in range(steps + 1)})


def _probabilities(network: PSPNet, image: NDArray[np.uint8], flip: bool) -> NDArray[np.float32]:
    with torch.inference_mode():
        given = network_input(image[None])
        out = torch.softmax(network(given)[0], dim=1)
        if flip:
            out = (out + torch.softmax(network(given.flip(3))[0], dim=1).flip(3)) / 2
    probabilities: NDArray[np.float32] = out[0].permute(1, 2, 0).numpy()
    return probabilities
