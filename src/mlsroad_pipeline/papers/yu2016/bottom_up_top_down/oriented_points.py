"""Surfaces of objects: oriented points, their spin images and Gaussian images."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_positive, check_xyz
from mlsroad_pipeline.algorithms.features.normals import compute_normals
from mlsroad_pipeline.algorithms.features.spin_image import compute_spin_images
from mlsroad_pipeline.algorithms.geometry.voxels import build_voxel_grid
from mlsroad_pipeline.papers.shared.detection.regions import stand_apart
from mlsroad_pipeline.papers.shared.detection.types import Segments


def spread_evenly(points: NDArray[np.float64], bounds: NDArray[np.int64], most: int) -> NDArray[np.bool_]:
    """Return up to `most` points of each object by farthest-point sampling from the lowest point."""
    chosen = np.zeros(len(points), np.bool_)
    for first, last in pairwise(bounds.tolist()):
        own, mine = points[first:last], chosen[first:last]
        if len(own) <= most:
            mine[:] = True
            continue
        away, at = np.full(len(own), np.inf), own[:, 2].argmin()
        for _ in range(most):
            mine[at] = True
            away = np.minimum(away, ((own - own[at]) ** 2).sum(axis=1))
            at = away.argmax()
    return chosen


@njit(cache=True, nogil=True)
def nearest_images(
    images: NDArray[np.float32],
    owner: NDArray[np.int32],
    database: NDArray[np.float32],
    database_owner: NDArray[np.int32],
    out: NDArray[np.int32],
    start: int,
    stop: int,
) -> None:
    """Write the nearest image of the database that belongs to another object; -1 for none."""
    width = images.shape[1]
    for q in range(start, stop):
        best = np.float32(np.inf)
        nearest = -1
        for d in range(len(database)):
            if database_owner[d] == owner[q]:
                continue
            total = np.float32(0.0)
            j = 0
            while j < width and total < best:
                for i in range(j, min(j + 17, width)):
                    step = images[q, i] - database[d, i]
                    total += step * step
                j += 17
            if total < best:
                best, nearest = total, d
        out[q] = nearest


@njit(cache=True, nogil=True)
def _near(points: NDArray, n: int, others: NDArray, m: int, reach: float, shift: NDArray, move: NDArray) -> float:
    """Return the sum of nearest-neighbour weights of shifted points, 1 to 0 at `reach`; write their mean offset."""
    gain, matched = 0.0, 0.0
    move[:] = 0.0
    for i in range(n):
        best, nearest = reach * reach, -1
        x, y, z = points[i, 0] + shift[0], points[i, 1] + shift[1], points[i, 2] + shift[2]
        for j in range(m):
            dx, dy, dz = others[j, 0] - x, others[j, 1] - y, others[j, 2] - z
            squared = dx * dx + dy * dy + dz * dz
            if squared < best:
                best, nearest = squared, j
        if nearest >= 0:
            gain += 1.0 - np.sqrt(best) / reach
            matched += 1.0
            move[0] += others[nearest, 0] - x
            move[1] += others[nearest, 1] - y
            move[2] += others[nearest, 2] - z
    if matched > 0.0:
        for axis in range(3):
            move[axis] /= matched
    return gain


@njit(cache=True, nogil=True)
def overlap_surfaces(
    models: NDArray[np.float64],
    model_bounds: NDArray[np.int64],
    points: NDArray[np.float64],
    bounds: NDArray[np.int64],
    turns: NDArray[np.float64],
    wanted: NDArray[np.bool_],
    reach: float,
    n_steps: int,
    out: NDArray[np.float64],
    start: int,
    stop: int,
) -> None:
    """Write the mutual overlap of rotated models and objects, 0 to 1, the larger for the angle and its opposite."""
    shift, back, move = np.zeros(3), np.zeros(3), np.zeros(3)
    for o in range(start, stop):
        mine = points[bounds[o] : bounds[o + 1]]
        m = len(mine)
        for p in range(out.shape[1]):
            model = models[model_bounds[p] : model_bounds[p + 1]]
            n = len(model)
            if n == 0 or m == 0 or not wanted[o, p]:
                continue
            turned = np.empty((n, 3))
            for half in range(2):
                angle = turns[o, p] + half * np.pi
                cosine, sine = np.cos(angle), np.sin(angle)
                for i in range(n):
                    turned[i, 0] = cosine * model[i, 0] - sine * model[i, 1]
                    turned[i, 1] = sine * model[i, 0] + cosine * model[i, 1]
                    turned[i, 2] = model[i, 2]
                shift[:] = 0.0
                for _ in range(n_steps + 1):
                    gain = _near(turned, n, mine, m, reach, shift, move)
                    for axis in range(3):
                        back[axis] = -shift[axis]
                        shift[axis] += move[axis]
                    gain_back = _near(mine, m, turned, n, reach, back, move)
                    out[o, p] = max(out[o, p], min(gain / n, gain_back / m))


@dataclass(frozen=True)
class OrientedPointParameters:
    """Parameters of oriented points and spin images."""

    # Points are thinned to one per voxel of this edge, metres, so that near and far surfaces have equal weight
    voxel_size: float = 0.1
    normal_radius: float = 0.3  # Neighbourhood of the normals, metres
    # Neighbourhood of the spin images, metres. Larger describes more of an object and is more sensitive to occlusion.
    image_radius: float = 1.0
    # n_radial, n_axial: size of the spin images: 153 bins
    n_radial: int = 9
    n_axial: int = 17
    max_points: int = 40  # Largest number of oriented points of an object, by farthest-point sampling

    def __post_init__(self) -> None:
        for name in ("voxel_size", "normal_radius", "image_radius"):
            check_positive(getattr(self, name), name)
        for name, least in (("n_radial", 2), ("n_axial", 2), ("max_points", 1)):
            if getattr(self, name) < least:
                raise ParameterError(f"{name} must be at least {least}, got {getattr(self, name)!r}")


def describe_surfaces(
    scene: PointCloud, objects: Segments, *, parameters: OrientedPointParameters
) -> dict[str, NDArray]:
    """Describe the objects of a scene by oriented points, each object separately.

    Normals point away from the centre of their object.
    """
    p = parameters
    owner = np.asarray(objects["objects"])
    n = int(owner.max(initial=-1)) + 1
    facts = {"n_objects": np.array(n), "intensity": np.array(False)}
    rows = np.flatnonzero(owner >= 0)
    rows = rows[np.argsort(owner[rows], kind="stable")]
    points, owner = check_xyz(scene.xyz[rows]).astype(np.float64), owner[rows].astype(np.int32)
    if len(rows) == 0:
        images, nothing = np.zeros((0, p.n_radial * p.n_axial), np.float32), np.zeros((0, 3))
        return {"centres": nothing, "normals": nothing, "images": images, "objects": owner, **facts}
    shift = stand_apart(points, owner, cell=p.voxel_size, gap=2.0 * max(p.image_radius, p.normal_radius))
    grid = build_voxel_grid(points + shift, voxel_size=p.voxel_size, anchor=np.zeros(3))
    first = np.unique(grid.voxel_of_point, return_index=True)[1]
    order = np.argsort(owner[first], kind="stable")
    places, back, kinds = grid.centroids[order], shift[first][order], owner[first][order]
    bounds = np.searchsorted(kinds, np.arange(n + 1)).astype(np.int64)
    chosen = spread_evenly(places, bounds, p.max_points)
    normals = compute_normals(places, radius=p.normal_radius)
    sums = np.zeros((n, 3))
    np.add.at(sums, kinds, places)
    middle = sums / np.maximum(np.diff(bounds), 1)[:, None]
    inwards = ((places - middle[kinds]) * normals).sum(axis=1) < 0
    normals = np.where(inwards[:, None], -normals, normals)[chosen]
    images = compute_spin_images(
        places, normals, radius=p.image_radius, n_radial=p.n_radial, n_axial=p.n_axial, queries=places[chosen]
    )
    described: dict[str, NDArray] = {"centres": (places - back)[chosen], "normals": normals, "images": images}
    return {**described, "objects": kinds[chosen], **facts}
