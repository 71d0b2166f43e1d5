"""Extraction of road objects from labelled points, consistent across scene borders.

`extract_objects` clusters the points of a scene's core and buffers. Objects wholly in the core are measured. Of objects
that extend into a buffer only the voxels of core points are kept; `merging.merge_across_scenes` merges them by shared
voxels and measures the whole. Cores are disjoint, so no point counts twice and objects may span any number of scenes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_xyz
from mlsroad_pipeline.algorithms.inventory.measures import ObjectMeasures, Voxels, measure
from mlsroad_pipeline.algorithms.inventory.rules import ObjectRule
from mlsroad_pipeline.algorithms.inventory.splitting import split_at_valleys
from mlsroad_pipeline.algorithms.inventory.table import empty_table, object_table
from mlsroad_pipeline.algorithms.inventory.voxels import FRAGMENT_FIELDS, find_fragments, join_voxels, voxelise


@dataclass(frozen=True)
class SceneObjects:
    """Objects and fragments of a scene.

    Parameters
    ----------
    scene : str
        The scene's id.
    objects : DataFrame
        Objects wholly in the core: columns of `OBJECT_FIELDS`, `object_id` and `pole_id` are 0.
    fragments : DataFrame
        Voxels of the objects that extend into a buffer: columns of `FRAGMENT_FIELDS`.
    part : ndarray of int32, shape (n_core,)
        Object of each point of the core: k + 1 for row k of `objects`, -k - 1 for row k of `fragments`, 0 for none.
        `merging.SceneNumbers` has the number in the inventory for each of these values.
    """

    scene: str
    objects: pd.DataFrame
    fragments: pd.DataFrame
    part: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, dtype=np.int32))


def measured_rows(
    voxels: Voxels, number: NDArray[np.int64], name: str, rule: ObjectRule, scenes: Sequence[str]
) -> tuple[list[dict[str, Any]], NDArray[np.int64]]:
    """Measure the objects of one class and discard those that violate the rule.

    Parameters
    ----------
    voxels : Voxels
        Voxels of the objects, sorted by object.
    number : ndarray of int64
        Object of each voxel.
    name : str
        The class.
    rule : ObjectRule
        Rule of the class.
    scenes : sequence of str
        Names of the scenes numbered in `voxels`.

    Returns
    -------
    rows : list of dict
        `ObjectMeasures` of each object, with `class`, `kind` and the name of the scene.
    owner : ndarray of int64, shape (len(number),)
        Index into `rows` of each voxel, -1 for voxels of discarded objects.
    """
    rows: list[dict[str, Any]] = []
    owner = np.full(len(number), -1, dtype=np.int64)
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    for first, stop in zip(starts, np.append(starts[1:], len(number)), strict=True):
        whole = voxels.select(np.arange(first, stop))
        parts = [np.arange(first, stop)]
        if rule.split_spacing is not None and whole.count.sum() >= rule.min_points:
            label = split_at_valleys(whole, spacing=rule.split_spacing, depth=rule.split_depth)
            parts = [first + np.flatnonzero(label == i) for i in range(int(label.max()) + 1)]
        for index in parts:
            part = voxels.select(index)
            if part.count.sum() < rule.min_points:
                continue
            row = measure(part, rule.kind)
            height, clearance, extent = row["height"], row["clearance"], row["extent"]
            hangs = clearance > rule.max_clearance  # False if the ground is unknown
            if rule.kind == "sign" and clearance > 0:
                height -= clearance  # own height: a panel may hang at any height
            fits = rule.min_height <= height <= rule.max_height and rule.min_width <= extent <= rule.max_width
            if fits and not hangs:
                owner[index] = len(rows)
                rows.append({**row, "class": name, "kind": rule.kind, "scene": scenes[row["scene"]]})
    return rows, owner


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
    """Extract and measure the objects of a scene.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points of core and buffers, metres relative to `origin`.
    labels : array-like of int, shape (n,)
        Labels of the class scheme.
    confidence : array-like of shape (n,)
        Confidence of the labels, 0 to 1.
    classes : mapping of str to ObjectRule
        Class name to rule, see `rules.rules_for_scheme`.
    core : array-like of bool, shape (n,), optional
        True in the core of the scene; None treats the points as a whole survey. The buffer must be at least as wide as
        the largest tolerance, otherwise fragments of an object at the border are not merged.
    origin : array-like of shape (3,), default zeros
        World coordinates of the origin of `xyz`, metres.
    height_above_ground : array-like of shape (n,), optional
        Heights, metres. Without them the base of an object is its lowest part, and clearances are unknown.
    scene : str, default "scene_00000"
        The scene's id.

    Returns
    -------
    SceneObjects
        Measured objects, the fragments of objects that extend into a buffer, and the object of each point of the core.

    Raises
    ------
    DataError
        If a coordinate, confidence or height is NaN or infinite, or the shapes differ.
    """
    points = check_xyz(xyz)
    n = len(points)
    label = check_column(labels, n, "labels")
    inside = np.ones(n, dtype=bool) if core is None else check_column(core, n, "core").astype(bool)
    certainty = _finite(confidence, n, "confidence")
    height = None if height_above_ground is None else _finite(height_above_ground, n, "height_above_ground")
    zero = np.asarray(origin, dtype=np.float64)
    rows: list[dict[str, Any]] = []
    fragments: list[pd.DataFrame] = []
    part, n_cut = np.zeros(n, dtype=np.int32), 0
    for name, rule in classes.items():
        mine = np.flatnonzero(np.isin(label, rule.labels))
        whole, cut, of_whole, of_cut = find_fragments(
            points[mine].astype(np.float64),
            core=inside[mine],
            confidence=certainty[mine],
            height_above_ground=None if height is None else height[mine],
            origin=zero,
            rule=rule,
        )
        if len(whole):
            table = whole.assign(object=whole["fragment"].astype(np.int64), scene=0)
            voxels, number, joined_row = join_voxels(table, resolution=rule.resolution)
            found, owner = measured_rows(voxels, number, name, rule, [scene])
            of_row = np.append(np.where(owner < 0, 0, owner + len(rows) + 1)[joined_row], 0)
            part[mine] = of_row[of_whole]
            rows += found
        if len(cut):
            part[mine[of_cut >= 0]] = -1 - n_cut - of_cut[of_cut >= 0]
            fragments.append(cut.assign(**{"class": name}))
            n_cut += len(cut)
    joined = pd.concat(fragments, ignore_index=True) if fragments else empty_table(FRAGMENT_FIELDS)
    table = joined[list(FRAGMENT_FIELDS)].astype(FRAGMENT_FIELDS)
    return SceneObjects(scene, object_table(rows), table, part[inside])


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
) -> ObjectMeasures:
    """Measure one object from its points.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        The points of the object, metres relative to `origin`; at least one.
    rule : ObjectRule
        Kind of the object and size of the voxels; the limits of the rule are not applied.
    height_above_ground : array-like of shape (n,), optional
        Heights, metres. Without them the base of the object is its lowest part.
    confidence : array-like of shape (n,), optional
        Confidence of the points, 0 to 1; None is 1.
    origin : array-like of shape (3,), default zeros
        World coordinates of the origin of `xyz`, metres.

    Returns
    -------
    ObjectMeasures
        Measures of the object.

    Raises
    ------
    DataError
        If there is no point, a value is NaN or infinite, or the shapes differ.
    """
    points = check_xyz(xyz).astype(np.float64)
    n = len(points)
    if n == 0:
        raise DataError("an object without points cannot be measured")
    voxels, _ = voxelise(
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
