"""Calibrated and posed camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError

_ROTATION_SLACK = 5e-3  # published calibrations are rounded; a mirrored or scaled axis is far beyond this

LARGEST = 1e12
"""Limit of the numbers of a calibration: pixels and metres."""

LARGEST_SIDE = 1 << 20
"""Largest width and height of an image, pixels."""


@dataclass(frozen=True, eq=False)
class Camera:
    """Pinhole camera with lens distortion and pose.

    A point p has the coordinates R p + t in the frame of the camera (x right, y down, z forward). Dividing by z,
    distorting and multiplying by K gives its pixel; pixel centres have integer coordinates.

    Parameters
    ----------
    K : array-like of shape (3, 3)
        Calibration matrix, pixels.
    distortion : array-like of shape (4,) or (5,), or None
        k1, k2, p1, p2 and k3 of the Brown-Conrady model, in OpenCV's order; None is no distortion.
    R : array-like of shape (3, 3)
        Rotation from the frame of the points to the camera's.
    t : array-like of shape (3,)
        Translation, metres.
    width, height : int
        Size of the image, pixels.

    Raises
    ------
    ParameterError
        If a shape is wrong, a value is not finite, a focal length or a side is not positive, the last row of K is not
        0, 0, 1, or R is not a rotation.

    References
    ----------
    .. [1] D. Tomic et al., "Fusion of feature based and deep learning methods for classification of MMS point clouds",
       ISPRS Archives, 2019, equations 5 and 6.
    """

    K: NDArray[np.float64]
    distortion: NDArray[np.float64]
    R: NDArray[np.float64]
    t: NDArray[np.float64]
    width: int
    height: int

    def __post_init__(self) -> None:
        lens = _matrix([] if self.distortion is None else self.distortion, "distortion", ((0,), (4,), (5,)))
        values = {
            "K": _matrix(self.K, "K", ((3, 3),)),
            "distortion": np.concatenate([lens, np.zeros(5 - len(lens))]),
            "R": _matrix(self.R, "R", ((3, 3),)),
            "t": _matrix(self.t, "t", ((3,),)),
            "width": _side(self.width, "width"),
            "height": _side(self.height, "height"),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        if self.K[0, 0] <= 0 or self.K[1, 1] <= 0:
            raise ParameterError(f"K must have focal lengths > 0, got {self.K[0, 0]:g} and {self.K[1, 1]:g}")
        if not np.array_equal(self.K[2], [0, 0, 1]) or self.K[1, 0] != 0:
            raise ParameterError(f"K must be upper triangular with 1 in its corner, got {self.K.tolist()}")
        off = np.abs(self.R @ self.R.T - np.eye(3)).max()
        if off > _ROTATION_SLACK or np.linalg.det(self.R) < 0:
            raise ParameterError(f"R must be a rotation; R R^T is off by {off:.3g}, det is {np.linalg.det(self.R):.3g}")

    @property
    def centre(self) -> NDArray[np.float64]:
        """Projection centre in the frame of the points, metres."""
        return np.asarray(-np.linalg.solve(self.R, self.t), dtype=np.float64)

    def shifted(self, origin: ArrayLike) -> Camera:
        """Return the camera for points relative to another origin.

        Parameters
        ----------
        origin : array-like of shape (3,)
            The new origin in the old frame, metres.

        Returns
        -------
        Camera
            The camera for points minus `origin`.
        """
        moved = self.R @ np.asarray(origin, dtype=np.float64) + self.t
        return Camera(self.K, self.distortion, self.R, moved, self.width, self.height)

    def carried(self, rotation: ArrayLike, position: ArrayLike) -> Camera:
        """Return the camera for a pose of the vehicle; the pose of this camera is relative to the vehicle.

        Parameters
        ----------
        rotation : array-like of shape (3, 3)
            Rotation from the axes of the vehicle to those of the points.
        position : array-like of shape (3,)
            Position of the vehicle, metres.

        Returns
        -------
        Camera
            The camera in the frame of the points.
        """
        turned = self.R @ np.asarray(rotation, dtype=np.float64).T
        moved = self.t - turned @ np.asarray(position, dtype=np.float64)
        return Camera(self.K, self.distortion, turned, moved, self.width, self.height)


def _matrix(value: ArrayLike, name: str, shapes: tuple[tuple[int, ...], ...]) -> NDArray[np.float64]:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ParameterError(f"{name} must be numbers of shape {shapes[-1]}, got {value!r}") from error
    if array.shape not in shapes:
        raise ParameterError(f"{name} must have shape {' or '.join(map(str, shapes))}, got {array.shape}")
    if not (np.abs(array) < LARGEST).all():
        raise ParameterError(f"{name} must be finite and below {LARGEST:g}, got {array.tolist()}")
    return array


def _side(value: float, name: str) -> int:
    whole = isinstance(value, int | np.integer) or (isinstance(value, float) and value.is_integer())
    if isinstance(value, bool) or not whole or not 1 <= value <= LARGEST_SIDE:
        raise ParameterError(f"{name} must be an integer from 1 to {LARGEST_SIDE}, got {value!r}")
    return int(value)
