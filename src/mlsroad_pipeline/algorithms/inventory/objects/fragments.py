"""Clusters of labelled points as voxels: floating parts, sparse pieces and fragments of several scenes are joined."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.objects.boxes import convex_hull, oriented_box
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule
from mlsroad_pipeline.algorithms.inventory.objects.voxel_sums import Voxels, voxelise
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster

_CLEARANCE = 2.5  # least height of a floating part above the ground, metres: a lower one stands on its own
_MAST = 3.0  # least height of a mast that carries parts, metres
_GAP = 1.2  # largest gap between a part and the pole, metres
_REACH = 4.0  # largest horizontal distance of a part's points from the middle of the mast, metres
_BELOW = 3.0  # largest depth of a part's lowest point below the top of the mast, metres
_ROUNDS = 3  # an arm may carry a lamp beyond another gap


def join_floating_parts(
    local: NDArray[np.floating], height: NDArray[np.floating], label: NDArray[np.integer]
) -> NDArray[np.int64]:
    """Give floating clusters the number of the pole that they hang on.

    Where points are sparse, the gaps along an arm exceed the tolerance of the clustering: the lamp becomes an object of
    its own, which is none, and the pole ends below it. A cluster floats if all its points are 2.5 m above the ground.
    """
    out = np.asarray(label, dtype=np.int64).copy()
    n = int(out.max(initial=-1)) + 1
    if n == 0:
        return out
    lowest, highest = np.full(n, np.inf), np.full(n, -np.inf)
    np.fmin.at(lowest, out, height)
    np.fmax.at(highest, out, height)
    stands = (lowest < _CLEARANCE) & (highest >= _MAST)
    floats = np.isfinite(lowest) & (lowest >= _CLEARANCE)
    middle = np.array([np.bincount(out, local[:, axis], n) for axis in (0, 1)]).T
    middle /= np.maximum(np.bincount(out, minlength=n), 1)[:, None]
    owner = np.where(stands, np.arange(n), -1)
    for _ in range(_ROUNDS):
        part = np.flatnonzero(floats[out] & (owner[out] < 0))
        pole = np.flatnonzero(owner[out] >= 0)
        if not len(part) or not len(pole):
            break
        mast = _masts(local, out, part, pole, owner)
        near = np.flatnonzero(mast >= 0)
        reach = np.zeros(n)
        ends = local[part, :2] - middle[np.maximum(mast[out[part]], 0)]
        np.maximum.at(reach, out[part], np.hypot(ends[:, 0], ends[:, 1]))
        fits = (reach[near] <= _REACH) & (lowest[near] >= highest[mast[near]] - _BELOW)
        if not fits.any():
            break
        owner[near[fits]] = mast[near[fits]]
    return np.where(floats & (owner >= 0), owner, np.arange(n))[out]


def _masts(
    local: NDArray[np.floating],
    label: NDArray[np.int64],
    part: NDArray[np.int64],
    pole: NDArray[np.int64],
    owner: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Return the pole nearest to each floating cluster within the gap, -1 for none."""
    distance, nearest = cKDTree(local[pole]).query(local[part], distance_upper_bound=_GAP)
    order = np.lexsort((distance, label[part]))
    first = order[np.diff(label[part][order], prepend=-1) != 0]
    first = first[np.isfinite(distance[first])]
    mast = np.full(len(owner), -1, dtype=np.int64)
    mast[label[part[first]]] = owner[label[pole[nearest[first]]]]
    return mast


_FEW = 1500  # largest number of points of a piece; denser clusters are not cut by their spacing
_NEIGHBOUR, _SPACINGS = 4, 3.0  # a gap of a piece is at most three times the distance to its fourth nearest neighbour
_GAPS = (0.4, 0.5, 0.65, 0.8, 1.0)  # gaps that are tried, metres: neighbours park a metre apart
_CAR, _LORRY = (5.8, 2.4), (13.0, 3.2)  # length and width that joined pieces do not exceed, metres
_TALL = 2.4  # extent in height of the pieces of a lorry, metres


def join_sparse_pieces(
    local: NDArray[np.floating], label: NDArray[np.integer], tolerance: float
) -> NDArray[np.integer]:
    """Give clusters one number that are pieces of one vehicle by the spacing of their own points.

    The scan lines of a vehicle far from the scanner lie farther apart than the tolerance. Gaps are tried from the
    smallest on, and pieces are joined where the whole is not larger than a vehicle.
    """
    n = int(label.max(initial=-1)) + 1
    size = np.bincount(label, minlength=n)
    rows = np.flatnonzero(size[label] <= _FEW)
    if len(rows) <= _NEIGHBOUR:
        return label
    xyz, piece = np.asarray(local)[rows].astype(np.float64), label[rows].astype(np.int64)
    spacing = cKDTree(xyz).query(xyz, k=_NEIGHBOUR + 1)[0][:, _NEIGHBOUR]
    order = np.lexsort((spacing, piece))
    starts = np.searchsorted(piece[order], np.arange(n))
    middle = np.minimum(starts + size // 2, len(order) - 1)
    reach = np.where(size <= _FEW, _SPACINGS * spacing[order][middle], 0.0)
    owner = np.arange(n)
    for gap in (gap for gap in _GAPS if gap > tolerance):
        near = np.flatnonzero(reach[piece] >= gap)
        if len(near):
            _join_at(xyz[near], piece[near], owner, gap)
    return owner[label]


def _join_at(xyz: NDArray[np.float64], piece: NDArray[np.int64], owner: NDArray[np.int64], gap: float) -> None:
    """Join pieces with gaps up to a limit, where the whole is not larger than a vehicle; change `owner` in place."""
    group = cluster(xyz, tolerance=gap)
    order = np.argsort(group, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
        numbers = np.unique(owner[piece[part]])
        if len(numbers) > 1 and _fits_vehicle(xyz[np.isin(owner[piece], numbers)]):
            owner[np.isin(owner, numbers)] = numbers[0]


def _fits_vehicle(xyz: NDArray[np.float64]) -> bool:
    """Return whether points are not larger than a car, or, if tall, than a lorry."""
    box = oriented_box(convex_hull(xyz[:, :2]))
    length, width = _LORRY if np.ptp(xyz[:, 2]) > _TALL else _CAR
    return box.length <= length and box.width <= width


FRAGMENT_FIELDS = {
    "class": "str",
    "fragment": "int32",
    "i": "int64",
    "j": "int64",
    "k": "int64",
    "x": "float64",
    "y": "float64",
    "z": "float64",
    "x_low": "float64",
    "x_high": "float64",
    "y_low": "float64",
    "y_high": "float64",
    "z_low": "float64",
    "z_high": "float64",
    "ground": "float64",
    "count": "int64",
    "disagreeing": "int64",
    "confidence": "float64",
}
"""Columns of a fragment table: sums over the core points of a voxel, and their smallest and largest coordinates. For
precision, coordinates are relative to the corner of the voxel and `ground` to its lower face. `disagreeing` counts the
points whose own label is of another class. A voxel of buffer points alone has a count of 0."""


def find_fragments(
    local: NDArray[np.float64],
    *,
    core: NDArray[np.bool_],
    confidence: NDArray[np.float64],
    height_above_ground: NDArray[np.float64] | None,
    origin: NDArray[np.float64],
    rule: ObjectRule,
    disagreeing: NDArray[np.bool_] | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame, NDArray[np.int64], NDArray[np.int64]]:
    """Cluster the points of one class and reduce the clusters to voxels."""
    # Scaling z by the ratio of the tolerances makes the vertical tolerance equal to the horizontal one.
    squeeze = np.array([1.0, 1.0, rule.tolerance / (rule.vertical_tolerance or rule.tolerance)])
    label: NDArray[np.integer] = cluster(local * squeeze, tolerance=rule.tolerance)
    if rule.kind == "pole" and height_above_ground is not None:
        label = join_floating_parts(local, height_above_ground, label)
    if rule.kind == "vehicle":
        label = join_sparse_pieces(local, label, rule.tolerance)
    n_clusters = int(label.max(initial=-1)) + 1
    size = np.bincount(label, minlength=n_clusters)
    n_core = np.bincount(label[core], minlength=n_clusters)
    crosses = (n_core > 0) & (n_core < size)
    kept = crosses | ((n_core == size) & (size >= rule.min_points))
    pick = kept[label]
    of_whole, of_cut = np.full((2, len(local)), -1, dtype=np.int64)
    if not pick.any():
        empty = pd.DataFrame({name: pd.Series(dtype=dtype) for name, dtype in FRAGMENT_FIELDS.items()})
        return empty.drop(columns="class"), empty.drop(columns="class"), of_whole, of_cut
    voxels, row = voxelise(
        local[pick],
        group=label[pick],
        core=core[pick],
        confidence=confidence[pick],
        height_above_ground=None if height_above_ground is None else height_above_ground[pick],
        origin=origin,
        resolution=rule.resolution,
        disagreeing=None if disagreeing is None else disagreeing[pick],
    )
    cut = crosses[voxels["fragment"].to_numpy()]
    of_whole[pick] = np.where(cut, -1, np.cumsum(~cut) - 1)[row]
    of_cut[pick] = np.where(cut, np.cumsum(cut) - 1, -1)[row]
    return voxels[~cut].reset_index(drop=True), voxels[cut].reset_index(drop=True), of_whole, of_cut


def join_voxels(table: pd.DataFrame, *, resolution: float) -> tuple[Voxels, NDArray[np.int64], NDArray[np.int64]]:
    """Convert voxel sums to mean points; the sums of a voxel in several scenes are added."""
    filled = (table["count"] > 0).to_numpy()
    rows = table[filled]
    lost = np.setdiff1d(table["object"], rows["object"])
    if len(lost):
        raise DataError(f"{len(lost)} objects have voxels but no points: fragments of a scene are missing")
    key = rows[["object", "i", "j", "k", "scene"]].to_numpy()
    order = np.lexsort(key.T[::-1])
    key = key[order]
    new = np.concatenate([[True], (np.diff(key[:, :4], axis=0) != 0).any(axis=1)])
    starts = np.flatnonzero(new)

    def reduced(name: str, ufunc: np.ufunc = np.add) -> NDArray:
        return ufunc.reduceat(rows[name].to_numpy()[order], starts)

    # A voxel on a border belongs to the scene with most of its points; ties go to the first scene.
    part = rows["count"].to_numpy()[order]
    voxel = np.cumsum(new) - 1
    most = np.lexsort((key[:, 4], -part, voxel))[starts]
    corner = key[starts, 1:4] * resolution
    joined = np.full(len(table), -1, dtype=np.int64)
    joined[np.flatnonzero(filled)[order]] = voxel
    n = reduced("count")
    return (
        Voxels(
            # Rounded to 0.01 mm: the measures must not depend on the order of the scenes.
            xyz=np.round(corner + np.column_stack([reduced(name) for name in "xyz"]) / n[:, None], 5),
            low=corner + np.column_stack([reduced(f"{name}_low", np.minimum) for name in "xyz"]),
            high=corner + np.column_stack([reduced(f"{name}_high", np.maximum) for name in "xyz"]),
            ground=corner[:, 2] + reduced("ground") / n,
            count=n,
            disagreeing=reduced("disagreeing"),
            confidence=reduced("confidence"),
            scene=key[most, 4].astype(np.int32),
        ),
        key[starts, 0],
        joined,
    )
