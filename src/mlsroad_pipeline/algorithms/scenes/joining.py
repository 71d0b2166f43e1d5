"""Joining of a scene from slices of ranges of rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud, concatenate
from mlsroad_pipeline.algorithms.geometry.outliers import keep_inliers
from mlsroad_pipeline.algorithms.geometry.sorting import order_of
from mlsroad_pipeline.algorithms.scenes.binning import BinnedCloud
from mlsroad_pipeline.algorithms.scenes.parameters import OutlierParameters
from mlsroad_pipeline.algorithms.scenes.spans import SceneSpan


def join_pieces(
    pieces: Sequence[Mapping[str, NDArray]], span: SceneSpan, outliers: OutlierParameters, source: str
) -> PointCloud:
    """Join a scene from stored pieces."""
    parts = [BinnedCloud.from_arrays(piece).between(*span.reach) for piece in pieces]
    filled = [part for part in parts if len(part)]
    corner = np.floor(np.min([_lowest(part.cloud.xyz) + part.cloud.origin for part in filled], axis=0))
    joined = assemble_scene([_single_precision(part, corner) for part in filled], span)
    scene = replace(joined, source=source)
    if outliers.enabled:
        inlier = keep_inliers(scene.xyz, n_neighbors=outliers.k, std_ratio=outliers.ratio)
        scene = scene.with_columns(outlier=~inlier)
    return scene


def _lowest(xyz: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the least coordinates; columns one by one are twenty times as fast as ``min(axis=0)``."""
    return np.array([xyz[:, axis].min() for axis in range(3)])


def _single_precision(piece: BinnedCloud, origin: NDArray[np.float64]) -> BinnedCloud:
    """Return points in float32, relative to another origin."""
    xyz = np.empty(piece.cloud.xyz.shape, dtype=np.float32)
    for axis in range(3):
        xyz[:, axis] = piece.cloud.xyz[:, axis] + (piece.cloud.origin[axis] - origin[axis])
    return replace(piece, cloud=replace(piece.cloud, xyz=xyz, origin=origin))


def assemble_scene(pieces: Sequence[BinnedCloud], span: SceneSpan) -> PointCloud:
    """Join a scene from ranges of rows."""
    parts, cores, nears = [], [], []
    for piece in pieces:
        cloud, core, near = _within(piece.between(*span.reach), span)
        if len(cloud) > 0:
            parts.append(cloud)
            cores.append(core)
            nears.append(near)
    if not parts:
        raise DataError(f"{span.id}: none of {len(pieces)} pieces has points in bins {span.first} to {span.stop - 1}")
    # Origin and column order are those of the first piece, so pieces are sorted first.
    rank = sorted(range(len(parts)), key=lambda i: (int(parts[i]["file"][0]), int(parts[i]["row"].min())))
    scene = concatenate([parts[i] for i in rank])
    scene = scene.with_columns(core=np.concatenate([cores[i] for i in rank]))
    if span.context:
        scene = scene.with_columns(near=np.concatenate([nears[i] for i in rank]))
    low = int(scene["row"].min())
    n_rows = int(scene["row"].max()) + 1 - low
    keys, order = order_of(scene["file"].astype(np.int64) * n_rows + (scene["row"] - low))
    twice = np.flatnonzero(keys[1:] == keys[:-1])
    if len(twice):
        file, row = divmod(int(keys[twice[0]]), n_rows)
        raise DataError(f"{span.id}: row {row + low} of file {file} occurs in two pieces")
    return replace(scene.select(order), source=span.id)


def _within(part: BinnedCloud, span: SceneSpan) -> tuple[PointCloud, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the points of a scene in a range of rows, and which of them are in the core, and in core and buffers."""
    count = np.diff(part.indptr)
    core = np.repeat((part.bins >= span.first) & (part.bins < span.stop), count)
    near = np.repeat((part.bins >= span.buffer_first) & (part.bins < span.buffer_stop), count)
    if span.context_step == 1:
        return part.cloud, core, near
    # A hash of the row: every n-th row may be of one beam of the scanner.
    row = part.cloud["row"].astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    kept = np.flatnonzero(near | ((row >> np.uint64(33)) % np.uint64(span.context_step) == 0))
    return part.cloud.select(kept), core[kept], near[kept]
