"""Matching of objects with a reference: precision, recall, F, curves by score, calibration, errors of measures."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.geometry.assignment import assign_one_to_one
from mlsroad_pipeline.algorithms.metrics.calibration import reliability_table
from mlsroad_pipeline.algorithms.metrics.detection import DetectionCounts

REACH = {"pole": 0.5, "sign": 0.5, "tree": 1.0, "vehicle": 1.0}
"""Kind to the largest distance of a pair in plan, metres: base of a pole or tree, centre of a sign or vehicle."""
OTHER_REACH = 1.0
"""Largest distance for kinds that `REACH` does not list, metres."""
RIGHT, FALSE, IGNORED = "right", "false", "ignored"
FOUND, MISSED = "found", "missed"


@dataclass(frozen=True)
class MatchedObjects:
    """Outcome of every listed and of every true object."""

    # The listed objects with `outcome` (``right``, ``false``, ``ignored``), `true_row` (row of the true object, -1
    # without one), `distance` (in plan, metres; NaN without one) and `true_kind` (of a false object: the kind of the
    # nearest true object of another kind that is within reach, empty without one)
    objects: pd.DataFrame
    # The true objects with `outcome` (``found``, ``missed``, ``ignored``) and `row` (of the listed object, or -1)
    truth: pd.DataFrame


def match_objects(
    objects: pd.DataFrame, truth: pd.DataFrame, *, reach: Mapping[str, float] | None = None
) -> MatchedObjects:
    """Match listed with true objects of the same kind, each at most once.

    A listed object without a true object is ignored where it is near a true object that does not count: within reach,
    and half of its length. Objects with `inside` False are ignored unless they match.
    """
    limits = {**REACH, **(reach or {})}
    where, expected = (table[["x", "y"]].to_numpy(dtype=np.float64) for table in (objects, truth))
    counted = truth["counted"].to_numpy(dtype=bool) if "counted" in truth else np.ones(len(truth), bool)
    inside = objects["inside"].to_numpy(dtype=bool) if "inside" in objects else np.ones(len(objects), bool)
    listed = np.where(inside, FALSE, IGNORED).astype(object)
    wanted = np.where(counted, MISSED, IGNORED).astype(object)
    true_row, row = np.full(len(objects), -1), np.full(len(truth), -1)
    for kind in sorted(set(objects["kind"]) & set(truth["kind"])):
        limit = limits.get(kind, OTHER_REACH)
        mine = np.flatnonzero(objects["kind"] == kind)
        own = np.flatnonzero((truth["kind"] == kind) & counted)
        a, b = assign_one_to_one(where[mine], expected[own], limit)
        true_row[mine[a]], row[own[b]] = own[b], mine[a]
        listed[mine[a]], wanted[own[b]] = RIGHT, FOUND
        spare = truth[(truth["kind"] == kind) & ~counted]
        free = mine[listed[mine] == FALSE]
        listed[free[_beside(where[free], spare, limit)]] = IGNORED
    gap = np.where(true_row >= 0, np.hypot(*(where - expected[true_row]).T) if len(truth) else 0.0, np.nan)
    outcome = {"outcome": listed, "true_row": true_row, "distance": gap}
    found = objects.assign(**outcome, true_kind=_kinds_there(objects["kind"], where, listed, truth, limits))
    return MatchedObjects(found, truth.assign(outcome=wanted, row=row))


def _beside(where: NDArray[np.float64], spare: pd.DataFrame, limit: float) -> NDArray[np.bool_]:
    """Return which places are near one of some objects."""
    if spare.empty or not len(where):
        return np.zeros(len(where), bool)
    length = spare["length"].fillna(0.0).to_numpy(dtype=np.float64) if "length" in spare else np.zeros(len(spare))
    gap = np.hypot(*(where[:, None] - spare[["x", "y"]].to_numpy(dtype=np.float64)).transpose(2, 0, 1))
    near: NDArray[np.bool_] = (gap <= limit + length / 2).any(axis=1)
    return near


def _kinds_there(
    kinds: pd.Series, where: NDArray[np.float64], outcome: NDArray, truth: pd.DataFrame, limits: Mapping[str, float]
) -> NDArray[np.object_]:
    """Return the kind of the nearest true object of another kind within reach of each false object."""
    named = np.full(len(where), "", dtype=object)
    for kind, others in truth.groupby("kind", sort=True):
        tree = cKDTree(others[["x", "y"]].to_numpy(dtype=np.float64))
        rows = np.flatnonzero((outcome == FALSE) & (kinds != kind).to_numpy() & (named == ""))
        near = tree.query(where[rows], distance_upper_bound=limits.get(str(kind), OTHER_REACH))[0]
        named[rows[np.isfinite(near)]] = kind
    return named


ALL = "all"
CURVE_POINTS = 51
"""Largest number of thresholds of a precision-recall curve."""
LEAST_LEAN = 1.0
"""Minimum true tilt for comparing the direction of lean, degrees."""

MEASURES = {
    "position": "m", "z": "m", "height": "m", "tilt": "deg", "lean_azimuth": "deg", "diameter": "m",
    "crown_diameter": "m", "panel_bottom": "m", "panel_centre": "m", "panel_height": "m", "panel_width": "m",
    "facing": "deg", "heading": "deg", "length": "m", "width": "m",
}  # fmt: skip
"""Compared measures and their units."""
_CIRCLE = {"lean_azimuth": 360.0, "facing": 360.0, "heading": 180.0}


def score_objects(matched: MatchedObjects, *, recall_only: Collection[str] = ()) -> pd.DataFrame:
    """Return the scores of an inventory by kind.

    Parameters
    ----------
    matched : MatchedObjects
        The outcomes.
    recall_only : collection of str
        Kinds whose truth is incomplete: they have no precision.

    Returns
    -------
    DataFrame
        One row per kind and, with several, one for all kinds with complete truth: `kind`, `true`, `found`, `listed`,
        `right`, `false`, `ignored`, `precision`, `recall`, `f_score`, `mean_score` (of the listed objects that are
        right or false) and `calibration_error` (expected calibration error of the score, ten bins). Undefined values
        are NaN.
    """
    kinds = sorted(set(matched.truth["kind"]) | set(matched.objects["kind"]))
    whole = [kind for kind in kinds if kind not in recall_only]
    groups = {kind: [kind] for kind in kinds} | ({ALL: whole} if len(whole) > 1 else {})
    rows = [_score_row(name, group, matched, incomplete=name in recall_only) for name, group in groups.items()]
    columns = [
        *("kind", "true", "found", "listed", "right", "false", "ignored"),
        *("precision", "recall", "f_score", "mean_score", "calibration_error"),
    ]
    return pd.DataFrame(rows, columns=columns)


def _score_row(name: str, kinds: list[str], matched: MatchedObjects, *, incomplete: bool) -> list[object]:
    listed = matched.objects[matched.objects["kind"].isin(kinds)]
    outcome, wanted = listed["outcome"], matched.truth[matched.truth["kind"].isin(kinds)]["outcome"]
    right, false, ignored = (int((outcome == value).sum()) for value in (RIGHT, FALSE, IGNORED))
    found, missed = (int((wanted == value).sum()) for value in (FOUND, MISSED))
    counts = DetectionCounts(right, false, missed)
    counted = listed[outcome != IGNORED]
    table = reliability_table(counted["score"], counted["outcome"] == RIGHT, n_bins=10)
    sizes = [found + missed, found, len(listed), right, false, ignored]
    if incomplete:
        return [name, *sizes, np.nan, counts.recall, np.nan, np.nan, np.nan]
    mean = float(counted["score"].mean()) if len(counted) else np.nan
    return [name, *sizes, counts.precision, counts.recall, counts.f_score, mean, table.calibration_error]


def precision_recall_curve(
    objects: pd.DataFrame, truth: pd.DataFrame, *, reach: Mapping[str, float] | None = None
) -> pd.DataFrame:
    """Return precision and recall of the objects whose score is at least a threshold, matched anew at each.

    Each kind has one row per distinct score, or one per quantile if there are more than `CURVE_POINTS` scores.
    """
    rows = []
    for kind in sorted(set(objects["kind"])):
        mine, own = objects[objects["kind"] == kind], truth[truth["kind"] == kind]
        for least in _thresholds(mine["score"].to_numpy(dtype=np.float64)):
            matched = match_objects(mine[mine["score"] >= least], own, reach=reach)
            outcome, wanted = matched.objects["outcome"], matched.truth["outcome"]
            counts = DetectionCounts(
                *(int(n) for n in (sum(outcome == RIGHT), sum(outcome == FALSE), sum(wanted == MISSED)))
            )
            rows.append((kind, least, len(outcome), counts.precision, counts.recall, counts.f_score))
    return pd.DataFrame(rows, columns=["kind", "least_score", "listed", "precision", "recall", "f_score"])


def _thresholds(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    values = np.unique(scores)
    if len(values) <= CURVE_POINTS:
        return values
    return np.unique(np.quantile(scores, np.linspace(0, 1, CURVE_POINTS), method="lower"))


def errors_of_measures(matched: MatchedObjects) -> pd.DataFrame:
    """Return the errors of the measures of right objects: listed minus true, NaN where one is unknown.

    `position` is the distance in plan. A vehicle's heading, a facing of unknown side and that of a panel with two
    fronts are compared modulo 180 degrees, and the direction of lean from a true tilt of `LEAST_LEAN` on.
    """
    right = matched.objects[matched.objects["outcome"] == RIGHT]
    true = matched.truth.iloc[right["true_row"].to_numpy()].set_axis(right.index)
    errors = right[[name for name in ("object_id", "kind") if name in right]].copy()
    errors["position"] = right["distance"]
    for name in list(MEASURES)[1:]:
        if name not in right or name not in true:
            errors[name] = np.nan
            continue
        gap = right[name].astype(np.float64) - true[name].astype(np.float64)
        circle: float | NDArray[np.float64] = _CIRCLE.get(name, 0.0)
        if name == "facing":
            both = true["two_sided"].fillna(False).astype(bool) if "two_sided" in true else False
            circle = np.where((right["facing_from"] == "unknown") | both, 180.0, 360.0)
        errors[name] = gap if name not in _CIRCLE else (gap + circle / 2) % circle - circle / 2
    if "tilt" in true:
        errors.loc[~(true["tilt"].astype(np.float64) >= LEAST_LEAN), "lean_azimuth"] = np.nan
    return errors


def summarise_measures(errors: pd.DataFrame) -> pd.DataFrame:
    """Summarise errors by kind and measure: bias (median), and median and 90 % quantile of the absolute errors."""
    rows = []
    for kind, group in errors.groupby("kind", sort=True):
        for name, unit in MEASURES.items():
            values = group[name].dropna().to_numpy(dtype=np.float64)
            if len(values):
                size = np.abs(values)
                rows.append((kind, name, unit, len(values), np.median(values), np.median(size), np.quantile(size, 0.9)))
    return pd.DataFrame(rows, columns=["kind", "measure", "unit", "n", "bias", "median", "quantile_90"])
