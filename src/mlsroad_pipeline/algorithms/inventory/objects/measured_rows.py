"""Rows of the object table from the voxels of candidates: splitting, measuring, rules, features, classification."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.inventory.objects.boxes import vehicle_box
from mlsroad_pipeline.algorithms.inventory.objects.evidence import CELL, GROUP_FEATURES, SUMS, group_features
from mlsroad_pipeline.algorithms.inventory.objects.measures import ObjectMeasures, complete_vehicle, measure
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import Classifier
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule
from mlsroad_pipeline.algorithms.inventory.objects.trunks import find_trunks, main_trunk, split_trees
from mlsroad_pipeline.algorithms.inventory.objects.voxel_sums import Voxels

MEASURED = (
    "height", "width", "length", "tilt", "diameter", "crown_diameter", "panel_bottom", "panel_centre", "panel_height",
    "panel_width", "clearance", "visible_share", "extent",
)  # fmt: skip
"""Measures that are features."""

SHAPE = (
    "deviation_1", "deviation_2", "deviation_3", "linearity", "planarity", "plan_deviation_1", "plan_deviation_2",
    "span", "filled", "log_voxels", "log_points", "log_density", "radius_50", "radius_90", "low_width", "middle_width",
    "top_width", "low_share", "middle_share", "top_share", "foot_width",
)  # fmt: skip
"""Features of the shape; lengths in metres."""

TRUNK = ("trunk_width", "trunk_layers", "trunk_low", "trunk_log_voxels", "trunk_offset", "trunks")
"""Features of the trunks of a tree."""

FEATURES = (
    *GROUP_FEATURES,
    *MEASURED,
    *SHAPE,
    *TRUNK,
    "from_signs",
)
"""Names of the features."""

_LAYER, _FOOT = 0.25, 0.5


def object_features(
    voxels: Voxels, measures: ObjectMeasures, sums: NDArray[np.float64], *, from_signs: bool
) -> NDArray[np.float32]:
    """Return the features of an object."""
    values = [
        group_features(sums[None])[0],
        [float(measures.get(name, np.nan)) for name in MEASURED],  # type: ignore[arg-type]
        _shape(voxels),
        _of_trunks(voxels),
        [float(from_signs)],
    ]
    return np.concatenate([np.asarray(part, dtype=np.float64) for part in values]).astype(np.float32)


def _shape(voxels: Voxels) -> list[float]:
    xyz = voxels.xyz
    off = xyz - xyz.mean(axis=0)
    spread = off.T @ off / len(xyz)
    deviation = np.sqrt(np.maximum(np.linalg.eigvalsh(spread)[::-1], 0.0))
    plan = np.sqrt(np.maximum(np.linalg.eigvalsh(spread[:2, :2])[::-1], 0.0))
    low, high = voxels.z_low.min(), voxels.z_high.max()
    span = max(float(high - low), 1e-3)
    layer = np.floor((xyz[:, 2] - low) / _LAYER).astype(np.int64)
    layer -= layer.min()
    radius = np.hypot(*(xyz[:, :2] - np.median(xyz[:, :2], axis=0)).T)
    third = np.clip(((xyz[:, 2] - low) / span * 3).astype(np.int64), 0, 2)
    widths = [float(np.quantile(radius[third == k], 0.8)) if (third == k).any() else np.nan for k in range(3)]
    foot = xyz[:, 2] < low + _FOOT
    longest = max(float(deviation[0]), 1e-6)
    return [
        *deviation.tolist(),
        float(deviation[0] - deviation[1]) / longest,
        float(deviation[1] - deviation[2]) / longest,
        *plan.tolist(),
        span,
        len(np.unique(layer)) / float(layer.max() + 1),
        float(np.log(len(xyz))),
        float(np.log(voxels.count.sum())),
        float(np.log(len(xyz) / span)),
        float(np.median(radius)),
        float(np.quantile(radius, 0.9)),
        *widths,
        *(float((third == k).mean()) for k in range(3)),
        float(np.hypot(*np.ptp(xyz[foot, :2], axis=0))) if foot.any() else np.nan,
    ]


def _of_trunks(voxels: Voxels) -> list[float]:
    trunks = find_trunks(voxels)
    best = main_trunk(trunks)
    if best is None:
        return [np.nan] * (len(TRUNK) - 1) + [0.0]
    offset = float(np.hypot(*(voxels.xyz[:, :2].mean(axis=0) - (best.x, best.y))))
    return [best.width, best.layers, best.low, float(np.log1p(len(best.voxels))), offset, float(len(trunks))]


LONGEST, WIDEST = 5.8, 2.7
"""Length and width of an object that may be a single car or van; larger ones may be rows, metres."""

TALLEST = 2.6
"""Height above which an object is a lorry or a bus, which has no gap down to the ground, metres."""

_LOW, _HIGH = 0.8, 1.1  # heights that a gap between bumpers stays below, and that a vehicle on either side exceeds, m
_BIN = 0.1  # of the profile, metres
_LEAST = 1.2  # shortest part, metres: less is hidden of the nearer of two vehicles


def split_row(voxels: Voxels) -> NDArray[np.int32]:
    """Divide a row of vehicles at gaps that go down to the ground.

    The profile of an object is its largest height in bins of 0.1 m along a side of its box.
    """
    part = np.zeros(len(voxels.xyz), dtype=np.int32)
    base = float(np.quantile(voxels.z_low, 0.02))
    if float(np.quantile(voxels.z_high, 0.99)) - base > TALLEST:
        return part
    top = voxels.z_high - base
    waiting, n_parts = [np.arange(len(part))], 0
    while waiting:
        rows = waiting.pop()
        cut = _cut(voxels.xyz[rows, :2], top[rows])
        if cut is None:
            part[rows] = n_parts
            n_parts += 1
        else:
            waiting += [rows[cut], rows[~cut]]
    return part


def _cut(xy: NDArray[np.float64], top: NDArray[np.float64]) -> NDArray[np.bool_] | None:
    """Return which voxels lie behind the deepest gap of an object larger than a car; None without one."""
    box = vehicle_box(xy)
    turn = np.radians(box.azimuth)
    length, width = np.array([np.sin(turn), np.cos(turn)]), np.array([np.cos(turn), -np.sin(turn)])
    for axis, size, largest in ((length, box.length, LONGEST), (width, box.width, WIDEST)):
        along = (xy - box.centre) @ axis
        place = _gap(along, top) if size > largest else None
        if place is not None:
            return np.asarray(along >= place)
    return None


def _gap(along: NDArray[np.float64], top: NDArray[np.float64]) -> float | None:
    """Return the place of the deepest gap of a profile, None without one."""
    first = float(along.min())
    of_bin = ((along - first) / _BIN).astype(np.int64)
    profile = np.zeros(int(of_bin.max()) + 1)
    np.maximum.at(profile, of_bin, top)
    high = np.flatnonzero(profile > _HIGH)
    margin = round(_LEAST / _BIN)
    if not len(high):
        return None
    bins = np.arange(len(profile))
    inside = (bins > high[0]) & (bins < high[-1]) & (bins >= margin) & (bins < len(profile) - margin)
    low = np.flatnonzero(inside & (profile < _LOW))
    if not len(low):
        return None
    deepest = low[profile[low] == profile[low].min()]
    runs = np.split(deepest, np.flatnonzero(np.diff(deepest) > 1) + 1)
    run = max(runs, key=len)
    return first + (float(run[0] + run[-1] + 1) / 2) * _BIN


EITHER = ("pole", "sign")
"""Kinds that are both scored for the points of either: the post of a sign resembles a pole, and so does its back."""


class Candidate(NamedTuple):
    """Candidate object of one kind; candidates of the same voxels are alternatives."""

    part: int  # Number of the group of voxels
    voxels: NDArray[np.int64]  # Its voxels
    row: dict[str, Any]  # `ObjectMeasures`, with `class`, `kind` and the name of the scene
    features: NDArray[np.float32]  # Features for the object classifier; empty without evidence


class Evidence:
    """Evidence of the objects of one class."""

    def __init__(self, table: pd.DataFrame) -> None:
        order = np.argsort(table["object"].to_numpy(), kind="stable")
        self._object = table["object"].to_numpy()[order]
        self._centre = (table[["i", "j", "k"]].to_numpy()[order] + 0.5) * CELL
        self._sums = table[list(SUMS)].to_numpy(dtype=np.float64)[order]

    def of_parts(self, number: int, parts: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        """Return the sums of the parts of an object; a cell counts for the nearest part."""
        rows = slice(*np.searchsorted(self._object, [number, number + 1]))
        if len(parts) == 1:
            return [self._sums[rows].sum(axis=0)]
        owner = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        near = owner[cKDTree(np.concatenate(parts)).query(self._centre[rows])[1]]
        return [self._sums[rows][near == k].sum(axis=0) for k in range(len(parts))]


def _parts(voxels: Voxels, first: int, stop: int, rule: ObjectRule) -> list[NDArray[np.int64]]:
    """Return the voxels of the parts of an object: the single trees of a group, the vehicles of a row."""
    if rule.kind == "vehicle" and voxels.count[first:stop].sum() >= rule.min_points:
        vehicle = split_row(voxels.select(np.arange(first, stop)))
        return [first + np.flatnonzero(vehicle == i) for i in range(int(vehicle.max()) + 1)]
    if rule.split_spacing is None or voxels.count[first:stop].sum() < rule.min_points:
        return [np.arange(first, stop)]
    label = split_trees(voxels.select(np.arange(first, stop)), spacing=rule.split_spacing, depth=rule.split_depth)
    return [first + np.flatnonzero(label == i) for i in range(int(label.max()) + 1)]


def _fits(row: ObjectMeasures, rule: ObjectRule) -> bool:
    height, clearance, extent = row["height"], row["clearance"], row["extent"]
    if clearance > rule.max_clearance:  # False if the ground is unknown
        return False
    if rule.kind == "sign" and clearance > 0:
        height -= clearance  # own height: a panel may hang at any height
    return rule.min_height <= height <= rule.max_height and rule.min_width <= extent <= rule.max_width


def find_candidates(
    voxels: Voxels,
    number: NDArray[np.int64],
    name: str,
    classes: Mapping[str, ObjectRule],
    scenes: Sequence[str],
    evidence: Evidence | None = None,
) -> Iterator[Candidate]:
    """Measure the candidates of one class that fit the rules."""
    own = classes[name]
    kinds = EITHER if evidence is not None and own.kind in EITHER else (own.kind,)
    named = {rule.kind: (key, rule) for key, rule in reversed(list(classes.items()))} | {own.kind: (name, own)}
    starts = np.flatnonzero(np.diff(number, prepend=-1)).tolist()
    n_parts = 0
    for first, stop in zip(starts, [*starts[1:], len(number)], strict=True):
        parts = _parts(voxels, first, stop, own)
        places = [voxels.xyz[index] for index in parts]
        sums = [None] * len(parts) if evidence is None else evidence.of_parts(int(number[first]), places)
        for index, total in zip(parts, sums, strict=True):
            part = voxels.select(index)
            if part.count.sum() < own.min_points:
                continue
            n_parts += 1
            for kind in (kind for kind in kinds if kind in named):
                key, rule = named[kind]
                row = measure(part, kind)
                if _fits(row, rule):
                    features = np.zeros(0, np.float32)
                    if total is not None:
                        features = object_features(part, row, total, from_signs=own.kind == "sign")
                    if kind == "vehicle":
                        row |= complete_vehicle(row, part)
                    yield Candidate(
                        n_parts, index, {**row, "class": key, "kind": kind, "scene": scenes[row["scene"]]}, features
                    )


def measured_rows(
    voxels: Voxels,
    number: NDArray[np.int64],
    name: str,
    classes: Mapping[str, ObjectRule],
    scenes: Sequence[str],
    *,
    evidence: Evidence | None = None,
    classifier: Classifier | None = None,
) -> tuple[list[dict[str, Any]], NDArray[np.int64]]:
    """Measure the objects of one class and discard those that violate the rules."""
    found = list(find_candidates(voxels, number, name, classes, scenes, evidence))
    if evidence is not None and classifier is not None:
        found = classified(found, classifier)
    owner = np.full(len(number), -1, dtype=np.int64)
    for k, candidate in enumerate(found):
        owner[candidate.voxels] = k
    return [candidate.row for candidate in found], owner


def classified(candidates: Sequence[Candidate], classifier: Classifier) -> list[Candidate]:
    """Return the most probable candidate of each part, with its score and reasons."""
    best: dict[int, Candidate] = {}
    for kind in sorted({candidate.row["kind"] for candidate in candidates}):
        own = [candidate for candidate in candidates if candidate.row["kind"] == kind]
        features = np.stack([candidate.features for candidate in own])
        scores = classifier.probabilities(kind, features)[:, 0].round(4).tolist()
        for candidate, score, reasons in zip(own, scores, classifier.reasons(kind, features), strict=True):
            rated = candidate._replace(row={**candidate.row, "score": score, "reasons": reasons})
            if candidate.part not in best or score > best[candidate.part].row["score"]:
                best[candidate.part] = rated
    return [best[part] for part in sorted(best)]
