"""The inventory of road objects: labelled points in, measured objects out, none twice and none lost at scene borders.

A scene finds the connected objects of its core and buffers (`extract_objects`). What lies wholly in the core is
measured there. Of an object that reaches into a buffer only the voxels of its core points are kept, and
`merging.merge_across_scenes` joins those of all scenes that share a voxel and measures the whole: as cores
share no point, nothing counts twice, and an object may be as long as it likes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_xyz
from mlsroad_pipeline.algorithms.inventory.measures import Voxels, measure
from mlsroad_pipeline.algorithms.inventory.rules import ObjectRule
from mlsroad_pipeline.algorithms.inventory.splitting import split_at_valleys
from mlsroad_pipeline.algorithms.inventory.table import empty_table, object_table
from mlsroad_pipeline.algorithms.inventory.voxels import FRAGMENT_FIELDS, find_fragments, join_voxels, voxelise


@dataclass(frozen=True)
class SceneObjects:
    """What a scene knows of the inventory.

    Parameters
    ----------
    scene : str
        The scene's id.
    objects : DataFrame
        Objects that lie wholly in the core: columns of `OBJECT_FIELDS`, `object_id` and `pole_id` still 0.
    fragments : DataFrame
        Voxels of the objects that reach into a buffer: columns of `FRAGMENT_FIELDS`.
    """

    scene: str
    objects: pd.DataFrame
    fragments: pd.DataFrame


def measured_rows(
    voxels: Voxels, number: NDArray[np.int64], name: str, rule: ObjectRule, scenes: Sequence[str]
) -> list[dict[str, float | int | str]]:
    """Measure the objects of one class and drop the false ones.

    Parameters
    ----------
    voxels : Voxels
        Their voxels, sorted by object.
    number : ndarray of int64
        The object of each voxel.
    name : str
        The class.
    rule : ObjectRule
        What its objects are like.
    scenes : sequence of str
        Names of the scenes that `voxels` counts.

    Returns
    -------
    list of dict
        One per object, with what `measures.measure` gives, class, kind and scene.
    """
    rows = []
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    for first, stop in zip(starts, np.append(starts[1:], len(number)), strict=True):
        whole = voxels.select(np.arange(first, stop))
        parts = [whole]
        if rule.split_spacing is not None and whole.count.sum() >= rule.min_points:
            label = split_at_valleys(whole, spacing=rule.split_spacing, depth=rule.split_depth)
            parts = [whole.select(label == i) for i in range(int(label.max()) + 1)]
        for part in parts:
            if part.count.sum() < rule.min_points:
                continue
            row = measure(part, rule.kind)
            height, clearance, extent = (float(row[key]) for key in ("height", "clearance", "extent"))
            hangs = clearance > rule.max_clearance  # False where the ground is not known
            if rule.kind == "sign" and clearance > 0:
                height -= clearance  # of what there is: a panel may hang anywhere
            fits = rule.min_height <= height <= rule.max_height and rule.min_width <= extent <= rule.max_width
            if fits and not hangs:
                rows.append({**row, "class": name, "kind": rule.kind, "scene": scenes[int(row["scene"])]})
    return rows


def extract_objects(
    xyz: ArrayLike,
    labels: ArrayLike,
    confidence: ArrayLike,
    *,
    classes: Mapping[str, ObjectRule],
    core: ArrayLike | None = None,
    origin: ArrayLike = (0.0, 0.0, 0.0),
    height_above_ground: ArrayLike | None = None,
    scene: str = "scene_00000",
) -> SceneObjects:
    """Find and measure the objects of a scene.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points of core and buffers, metres relative to `origin`.
    labels : array-like of int, shape (n,)
        Labels of the class scheme.
    confidence : array-like of shape (n,)
        Confidence of the labels, 0 to 1.
    classes : mapping of str to ObjectRule
        Class name to what makes its objects, such as `rules.rules_for_scheme` gives.
    core : array-like of bool, shape (n,), optional
        True in the scene's core; None takes the points as a whole survey. The buffer must be at least as wide as the
        largest tolerance, or objects that touch the border are not recognised in both scenes.
    origin : array-like of shape (3,), default zeros
        World coordinates of the zero of `xyz`, metres.
    height_above_ground : array-like of shape (n,), optional
        Metres. Without it the base of an object is its own lowest part, and clearances are not known.
    scene : str, default "scene_00000"
        The scene's id.

    Returns
    -------
    SceneObjects
        Measured objects, and the fragments of those that reach into a buffer; `merging` makes the table.

    Raises
    ------
    DataError
        If a coordinate, confidence or height is NaN or infinite, or the shapes do not fit.
    """
    points = check_xyz(xyz)
    n = len(points)
    label = check_column(labels, n, "labels")
    inside = np.ones(n, dtype=bool) if core is None else check_column(core, n, "core").astype(bool)
    sure = _finite(confidence, n, "confidence")
    height = None if height_above_ground is None else _finite(height_above_ground, n, "height_above_ground")
    zero = np.asarray(origin, dtype=np.float64)
    rows, fragments = [], []
    for name, rule in classes.items():
        mine = np.flatnonzero(np.isin(label, rule.labels))
        whole, cut = find_fragments(
            points[mine].astype(np.float64),
            core=inside[mine],
            confidence=sure[mine],
            height_above_ground=None if height is None else height[mine],
            origin=zero,
            rule=rule,
        )
        if len(whole):
            table = whole.assign(object=whole["fragment"].astype(np.int64), scene=0)
            rows += measured_rows(*join_voxels(table, resolution=rule.resolution), name, rule, [scene])
        if len(cut):
            fragments.append(cut.assign(**{"class": name}))
    joined = pd.concat(fragments, ignore_index=True) if fragments else empty_table(FRAGMENT_FIELDS)
    return SceneObjects(scene, object_table(rows), joined[list(FRAGMENT_FIELDS)].astype(FRAGMENT_FIELDS))


def _finite(values: ArrayLike, n_points: int, name: str) -> NDArray[np.float64]:
    array = check_column(values, n_points, name).astype(np.float64)
    if not np.isfinite(array).all():
        row = int(np.flatnonzero(~np.isfinite(array))[0])
        raise DataError(f"{name} at row {row} is {array[row]}")
    return array


def measure_points(
    xyz: ArrayLike,
    rule: ObjectRule,
    *,
    height_above_ground: ArrayLike | None = None,
    confidence: ArrayLike | None = None,
    origin: ArrayLike = (0.0, 0.0, 0.0),
) -> dict[str, float | int | str]:
    """Measure one object whose points are known.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        The points of the object, metres relative to `origin`; at least one.
    rule : ObjectRule
        Its kind and the size of the voxels; nothing is asked of the object otherwise.
    height_above_ground : array-like of shape (n,), optional
        Metres. Without it the base of the object is its own lowest part.
    confidence : array-like of shape (n,), optional
        Confidence of the points, 0 to 1; None is 1.
    origin : array-like of shape (3,), default zeros
        World coordinates of the zero of `xyz`, metres.

    Returns
    -------
    dict of str to float, int or str
        What `measures.measure` gives.

    Raises
    ------
    DataError
        If there is no point, a value is NaN or infinite, or the shapes do not fit.
    """
    points = check_xyz(xyz).astype(np.float64)
    n = len(points)
    if n == 0:
        raise DataError("an object without points cannot be measured")
    voxels = voxelise(
        points,
        group=np.zeros(n, dtype=np.int32),
        core=np.ones(n, dtype=bool),
        confidence=np.ones(n) if confidence is None else _finite(confidence, n, "confidence"),
        height_above_ground=None
        if height_above_ground is None
        else _finite(height_above_ground, n, "height_above_ground"),
        origin=np.asarray(origin, dtype=np.float64),
        resolution=rule.resolution,
    )
    return measure(join_voxels(voxels.assign(object=0, scene=0), resolution=rule.resolution)[0], rule.kind)
