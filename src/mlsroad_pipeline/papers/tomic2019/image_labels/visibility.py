"""Visibility of points from a camera: depth buffer of discs, and hidden point removal."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.cameras.projection import project_points
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive, check_xyz
from mlsroad_pipeline.papers.tomic2019.image_labels import depth_buffer
from mlsroad_pipeline.papers.tomic2019.image_labels.convex_hull import hull_vertices

SPACING_OF_FEW = 0.06
"""Point spacing assumed where there are too few points to estimate it, metres."""


@dataclass(frozen=True)
class DepthBuffer:
    """Parameters of the depth buffer.

    Each point is a disc that faces the camera. A point is hidden if the nearest disc is clearly in front of it, or if
    it lies behind a gap between nearer points. Surfaces at grazing incidence do not hide themselves: the lateral
    distance of an occluder from the line of sight must be small compared with the difference in depth. z is up. The
    defaults were selected on six simulated streets.

    Parameters
    ----------
    resolution : float, default 0.001
        Angular size of a cell, radians. Smaller is sharper and slower; no effect far below the angle between points.
    spacing : float, optional
        Point spacing on surfaces, metres. None estimates it in each image with `typical_spacing`, which adapts to the
        point density of the survey. The next three lengths are multiples of it.
    disc : float, default 1.0
        Diameter of a disc. Larger closes surfaces and thickens thin objects.
    gap : float, default 7.0
        Half the width of the gaps to close, at the depth of their sides; 0 closes none. Larger closes tree crowns and
        hides more points behind them.
    gap_disc : float, default 2.0
        Diameter of the discs in the search for the sides of a gap.
    slack, relative_slack : float, default 0.06 and 0.01
        Depth tolerance behind the nearest disc, metres and share of the depth. Smaller separates the back of a car from
        its front; too small lets the noise of a surface hide its own points.
    angle : float, default 0.05
        Minimum angle between the line of sight and a surface at which occlusion is detected, radians.
    gap_slack, gap_angle : float, default 0.15 and 0.2
        As `slack` and `angle`, for the sides of a gap.
    gap_directions : int, default 4
        Number of directions, of four 45 degrees apart, in which both sides of a gap must be nearer. Smaller closes more
        gaps.
    relief : float, default 0.1
        Roughness of the ground, metres. Ground does not hide ground within the length of the line of sight that lies
        inside this roughness.
    ground_cell, ground_height : float, default 0.5 and 0.15
        Points at most `ground_height` above the lowest point in their square of `ground_cell` count as ground, metres.
    max_range : float, default infinite
        Depth beyond which an image labels no points, metres.

    Raises
    ------
    ParameterError
        If a length or an angle is not positive (`gap` and slacks may be 0), or `gap_directions` is not in 1 to 4.
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
    """Parameters of hidden point removal.

    The hull of a rough surface touches its peaks only. The hull is therefore computed on the centroids of voxels, and
    all points of a voxel share its visibility. The defaults were selected on two simulated streets.

    Parameters
    ----------
    exponent : float, default 3.5
        The radius of the sphere is the largest distance times 10 to this power. Larger marks more points visible:
        through gaps and in concave corners.
    voxel_size : float, default 0.2
        Edge length of the voxels, metres; larger is faster, closes more gaps and blurs edges.
    max_range : float, default infinite
        Depth beyond which an image labels no points, metres.

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


def visibility_method(name: str) -> DepthBuffer | HiddenPointRemoval:
    """Return a method of the visibility with its defaults."""
    methods: dict[str, DepthBuffer | HiddenPointRemoval] = {
        "depth_buffer": DepthBuffer(),
        "hidden_points": HiddenPointRemoval(),
    }
    if name not in methods:
        raise ParameterError(f"visibility must be one of {', '.join(methods)}, got {name!r}")
    return methods[name]


def visible_points(
    xyz: ArrayLike, camera: Camera, *, method: DepthBuffer | HiddenPointRemoval | None = None
) -> NDArray[np.bool_]:
    """Return which points lie inside the image and within range, hidden by no other; by default by depth buffer."""
    points = check_xyz(xyz)
    parameters = DepthBuffer() if method is None else method
    pixels, depth, inside = project_points(points, camera)
    rows = np.flatnonzero(inside & (depth <= parameters.max_range))
    visible = np.zeros(len(points), dtype=np.bool_)
    if isinstance(parameters, HiddenPointRemoval):
        visible[rows] = _by_hull(points[rows].astype(np.float64) - camera.centre, parameters)
    else:
        visible[rows] = _by_buffer(points, rows, pixels[rows], depth[rows], camera, parameters)
    return visible


def hidden_point_removal(xyz: ArrayLike, viewpoint: ArrayLike, *, radius: float) -> NDArray[np.bool_]:
    """Return visible points by the convex hull of their spherical flip (Katz et al. 2007, section 3).

    A larger radius marks more points visible. Of coincident points only the first can be; a point at the viewpoint is
    visible.
    """
    seen = check_xyz(xyz).astype(np.float64) - np.asarray(viewpoint, dtype=np.float64)
    distance = np.sqrt((seen**2).sum(axis=1))
    if not np.isfinite(radius) or radius < distance.max(initial=0.0):
        raise ParameterError(f"radius must be at least the largest distance {distance.max():g}, got {radius!r}")
    visible = distance == 0
    rows = np.flatnonzero(~visible)
    if len(rows) < 3:  # too few for a hull: only points on the same ray hide
        visible[rows] = _unhidden(seen[rows], distance[rows])
        return visible
    flipped = np.zeros((len(rows) + 1, 3))
    flipped[1:] = seen[rows] * (2 * radius / distance[rows] - 1)[:, None]
    own = hull_vertices(flipped)
    vertices = _vertices_by_qhull(flipped) if own is None else own
    visible[rows[vertices[vertices > 0] - 1]] = True
    return visible


def _vertices_by_qhull(points: NDArray[np.float64]) -> NDArray[np.integer]:
    try:
        return ConvexHull(points).vertices
    except QhullError:  # all in one plane with the viewpoint: joggle the input
        return ConvexHull(points, qhull_options="QJ").vertices


def _unhidden(seen: NDArray[np.float64], distance: NDArray[np.float64]) -> NDArray[np.bool_]:
    directions = seen / distance[:, None]
    same = directions @ directions.T > 1 - 1e-15
    return np.logical_not((same & (distance[None, :] < distance[:, None])).any(axis=1))


def _by_hull(seen: NDArray[np.float64], parameters: HiddenPointRemoval) -> NDArray[np.bool_]:
    if len(seen) == 0:
        return np.zeros(0, dtype=np.bool_)
    cells = np.floor(seen / parameters.voxel_size).astype(np.int64)
    cells -= cells.min(axis=0)
    extent = cells.max(axis=0) + 1
    _, voxel, count = np.unique(
        (cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2], return_inverse=True, return_counts=True
    )
    centroids = np.column_stack([np.bincount(voxel, seen[:, axis]) / count for axis in range(3)])
    radius = float(np.sqrt((centroids**2).sum(axis=1)).max()) * 10.0**parameters.exponent
    visible: NDArray[np.bool_] = hidden_point_removal(centroids, np.zeros(3), radius=radius)[voxel]
    return visible


def _by_buffer(
    xyz: NDArray[np.floating], rows: NDArray[np.int64], pixels: NDArray[np.float64], depth: NDArray[np.float64],
    camera: Camera, parameters: DepthBuffer,
) -> NDArray[np.bool_]:  # fmt: skip
    focal = 1.0 / parameters.resolution
    scale = focal / np.sqrt(camera.K[0, 0] * camera.K[1, 1])
    width, height = (int(np.ceil(side * scale)) for side in (camera.width, camera.height))
    u, v = ((pixels.T + 0.5) * scale - 0.5).astype(np.float32)
    z = depth.astype(np.float32)
    relief = depth_buffer.ground_relief(
        xyz, rows, camera.centre, parameters.ground_cell, parameters.ground_height, parameters.relief
    )
    spacing = parameters.spacing
    if spacing is None:
        spacing = depth_buffer.typical_spacing(u, v, z, focal=focal, width=width, height=height) or SPACING_OF_FEW
    shown = depth_buffer.nearest_discs(u, v, z, focal, parameters.disc * spacing, width, height)
    hidden = depth_buffer.behind_discs(
        u, v, z, relief, *shown, focal, parameters.slack, parameters.relative_slack, parameters.angle
    )
    if parameters.gap > 0:
        shown = depth_buffer.nearest_discs(u, v, z, focal, parameters.gap_disc * spacing, width, height)
        depth_buffer.hide_in_gaps(
            u, v, z, relief, *shown, focal, parameters.gap * spacing, parameters.gap_slack, parameters.relative_slack,
            parameters.gap_angle, parameters.gap_directions, hidden,
        )  # fmt: skip
    return np.logical_not(hidden)


def _check_range(max_range: float) -> None:
    if not max_range > 0:
        raise ParameterError(f"max_range must be > 0, got {max_range!r}")
