"""Which points a camera sees: a depth buffer of discs, and hidden point removal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive, check_xyz
from mlsroad_pipeline.algorithms.image_labels.camera import Camera
from mlsroad_pipeline.algorithms.image_labels.convex_hull import hull_vertices
from mlsroad_pipeline.algorithms.image_labels.depth_buffer import (
    behind_discs,
    ground_relief,
    hide_in_gaps,
    nearest_discs,
    typical_spacing,
)
from mlsroad_pipeline.algorithms.image_labels.projection import project_points

SPACING_OF_FEW = 0.06
"""Spacing that is taken for points too few to measure it, metres."""


@dataclass(frozen=True)
class DepthBuffer:
    """How a depth buffer tells visible points from hidden ones.

    Each point is a disc that faces the camera. A point is hidden where the nearest disc is clearly in front of it, or
    where it is seen through a gap between points that are. A surface met at a small angle does not hide itself: what
    is in front must be near the line of sight by that angle. z is up. Defaults were chosen on six simulated streets.

    Parameters
    ----------
    resolution : float, default 0.001
        Angle of a cell, radians. Smaller is sharper and slower; far below the angle between points it changes nothing.
    spacing : float, optional
        Distance between points of a surface, metres. None measures it in each image, as `typical_spacing` does, so
        that a survey of any density is treated alike. The next three lengths are multiples of it.
    disc : float, default 1.0
        Diameter of a disc. Larger closes surfaces and thickens thin things.
    gap : float, default 7.0
        Half the width of gaps that are closed, at the depth of their sides; 0 closes none. Larger closes crowns and
        hides more of what is seen through them.
    gap_disc : float, default 2.0
        Diameter of the discs that the sides of a gap are looked for among.
    slack, relative_slack : float, default 0.06 and 0.01
        How much farther than the disc in front a visible point may be, metres and share of its depth. Smaller tells
        the back of a car from its front, and takes the noise of a surface for another one.
    angle : float, default 0.05
        The least angle at which surfaces are still told apart from what hides them, radians.
    gap_slack, gap_angle : float, default 0.15 and 0.2
        As `slack` and `angle`, for the sides of a gap.
    gap_directions : int, default 4
        Along how many of four directions, 45 degrees apart, both sides of a gap must be nearer. Fewer close more.
    relief : float, default 0.1
        Roughness of the ground, metres. A line of sight that meets it at a small angle runs within it for metres, in
        which ground does not hide ground.
    ground_cell, ground_height : float, default 0.5 and 0.15
        Points that are no higher than `ground_height` above the lowest one in their square of `ground_cell` are on
        the ground, metres.
    max_range : float, default infinite
        Depth beyond which points are not labelled by the image, metres.

    Raises
    ------
    ParameterError
        If a length or an angle is not positive (`gap` and slacks may be 0), or `gap_directions` not in 1 to 4.
    """

    resolution: float = 0.001
    spacing: float | None = None
    disc: float = 1.0
    gap: float = 7.0
    gap_disc: float = 2.0
    slack: float = 0.06
    relative_slack: float = 0.01
    angle: float = 0.05
    gap_slack: float = 0.15
    gap_angle: float = 0.2
    gap_directions: int = 4
    relief: float = 0.1
    ground_cell: float = 0.5
    ground_height: float = 0.15
    max_range: float = float("inf")

    def __post_init__(self) -> None:
        for name in ("resolution", "disc", "angle", "gap_disc", "gap_angle", "ground_cell", "ground_height"):
            check_positive(getattr(self, name), name)
        if self.spacing is not None:
            check_positive(self.spacing, "spacing")
        for name in ("slack", "relative_slack", "gap", "gap_slack", "relief"):
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0:
                raise ParameterError(f"{name} must be a finite number >= 0, got {value!r}")
        if self.gap_directions not in (1, 2, 3, 4):
            raise ParameterError(f"gap_directions must be 1, 2, 3 or 4, got {self.gap_directions!r}")
        _check_range(self.max_range)


@dataclass(frozen=True)
class HiddenPointRemoval:
    """How hidden point removal is applied to a survey.

    Measured surfaces are rough, and of a rough surface the hull touches the tops alone. So the hull is that of the
    centroids of voxels, whose points share the answer. Defaults were chosen on two simulated streets.

    Parameters
    ----------
    exponent : float, default 3.5
        The sphere's radius is the largest distance times 10 to this power. Larger sees more: through gaps, and into
        concave corners.
    voxel_size : float, default 0.2
        Edge of the voxels, metres; larger is faster and closes more gaps, and blurs edges.
    max_range : float, default infinite
        Depth beyond which points are not labelled by the image, metres.

    Raises
    ------
    ParameterError
        If a value is not positive.

    References
    ----------
    .. [1] S. Katz, A. Tal, R. Basri, "Direct visibility of point sets", ACM Transactions on Graphics 26(3), 2007.
    """

    exponent: float = 3.5
    voxel_size: float = 0.2
    max_range: float = float("inf")

    def __post_init__(self) -> None:
        check_positive(self.exponent, "exponent")
        check_positive(self.voxel_size, "voxel_size")
        _check_range(self.max_range)


def visible_points(
    xyz: ArrayLike, camera: Camera, *, method: DepthBuffer | HiddenPointRemoval | None = None
) -> NDArray[np.bool_]:
    """Tell which points a camera sees.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points, metres, in the frame that the camera's pose refers to: all that may hide something.
    camera : Camera
        The camera.
    method : DepthBuffer or HiddenPointRemoval, optional
        How; by default a `DepthBuffer`, which is the better of the two on simulated streets.

    Returns
    -------
    ndarray of shape (n,), bool
        True for points inside the image, within range, that no other point hides.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3) or not finite.
    """
    points = check_xyz(xyz)
    how = DepthBuffer() if method is None else method
    pixels, depth, inside = project_points(points, camera)
    rows = np.flatnonzero(inside & (depth <= how.max_range))
    visible = np.zeros(len(points), dtype=np.bool_)
    if isinstance(how, HiddenPointRemoval):
        visible[rows] = _by_hull(points[rows].astype(np.float64) - camera.centre, how)
    else:
        visible[rows] = _by_buffer(points, rows, pixels[rows], depth[rows], camera, how)
    return visible


def hidden_point_removal(xyz: ArrayLike, viewpoint: ArrayLike, *, radius: float) -> NDArray[np.bool_]:
    """Tell visible points by the convex hull of their spherical flip.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points, metres. Of points at one place only the first is told to be visible.
    viewpoint : array-like of shape (3,)
        Where they are seen from, metres.
    radius : float
        Radius of the sphere, at least the largest distance, metres; larger sees more.

    Returns
    -------
    ndarray of shape (n,), bool
        True for visible points; a point at the viewpoint is visible.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3) or not finite.
    ParameterError
        If the radius is below the largest distance.

    References
    ----------
    .. [1] S. Katz, A. Tal, R. Basri, "Direct visibility of point sets", ACM Transactions on Graphics 26(3), 2007,
       section 3.
    """
    seen = check_xyz(xyz).astype(np.float64) - np.asarray(viewpoint, dtype=np.float64)
    distance = np.sqrt((seen**2).sum(axis=1))
    if not np.isfinite(radius) or radius < distance.max(initial=0.0):
        raise ParameterError(f"radius must be at least the largest distance {distance.max():g}, got {radius!r}")
    visible = distance == 0
    rows = np.flatnonzero(~visible)
    if len(rows) < 3:  # too few for a hull: only what is exactly in front hides
        visible[rows] = _unhidden(seen[rows], distance[rows])
        return visible
    flipped = np.zeros((len(rows) + 1, 3))
    flipped[1:] = seen[rows] * (2 * radius / distance[rows] - 1)[:, None]
    found = hull_vertices(flipped)
    vertices = _vertices_by_qhull(flipped) if found is None else found
    visible[rows[vertices[vertices > 0] - 1]] = True
    return visible


def _vertices_by_qhull(points: NDArray[np.float64]) -> NDArray[np.integer]:
    try:
        return ConvexHull(points).vertices
    except QhullError:  # all in one plane with the viewpoint: joggled input has a hull
        return ConvexHull(points, qhull_options="QJ").vertices


def _unhidden(seen: NDArray[np.float64], distance: NDArray[np.float64]) -> NDArray[np.bool_]:
    directions = seen / distance[:, None]
    same = directions @ directions.T > 1 - 1e-15
    return np.logical_not((same & (distance[None, :] < distance[:, None])).any(axis=1))


def _by_hull(seen: NDArray[np.float64], how: HiddenPointRemoval) -> NDArray[np.bool_]:
    if len(seen) == 0:
        return np.zeros(0, dtype=np.bool_)
    cells = np.floor(seen / how.voxel_size).astype(np.int64)
    cells -= cells.min(axis=0)
    extent = cells.max(axis=0) + 1
    _, voxel, count = np.unique(
        (cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2], return_inverse=True, return_counts=True
    )
    centroids = np.column_stack([np.bincount(voxel, seen[:, axis]) / count for axis in range(3)])
    radius = float(np.sqrt((centroids**2).sum(axis=1)).max()) * 10.0**how.exponent
    visible: NDArray[np.bool_] = hidden_point_removal(centroids, np.zeros(3), radius=radius)[voxel]
    return visible


def _by_buffer(
    xyz: NDArray[np.floating], rows: NDArray[np.int64], pixels: NDArray[np.float64], depth: NDArray[np.float64],
    camera: Camera, how: DepthBuffer,
) -> NDArray[np.bool_]:  # fmt: skip
    focal = 1.0 / how.resolution
    scale = focal / np.sqrt(camera.K[0, 0] * camera.K[1, 1])
    width, height = (int(np.ceil(side * scale)) for side in (camera.width, camera.height))
    u, v = ((pixels.T + 0.5) * scale - 0.5).astype(np.float32)
    z = depth.astype(np.float32)
    relief = ground_relief(xyz, rows, camera.centre, how.ground_cell, how.ground_height, how.relief)
    spacing = how.spacing
    if spacing is None:
        spacing = typical_spacing(u, v, z, focal=focal, width=width, height=height) or SPACING_OF_FEW
    shown = nearest_discs(u, v, z, focal, how.disc * spacing, width, height)
    hidden = behind_discs(u, v, z, relief, *shown, focal, how.slack, how.relative_slack, how.angle)
    if how.gap > 0:
        shown = nearest_discs(u, v, z, focal, how.gap_disc * spacing, width, height)
        hide_in_gaps(
            u, v, z, relief, *shown, focal, how.gap * spacing, how.gap_slack, how.relative_slack, how.gap_angle,
            how.gap_directions, hidden,
        )  # fmt: skip
    return np.logical_not(hidden)


def _check_range(max_range: float) -> None:
    if not max_range > 0:
        raise ParameterError(f"max_range must be > 0, got {max_range!r}")
