"""Random crops of labelled images for training."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Picture

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import TrainingParameters

_COUNTED = 1000  # maximum number of images in the class counts
_LEAST = 30  # minimum pixels of a class in an image drawn for it

Sample = tuple[NDArray[np.uint8], NDArray[np.integer]]
"""Image (height, width, 3) and labels (height, width), -1 for ignored pixels."""

Batch = tuple[NDArray[np.uint8], NDArray[np.int64]]
"""Crops (crops, height, width, 3) and their labels (crops, height, width)."""


class Crops:
    """Sampler of random crops."""

    def __init__(
        self, samples: Sequence[Sample], n_classes: int, parameters: TrainingParameters, filling: Sequence[int]
    ) -> None:
        if not len(samples):
            raise DataError("training needs at least one image")
        self._samples, self._n_classes, self._parameters = samples, n_classes, parameters
        self._filling = np.array(filling, dtype=np.uint8)
        self._rows = np.linspace(0, len(samples) - 1, min(_COUNTED, len(samples))).round().astype(int)
        self._count = np.stack([self._class_count(int(row)) for row in self._rows])

    def _class_count(self, row: int) -> NDArray[np.int64]:
        labels = self._sample(row)[1]
        return np.bincount(labels.ravel().astype(np.int64) + 1, minlength=self._n_classes + 1)[1:]

    def _sample(self, row: int) -> Sample:
        image, labels = self._samples[row]
        if image.shape[:2] != labels.shape:
            raise DataError(f"image {row} has {image.shape[:2]} pixels, its labels {labels.shape}")
        if labels.size and not -1 <= int(labels.min()) <= int(labels.max()) < self._n_classes:
            least, most = labels.min(), labels.max()
            raise DataError(f"labels of image {row} must be in -1..{self._n_classes - 1}, got {least}..{most}")
        return image, labels

    @property
    def shares(self) -> NDArray[np.float64]:
        """Share of each class in the labelled pixels of up to 1000 images."""
        count = self._count.sum(axis=0)
        return count / max(count.sum(), 1)

    def batches(self, rng: np.random.Generator) -> Iterator[Batch]:
        """Yield the batches of a training; images are drawn without replacement, except for crops around a class."""
        order: list[int] = []
        for _ in range(self._parameters.n_steps):
            crops = []
            for _ in range(self._parameters.batch_size):
                label = self._draw_class(rng)
                if label is not None:
                    row = int(rng.choice(self._rows, p=self._image_weights(label)))
                else:
                    order = order or rng.permutation(len(self._samples)).tolist()
                    row = order.pop()
                crops.append(self._crop(row, label, rng))
            yield np.stack([image for image, _ in crops]), np.stack([labels for _, labels in crops])

    def _draw_class(self, rng: np.random.Generator) -> int | None:
        """Draw a class to place a crop around, uniformly over the classes present, or None."""
        if rng.random() >= self._parameters.class_crops:
            return None
        present = np.flatnonzero(self._count.any(axis=0))
        return int(rng.choice(present)) if len(present) else None

    def _image_weights(self, label: int) -> NDArray[np.float64]:
        """Return the probabilities of images for a class: the root of its pixels, which favours near objects."""
        count = self._count[:, label]
        weight = np.sqrt(np.where(count >= min(_LEAST, count.max()), count, 0))
        return weight / weight.sum()

    def _crop(
        self, row: int, label: int | None, rng: np.random.Generator
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """Return a scaled and possibly mirrored part of an image; pixels outside the image are ignored."""
        image, labels = self._sample(row)
        parameters = self._parameters
        scale = float(np.exp(rng.uniform(*np.log(parameters.scale))))
        size = [min(side, max(1, round(parameters.crop / scale))) for side in labels.shape]
        top, left = _place(labels, size, label, rng)
        shape = [min(parameters.crop, max(1, round(part * scale))) for part in size]
        window = np.s_[top : top + size[0], left : left + size[1]]
        picture = Picture.fromarray(np.ascontiguousarray(image[window]))
        marks = Picture.fromarray((labels[window] + 1).astype(np.uint8))
        out = np.empty((parameters.crop, parameters.crop, 3), dtype=np.uint8)
        out[:] = self._filling
        target = np.full((parameters.crop, parameters.crop), -1, dtype=np.int64)
        out[: shape[0], : shape[1]] = np.asarray(picture.resize(shape[::-1], Picture.Resampling.BILINEAR))
        target[: shape[0], : shape[1]] = np.asarray(marks.resize(shape[::-1], Picture.Resampling.NEAREST)) - np.int64(1)
        if parameters.flip and rng.random() < 0.5:
            out, target = out[:, ::-1], target[:, ::-1]
        return out, target


def _place(
    labels: NDArray[np.integer], size: Sequence[int], label: int | None, rng: np.random.Generator
) -> tuple[int, int]:
    """Return the corner of a window: anywhere, or such that it contains a pixel of a class."""
    low, high = [0, 0], [side - part for side, part in zip(labels.shape, size, strict=True)]
    if label is not None:
        pixel = divmod(int(rng.choice(np.flatnonzero(labels.ravel() == label))), labels.shape[1])
        low = [max(0, at - part + 1) for at, part in zip(pixel, size, strict=True)]
        high = [min(most, at) for most, at in zip(high, pixel, strict=True)]
    top, left = (int(rng.integers(a, b + 1)) for a, b in zip(low, high, strict=True))
    return top, left
