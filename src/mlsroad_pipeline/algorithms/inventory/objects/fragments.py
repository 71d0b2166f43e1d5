"""Fragments of objects that lie in several scenes: clusters of labelled points as voxels, and their joining."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.objects.pieces import join_floating_parts, join_sparse_pieces
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule
from mlsroad_pipeline.algorithms.inventory.objects.voxel_sums import Voxels, voxelise
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster

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
