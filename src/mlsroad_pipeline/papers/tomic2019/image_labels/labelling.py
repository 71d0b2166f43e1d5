"""Labels and confidences of points, per camera, from segmented images."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.cameras.projection import project_points, sample_image
from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_xyz
from mlsroad_pipeline.papers.tomic2019.image_labels.visibility import DepthBuffer, HiddenPointRemoval, visible_points

Probabilities = NDArray[np.float32] | Callable[[], NDArray[np.float32]]

SegmentedImage = tuple[str, Camera, Probabilities]
"""Name of the camera, calibration and pose, and the class probabilities (height, width, c) of an image or a function
that computes them; it is called only if the image shows a point."""


@dataclass(frozen=True)
class ImageLabels:
    """Class probabilities of points from images, per camera of the survey."""

    groups: tuple[str, ...]  # Names of the cameras
    # Mean class probabilities over the images of each camera; NaN where none of them shows the point
    probabilities: NDArray[np.float32]
    n_images: NDArray[np.int16]  # Number of images of each camera that show the point (redundancy)

    @property
    def labels(self) -> NDArray[np.int16]:
        """Most probable class per camera, shape (groups, n); -1 where the camera does not see the point."""
        best = np.nan_to_num(self.probabilities).argmax(axis=2)
        return np.where(self.n_images > 0, best, IGNORE).astype(np.int16)

    @property
    def confidence(self) -> NDArray[np.float32]:
        """Probability of that class, shape (groups, n); 0 where the camera does not see the point."""
        return np.nan_to_num(self.probabilities).max(axis=2)

    def pooled(self) -> NDArray[np.float32]:
        """Return the mean over the images of all cameras."""
        total = np.einsum("gnc,gn->nc", np.nan_to_num(self.probabilities), self.n_images.astype(np.float32))
        count = self.n_images.sum(axis=0, dtype=np.float32)[:, None]
        return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)


def label_through_images(
    xyz: ArrayLike, images: Iterable[SegmentedImage], *, groups: Sequence[str], n_classes: int,
    visibility: DepthBuffer | HiddenPointRemoval | None = None, max_distance: float = np.inf,
    n_labelled: int | None = None,
) -> ImageLabels:  # fmt: skip
    """Return the class probabilities of points from segmented images."""
    points = check_xyz(xyz)
    labelled = len(points) if n_labelled is None else n_labelled
    total = np.zeros((len(groups), labelled, n_classes), dtype=np.float32)
    count = np.zeros((len(groups), labelled), dtype=np.int16)
    for group, camera, probabilities in images:
        if group not in groups:
            raise DataError(f"an image is of camera {group!r}, the survey's cameras are {list(groups)}")
        if not project_points(points[:labelled], camera)[2].any():
            continue
        seen = visible_points(points, camera, method=visibility)[:labelled]
        if np.isfinite(max_distance):
            seen &= np.linalg.norm(points[:labelled] - camera.centre, axis=1) <= max_distance
        rows = np.flatnonzero(seen)
        if len(rows) == 0:
            continue
        table = probabilities() if callable(probabilities) else probabilities
        expected = (camera.height, camera.width, n_classes)
        if table.shape != expected:
            raise DataError(f"probabilities of an image must have shape {expected}, got {table.shape}")
        pixels, _, _ = project_points(points[rows], camera)
        k = list(groups).index(group)
        values = sample_image(table, pixels, np.ones(len(rows), dtype=np.bool_))
        known = ~np.isnan(values[:, 0])
        total[k, rows[known]] += values[known]
        count[k, rows[known]] += 1
    shown = count[:, :, None]
    mean = np.divide(total, shown, out=np.full_like(total, np.nan), where=shown > 0)
    return ImageLabels(tuple(groups), mean, count)
