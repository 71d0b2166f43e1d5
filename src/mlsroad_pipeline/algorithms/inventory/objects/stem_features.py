"""Upright lines among points of poles, signs and trees, and their features."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.geometry.cells import sort_into_cells
from mlsroad_pipeline.algorithms.inventory.objects.evidence import GROUP_FEATURES, SUMS, SceneCells, group_features
from mlsroad_pipeline.algorithms.segmentation.crowned_stems import measure_crowned
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.stems import Stem, StemLimits, find_stems

PROFILE = (
    "low_ring", "middle_ring", "high_ring", "low_filled", "high_filled", "low_core", "high_core", "bow", "overhead",
)  # fmt: skip
"""Features of the surroundings of a stem by thirds of its length, of its widths, and of its straightness."""

CROWN_FEATURES = ("crown_inner", "crown_outer", "crown_aside", "crown_depth", "beside")
"""Features of the foliage around the upper end of a stem: a tree's own crown lies around it, a neighbour's aside."""

STEM_FEATURES = (
    "low", "high", "length", "slope", "stems", "top", "beam", "crowned", "bend", "lean", "spread", "aside", "reached",
    "above_end", "core", "log_voxels",
    *PROFILE,
    *CROWN_FEATURES,
    *GROUP_FEATURES,
)  # fmt: skip
"""Names of the features of a stem; lengths in metres."""

_VOXEL, _TOLERANCE, _VERTICAL_TOLERANCE = 0.1, 0.25, 0.5  # metres; scan lines on a pole lie up to 0.4 m apart
_LINES = StemLimits(section_height=0.3, section_tolerance=0.2, max_shift=0.2, max_residual=0.08)
"""Wider limits than in the segmentation: sections of thinly scanned poles hold few points."""
_FREE_LENGTH = 0.8  # least length of a stem that stands free, metres
_RADIUS = 0.25  # largest distance of the points of a stem from its axis, metres
_RING, _LAYER = (0.3, 1.2), 0.25  # distances from the axis, and height of a layer, metres
_BELOW, _ABOVE = 0.3, 0.2  # length beyond the ends of a stem over which points belong to it, metres
_CROWN_RADIUS = 3.5  # largest distance of the places of a crown from the axis, metres
_CROWN_CORE, _CROWN_INNER = 0.3, 1.0  # distances from the axis, metres
_CROWN_OVERLAP = 0.5  # length below the upper end that belongs to a crown, metres
_CROWN_LEAST = 5  # places of a crown whose middle is measured


class Stems(NamedTuple):
    """Stems of a scene."""

    features: NDArray[np.float32]  # `STEM_FEATURES` of each stem
    points: NDArray[np.int64]  # points that were searched
    owner: NDArray[np.int64]  # stem of each of them, -1 for none


def find_scene_stems(
    local: NDArray[np.floating], height: NDArray[np.floating], points: NDArray[np.int64], cells: SceneCells
) -> Stems:
    """Find stems among some points of a scene that may be poles, posts or trunks.

    `local` and `height` are coordinates and heights above the ground of all points, m; `cells` hold the evidence.
    """
    none = Stems(np.zeros((0, len(STEM_FEATURES)), np.float32), points, np.full(len(points), -1))
    if not len(points):
        return none
    voxel, xyz, counts, ground = _voxels(
        local.take(points, axis=0).astype(np.float64), height[points].astype(np.float64)
    )
    group = cluster(xyz * (1.0, 1.0, _TOLERANCE / _VERTICAL_TOLERANCE), tolerance=_TOLERANCE)
    owner, nearest = np.full(len(xyz), -1), np.full(len(xyz), _RADIUS)
    rows: list[NDArray[np.float64]] = []
    found: list[Stem] = []
    for _, members, stems in sorted(find_stems(xyz, counts, group, _FREE_LENGTH, _LINES), key=lambda one: one[0]):
        found += stems
        rows += _measure(stems, members, xyz, counts, ground, owner, nearest, len(rows))
    if not rows:
        return none
    of_point = owner[voxel]
    mine = np.flatnonzero(of_point >= 0)
    table = cells.around(points[mine], of_point[mine])
    sums = np.zeros((len(rows), len(SUMS)))
    np.add.at(sums, table["fragment"].to_numpy(), table[list(SUMS)].to_numpy(dtype=np.float64))
    features = np.concatenate([np.array(rows), crown_features(found, xyz), group_features(sums)], axis=1)
    return Stems(features.astype(np.float32), points, of_point)


def _voxels(
    xyz: NDArray[np.float64], height: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Return the voxel of each point, mean points, numbers of points, and elevations of the ground."""
    cells = sort_into_cells(xyz, origin=np.zeros(3), size=_VOXEL)
    order, starts, counts = cells.order, cells.starts[:-1], np.diff(cells.starts)
    mean = np.add.reduceat(xyz.take(order, axis=0), starts, axis=0) / counts[:, None]
    ground = np.add.reduceat((xyz[:, 2] - height)[order], starts) / counts
    return cells.owner(), mean, counts, ground


def _measure(
    stems: list[Stem], members: NDArray[np.int64], xyz: NDArray[np.float64], counts: NDArray[np.int64],
    ground: NDArray[np.float64], owner: NDArray[np.int64], nearest: NDArray[np.float64], n_before: int,
) -> list[NDArray[np.float64]]:  # fmt: skip
    """Return the measures of the stems of a cluster, and set the owner of its voxels."""
    places = xyz[members]
    beam, crowned, measures = measure_crowned(places, counts[members], stems) if stems else ((), (), ())
    crown = {int(k): row for k, row in zip(crowned, measures, strict=True)}
    rows = []
    for k, stem in enumerate(stems):
        distance, z = stem.distance(places), places[:, 2]
        inside = (distance < nearest[members]) & (z >= stem.low - _BELOW) & (z <= stem.high + _ABOVE)
        mine = members[inside]
        owner[mine], nearest[mine] = n_before + k, distance[inside]
        floor = float(np.median(ground[mine])) if len(mine) else np.nan
        core = float(distance[inside].mean()) if len(mine) else np.nan
        rows.append(
            np.array([
                stem.low - floor, stem.high - floor, stem.high - stem.low, np.hypot(*stem.slope), len(stems),
                z.max() - stem.high, beam[k] >= 0, k in crown, *crown.get(k, np.full(6, np.nan)), core,
                np.log1p(len(mine)), *_profile(stem, places, distance),
            ], dtype=np.float64)
        )  # fmt: skip
    return rows


def _profile(stem: Stem, places: NDArray[np.float64], distance: NDArray[np.float64]) -> list[float]:
    """Return the features of `PROFILE`; a crown fills the ring around the upper third of a trunk, an arm one layer."""
    z = places[:, 2]
    along = (z >= stem.low - _BELOW) & (z <= stem.high + _ABOVE)
    core, ring = along & (distance < _RADIUS), along & (distance > _RING[0]) & (distance < _RING[1])
    third = np.clip((3 * (z - stem.low) / (stem.high - stem.low)).astype(np.int64), 0, 2)
    n_core, n_ring = (np.bincount(third[part], minlength=3) for part in (core, ring))
    n_layers = max(1, int((stem.high - stem.low) / 3 / _LAYER))
    filled = [len(np.unique((z[ring & (third == k)] / _LAYER).astype(np.int64))) / n_layers for k in (0, 2)]
    width = [float(distance[core & (third == k)].mean()) if n_core[k] else np.nan for k in (0, 2)]
    away = stem.away(places[core])
    means = [away[third[core] == k].mean(axis=0) if n_core[k] else np.full(2, np.nan) for k in range(3)]
    overhead = np.log1p(((z > stem.high + _ABOVE) & (distance < _RING[1])).sum())
    return [
        *(np.log1p(n_ring) - np.log1p(n_core)).tolist(), *filled, *width,
        float(np.hypot(*(means[0] + means[2] - 2 * means[1]))), float(overhead),
    ]  # fmt: skip


def crown_features(stems: Sequence[Stem], xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `CROWN_FEATURES` of stems among places that may be of poles, signs or trees."""
    found = np.full((len(stems), len(CROWN_FEATURES)), np.nan)
    if not len(stems):
        return found
    ends = np.array([stem.at(stem.high) for stem in stems])
    near = cKDTree(xyz[:, :2]).query_ball_point(ends, _CROWN_RADIUS + 1.0)
    for k, (stem, rows) in enumerate(zip(stems, near, strict=True)):
        places = xyz[rows]
        away, z = stem.away(places), places[:, 2]
        distance = np.hypot(away[:, 0], away[:, 1])
        within = distance < _CROWN_RADIUS
        above = within & (z > stem.high - _CROWN_OVERLAP) & ((distance > _CROWN_CORE) | (z > stem.high))
        inner, outer = above & (distance < _CROWN_INNER) & (z > stem.high), above & (distance >= _CROWN_INNER)
        aside = np.nan
        if above.sum() >= _CROWN_LEAST:
            aside = float(np.hypot(*away[above].mean(axis=0)) / distance[above].mean())
        middle = (stem.low + stem.high) / 2
        beside = within & (distance > _CROWN_CORE) & (z > middle) & (z <= stem.high - _CROWN_OVERLAP)
        depth = max(float(z[above].max()) - stem.high, 0.0) if above.any() else 0.0
        found[k] = np.log1p(inner.sum()), np.log1p(outer.sum()), aside, depth, np.log1p(beside.sum())
    return found
