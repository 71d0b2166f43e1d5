"""Projection of points into images, and sampling of images at points."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_xyz
from mlsroad_pipeline.algorithms.geometry.lenses import distort_one, fold_radius


def project_points(
    xyz: ArrayLike, camera: Camera
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Project points into an image.

    The product is computed in float64, which keeps the millimetres of UTM coordinates.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points in the frame of the camera's pose, metres.
    camera : Camera
        The camera.

    Returns
    -------
    pixels : ndarray of shape (n, 2), float64
        Column and row; integers are pixel centres. Defined for points beside the image too; NaN for points that are not
        in front of the camera, or beyond the radius where the distortion polynomial folds back.
    depth : ndarray of shape (n,), float64
        Distance along the optical axis, metres; at most 0 behind the camera.
    inside : ndarray of shape (n,), bool
        True for points that project onto a pixel of the image; occlusion is not tested.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3) or not finite.

    References
    ----------
    .. [1] D. Tomic et al., "Fusion of feature based and deep learning methods for classification of MMS point clouds",
       ISPRS Archives, 2019, equations 4 to 6.

    Examples
    --------
    >>> camera = Camera([[100, 0, 50], [0, 100, 40], [0, 0, 1]], None, np.eye(3), np.zeros(3), 101, 81)
    >>> pixels, depth, inside = project_points([[0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [0.0, 0.0, -2.0]], camera)
    >>> pixels[:2].tolist(), depth.tolist(), inside.tolist()
    ([[50.0, 40.0], [100.0, 40.0]], [2.0, 2.0, -2.0], [True, True, False])
    """
    points = check_xyz(xyz)
    pixels, depth = np.empty((len(points), 2)), np.empty(len(points))
    inside = np.empty(len(points), dtype=np.bool_)
    _project(
        points, camera.R, camera.t, camera.K, camera.distortion, fold_radius(camera.distortion) ** 2,
        camera.width, camera.height, pixels, depth, inside,
    )  # fmt: skip
    return pixels, depth, inside


@njit(cache=True, nogil=True, error_model="numpy")
def _project(
    xyz: NDArray[np.floating], r: NDArray[np.float64], t: NDArray[np.float64], k: NDArray[np.float64],
    lens: NDArray[np.float64], limit: float, width: int, height: int,
    pixels: NDArray[np.float64], depth: NDArray[np.float64], inside: NDArray[np.bool_],
) -> None:  # fmt: skip
    bare = not lens.any()
    for i in range(len(xyz)):
        x, y, z = float(xyz[i, 0]), float(xyz[i, 1]), float(xyz[i, 2])
        depth[i] = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + t[2]
        pixels[i, 0] = pixels[i, 1] = np.nan
        inside[i] = False
        if depth[i] <= 0:
            continue
        across = (r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + t[0]) / depth[i]
        down = (r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + t[1]) / depth[i]
        if not across * across + down * down < limit:
            continue
        if not bare:
            across, down = distort_one(across, down, lens)
        u, v = k[0, 0] * across + k[0, 1] * down + k[0, 2], k[1, 1] * down + k[1, 2]
        pixels[i, 0], pixels[i, 1] = u, v
        inside[i] = -0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5


def sample_image(image: NDArray, pixels: NDArray[np.float64], rows: NDArray, *, fill: float = 0) -> NDArray:
    """Return the values of an image at the nearest pixels of points (`project_points`), `fill` for other rows.

    `DataError` if one of the rows lies outside the image.
    """
    out = np.full((len(pixels), *image.shape[2:]), fill, dtype=image.dtype)
    cells = np.floor(pixels[rows] + 0.5)
    height, width = image.shape[:2]
    if not ((cells >= 0) & (cells < [width, height])).all():
        beyond = cells[~((cells >= 0) & (cells < [width, height])).all(axis=1)][0]
        raise DataError(f"pixel {beyond.tolist()} lies outside an image of {width} x {height}: is it of the camera?")
    columns, lines = cells.astype(np.int64).T
    out[rows] = image[lines, columns]
    return out
