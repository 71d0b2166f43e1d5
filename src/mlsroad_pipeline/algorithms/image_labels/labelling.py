"""Labels and confidences of points, per camera, from segmented images."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_xyz
from mlsroad_pipeline.algorithms.image_labels.camera import Camera
from mlsroad_pipeline.algorithms.image_labels.projection import project_points, sample_image
from mlsroad_pipeline.algorithms.image_labels.visibility import DepthBuffer, HiddenPointRemoval, visible_points

Probabilities = NDArray[np.float32] | Callable[[], NDArray[np.float32]]

SegmentedImage = tuple[str, Camera, Probabilities]
"""Which of the survey's cameras took an image, its calibration and pose, and its probabilities (height, width, c), or
what computes them: that is called where the image shows a point."""


@dataclass(frozen=True)
class ImageLabels:
    """What the images of a survey say of its points, each of the survey's cameras by itself.

    Parameters
    ----------
    groups : tuple of str
        Names of the cameras.
    probabilities : ndarray of shape (groups, n, classes), float32
        Class probabilities by each camera's images; NaN where none of them sees the point.
    n_images : ndarray of shape (groups, n), int16
        How many of its images see the point: the redundancy.
    """

    groups: tuple[str, ...]
    probabilities: NDArray[np.float32]
    n_images: NDArray[np.int16]

    @property
    def labels(self) -> NDArray[np.int16]:
        """The most probable class by each camera, of shape (groups, n); -1 where it does not see the point."""
        best = np.nan_to_num(self.probabilities).argmax(axis=2)
        return np.where(self.n_images > 0, best, IGNORE).astype(np.int16)

    @property
    def confidence(self) -> NDArray[np.float32]:
        """The probability of that class, of shape (groups, n); 0 where the camera does not see the point."""
        return np.nan_to_num(self.probabilities).max(axis=2)

    def pooled(self) -> NDArray[np.float32]:
        """Return the mean over the images of all cameras.

        Returns
        -------
        ndarray of shape (n, classes), float32
            Class probabilities; NaN where no image sees the point.
        """
        total = np.einsum("gnc,gn->nc", np.nan_to_num(self.probabilities), self.n_images.astype(np.float32))
        count = self.n_images.sum(axis=0, dtype=np.float32)[:, None]
        return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)


def label_through_images(
    xyz: ArrayLike, images: Iterable[SegmentedImage], *, groups: Sequence[str], n_classes: int,
    visibility: DepthBuffer | HiddenPointRemoval | None = None, max_distance: float = np.inf,
    n_labelled: int | None = None,
) -> ImageLabels:  # fmt: skip
    """Give points the classes of the pixels that show them.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points, metres, in the frame that the poses refer to: all that may hide something.
    images : iterable of (str, Camera, ndarray)
        Segmented images, taken one after the other, so that they need not be in memory together.
    groups : sequence of str
        Names of the survey's cameras.
    n_classes : int
        Number of classes.
    visibility : DepthBuffer or HiddenPointRemoval, optional
        How hidden points are found; see `visible_points`.
    max_distance : float, default infinite
        Points farther from the camera take nothing from its image, metres. Far things are a few pixels wide, and the
        network knows them less; but points that only far images show stay without a label.
    n_labelled : int, optional
        How many points, from the first, receive labels; the others only hide them. None takes all.

    Returns
    -------
    ImageLabels
        Means of the probabilities over the images of each camera, for the points that receive labels.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3) or not finite, an image is of a camera that `groups` does not name, or its
        probabilities do not have its camera's size and the number of classes.
    """
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
        found = probabilities() if callable(probabilities) else probabilities
        expected = (camera.height, camera.width, n_classes)
        if found.shape != expected:
            raise DataError(f"probabilities of an image must have shape {expected}, got {found.shape}")
        pixels, _, _ = project_points(points[rows], camera)
        k = list(groups).index(group)
        total[k, rows] += sample_image(found, pixels, np.ones(len(rows), dtype=np.bool_))
        count[k, rows] += 1
    shown = count[:, :, None]
    mean = np.divide(total, shown, out=np.full_like(total, np.nan), where=shown > 0)
    return ImageLabels(tuple(groups), mean, count)
