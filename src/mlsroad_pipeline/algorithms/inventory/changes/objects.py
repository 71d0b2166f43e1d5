"""Objects of two surveys: unchanged, changed, moved, new, gone, or not visible in one of them."""

from collections.abc import Hashable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.register.states import (
    EMPTY,
    MOVED_REACH,
    REACH,
    Allowed,
    Evidence,
    assigned,
    height_ratio,
    other_kind,
    same_kind,
)

UNCHANGED, CHANGED, MOVED, OTHER_KIND, NEW, GONE = "unchanged", "changed", "moved", "different kind", "new", "gone"
UNSEEN_FIRST, UNSEEN_SECOND = "not visible in the first", "not visible in the second"
STATES = (UNCHANGED, CHANGED, MOVED, OTHER_KIND, NEW, GONE, UNSEEN_FIRST, UNSEEN_SECOND)
"""States of objects."""
BY_BOTH, BY_POINTS, BY_RAYS = "objects", "points", "rays"
"""Evidence of a state: an object in each survey, points in the other survey, rays of its scanner."""

SAME_HEIGHT = (0.9, 0.75)
"""Least ratios of the heights of an object that moved; the first pairs are those of the first."""
STANDS, IS_GONE = 0.6, 0.5
"""Share of the volume of an object that has points in the other survey: from `STANDS` on it stands there, above
`IS_GONE` it is not gone."""
BARE, BESIDE, MANY_RAYS = 0.15, 0.3, 300
"""Largest such share of an object that is gone although points of its kind, or of other upright kinds, are at its
place, and the fewest rays through the place that prove it."""
FEWEST_CROSSING = 10
"""Fewest rays through a panel that prove that it is not there: a plate seen along its plane has no points."""
LEAST_CHANGE = {"tilt": 0.6, "height": 0.5, "panel_bottom": 0.5}
"""Smallest change of a measure: tilt in degrees, others in metres."""
LEAST_SHARE = {"height": 0.05}
"""Smallest change of a measure as a share of it."""
LEAST_TURN, LEAST_AGREED, LEAST_GROWTH, PANEL_STAYS = 0.6, 0.4, 0.25, 0.7
"""Least turn of an axis that points show (degrees; share of the listed turn), least growth of a crown (metres), and the
share of the points between two lower edges of a panel from which both surveys have it."""
MEASURED = {"tilt": ("pole",), "height": ("tree",), "panel_bottom": ("sign",)}
"""Measures to the kinds whose changes are reported."""
LEAST_POLE, ALIKE, SAME_BASE = 3.0, 0.15, 0.4
"""Height from which the tilt of a pole is compared, metres, and the largest relative difference of its heights and
distance of its bases: otherwise its axis was measured on another part."""


class Unmatched(NamedTuple):
    """Evidence about objects of one survey at their places in the other one."""

    rows: NDArray[np.int64]  # Their rows
    evidence: Evidence
    standing: NDArray[np.float64]  # Share of the volume of each that has points in the other survey; NaN: no own points
    rays: NDArray[np.int64]  # Rays of the other survey through each place
    crossing: NDArray[np.float64]  # Rays through the panel of a sign; NaN: of another kind, or no own points

    @property
    def is_empty(self) -> NDArray[np.bool_]:
        """Objects that do not stand in the other survey."""
        most = np.where(self.evidence.own, BARE, np.where(self.evidence.other, BESIDE, IS_GONE))
        empty = (self.evidence.empty_share >= EMPTY) & ~(self.standing > IS_GONE)
        empty |= (self.rays >= MANY_RAYS) & (self.standing <= most)
        return empty & ~(self.crossing < FEWEST_CROSSING)

    @property
    def stands(self) -> NDArray[np.bool_]:
        """Objects that stand in the other survey; of those without own points, points of upright classes decide."""
        return (self.standing >= STANDS) | (np.isnan(self.standing) & (self.evidence.own | self.evidence.other))


class MeasuredByPoints(NamedTuple):
    """Changes of the measures of pairs by their points in both surveys; NaN where these do not give them."""

    turn: NDArray[np.float64]  # Angle between the axes of poles, degrees
    growth: NDArray[np.float64]  # Change of the height of trees, metres
    panel: NDArray[np.float64]  # Share of the points between the lower edges of a panel that both surveys have

    @classmethod
    def unknown(cls, n: int) -> "MeasuredByPoints":
        """Return measures of `n` pairs that nothing is known of."""
        return cls(*np.full((3, n), np.nan))


class Pairs(NamedTuple):
    """Rows of the same object in both surveys, and which objects have none."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    left_first: NDArray[np.int64]
    left_second: NDArray[np.int64]

    def doubtful(self, first: pd.DataFrame, second: pd.DataFrame) -> "Pairs":
        """Return the objects that need evidence as those without a pair: also those of pairs that lie apart."""
        ends = [t[["x", "y"]].to_numpy(np.float64)[rows] for t, rows in ((first, self.first), (second, self.second))]
        return self._without(np.hypot(*(ends[1] - ends[0]).T) > SAME_BASE)

    def proved(self, of_first: Unmatched, of_second: Unmatched) -> "Pairs":
        """Return the pairs but for those of which neither survey has the object of the other one."""
        gone = np.isin(self.first, of_first.rows[of_first.is_empty])
        return self._without(gone & np.isin(self.second, of_second.rows[of_second.is_empty]))

    def _without(self, apart: NDArray[np.bool_]) -> "Pairs":
        kept = self.first[~apart], self.second[~apart]
        left = zip((self.left_first, self.left_second), (self.first[apart], self.second[apart]), strict=True)
        return Pairs(*kept, *(np.sort(np.concatenate(own)) for own in left))


def pair_objects(first: pd.DataFrame, second: pd.DataFrame) -> Pairs:
    """Match objects of one kind within `REACH` in plan, one to one."""
    rows = assigned(first, second, max(REACH.values()), same_kind)
    left = (np.setdiff1d(np.arange(len(table)), own) for table, own in zip((first, second), rows, strict=True))
    return Pairs(*rows, *left)


def changed_objects(
    first: pd.DataFrame,
    second: pd.DataFrame,
    pairs: Pairs,
    of_first: Unmatched,
    of_second: Unmatched,
    measured: MeasuredByPoints,
) -> pd.DataFrame:
    """Return one row for each object of two surveys with its state.

    Parameters
    ----------
    first, second : DataFrame
        Poles, signs and trees of the earlier and the later survey: columns of `OBJECT_FIELDS`, one reference system.
    pairs : Pairs
        The same objects.
    of_first, of_second : Unmatched
        The other objects of each survey, with the evidence of the other survey about their places. Those that are not
        in it are not visible there.
    measured : MeasuredByPoints
        Changes of the pairs by their points, which confirm those of the listed measures.

    Returns
    -------
    DataFrame
        `state`, `evidence`, `reason` and `changes` (texts), `first_id` and `second_id` (0: none), `kind`, `x`, `y`, `z`
        (of the later survey where it has the object), `dx`, `dy`, `distance`, `empty_share`, `standing_share`, `rays`,
        and `first_NAME`, `second_NAME` and `NAME_change` of the measures.
    """
    state = {name: np.full(len(table), "", dtype=object) for name, table in (("first", first), ("second", second))}
    rows = _rows_of(pairs)
    for name, left, found, gone, unseen in (
        ("first", pairs.left_first, of_first, GONE, UNSEEN_SECOND),
        ("second", pairs.left_second, of_second, NEW, UNSEEN_FIRST),
    ):
        state[name][left] = unseen
        state[name][found.rows[found.is_empty]] = gone
        state[name][found.rows[found.stands]] = UNCHANGED
    state["first"][pairs.first] = state["second"][pairs.second] = ""
    rows += _further_rows(first, second, state)
    for name, own in state.items():
        for row in np.flatnonzero(own != "").tolist():
            text = str(own[row])
            ends = (row, -1) if name == "first" else (-1, row)
            rows.append((*ends, text, BY_POINTS if text == UNCHANGED else BY_RAYS))
    table = _with_changes(_table(first, second, rows), measured)
    seen = {("first", int(row)): k for k, row in enumerate(of_first.rows)}
    seen |= {("second", int(row)): k for k, row in enumerate(of_second.rows)}
    share, rays = np.full((2, len(rows)), np.nan), np.zeros(len(rows), dtype=np.int64)
    for k, (i, j, *_) in enumerate(rows):
        for name, row, found in (("first", i, of_first), ("second", j, of_second)):
            if (at := seen.get((name, int(row)))) is not None:
                share[:, k], rays[k] = (found.evidence.empty_share[at], found.standing[at]), found.rays[at]
    table = table.assign(empty_share=share[0], standing_share=share[1], rays=rays)
    return table.assign(reason=[_reason(row) for row in table.to_dict("records")])


def _rows_of(pairs: Pairs) -> list[tuple[int, int, str, str]]:
    return [(i, j, UNCHANGED, BY_BOTH) for i, j in zip(pairs.first, pairs.second, strict=True)]


def listed_changes(first: pd.DataFrame, second: pd.DataFrame, pairs: Pairs) -> NDArray[np.bool_]:
    """Return which pairs have a measure that the inventories give differently."""
    table = _table(first, second, _rows_of(pairs))
    changes = np.zeros(len(table), dtype=np.bool_)
    for name in MEASURED:
        changes |= _is_change(table, name)
    return changes


def _reason(row: dict[Hashable, Any]) -> str:
    """Return why an object has its state."""
    state, other = row["state"], "second" if row["first_id"] else "first"
    if state == CHANGED:
        return str(row["changes"])
    if row["first_id"] and row["second_id"]:
        if row["evidence"] == BY_POINTS:
            return "listed as another kind, but both surveys have the points of both"
        kept = {UNCHANGED: "listed in both", OTHER_KIND: "listed as another kind"}
        return kept.get(state) or f"listed {row['distance']:.1f} m away, and nothing stands at the old place"
    share, rays = row["standing_share"], f"{row['rays']:,} rays of the {other} survey cross its place"
    if np.isnan(row["empty_share"]):
        return f"no ground at its place in the {other} survey"
    found = "" if np.isnan(share) else f"the {other} survey has points at {share:.0%} of it; "
    proof = "" if state in (UNCHANGED, NEW, GONE) else f" ({row['empty_share']:.0%} of it empty): no proof"
    return found + rays + proof


def _further_rows(
    first: pd.DataFrame, second: pd.DataFrame, state: dict[str, NDArray[np.object_]]
) -> list[tuple[int, int, str, str]]:
    """Return pairs of objects without a match, moved or of different kinds, and take their states out in place."""
    rows = []
    steps: list[tuple[float, Allowed, str]] = [
        *((MOVED_REACH, partial(_has_moved, least_ratio=ratio), MOVED) for ratio in SAME_HEIGHT),
        (min(REACH.values()), _is_other_kind, OTHER_KIND),
    ]
    for reach, allowed, kept in steps:
        own, other = np.flatnonzero(state["first"] != ""), np.flatnonzero(state["second"] != "")
        before, after = first.assign(state=state["first"]), second.assign(state=state["second"])
        i, j = assigned(before.iloc[own], after.iloc[other], reach, allowed)
        for one, two in zip(own[i].tolist(), other[j].tolist(), strict=True):
            # Both stand in both surveys: the kind is another one of the labels, not of the object.
            stand = kept == OTHER_KIND and state["first"][one] == state["second"][two] == UNCHANGED
            rows.append((one, two, *((UNCHANGED, BY_POINTS) if stand else (kept, BY_BOTH))))
        state["first"][own[i]] = state["second"][other[j]] = ""
    return rows


def _has_moved(first: pd.DataFrame, second: pd.DataFrame, *, least_ratio: float) -> pd.Series:
    """Return which pairs can be one object that moved: its old place is empty; the new one may have been hidden."""
    alike = (first["kind"] == second["kind"]) & (height_ratio(first, second) >= least_ratio)
    return alike & (first["state"] == GONE) & second["state"].isin((NEW, UNSEEN_FIRST))


def _is_other_kind(first: pd.DataFrame, second: pd.DataFrame) -> pd.Series:
    """Return which pairs are of different kinds; what is proved to be gone or new is not the other object."""
    return other_kind(first, second) & (first["state"] != GONE) & (second["state"] != NEW)


def _table(first: pd.DataFrame, second: pd.DataFrame, rows: list[tuple[int, int, str, str]]) -> pd.DataFrame:
    """Return the states with the measures of both surveys; -1 is no row."""
    i, j, state, evidence = (list(column) for column in zip(*rows, strict=True)) if rows else ([], [], [], [])
    before, after = (
        table.reindex(pd.Index(own, dtype=np.int64)).reset_index(drop=True) for table, own in ((first, i), (second, j))
    )
    either = after.where(pd.Series(j, dtype=np.int64) >= 0, before)
    table = pd.DataFrame(
        {
            "state": np.array(state, dtype=object),
            "evidence": np.array(evidence, dtype=object),
            "kind": either["kind"],
            **{axis: either[axis].astype(np.float64) for axis in "xyz"},
            **{
                f"{name}_id": own["object_id"].fillna(0).astype(np.int64)
                for name, own in (("first", before), ("second", after))
            },
        }
    )
    way = after[["x", "y"]].to_numpy(dtype=np.float64) - before[["x", "y"]].to_numpy(dtype=np.float64)
    table = table.assign(dx=way[:, 0], dy=way[:, 1], distance=np.hypot(*way.T))
    for name in MEASURED:
        own, other = before[name].astype(np.float64), after[name].astype(np.float64)
        change = _angle_between(before, after) if name == "tilt" else other - own
        table = table.assign(**{f"first_{name}": own, f"second_{name}": other, f"{name}_change": change})
    return table


def _comparable(table: pd.DataFrame) -> NDArray[np.bool_]:
    """Return which poles were measured on the same part."""
    heights = table[["first_height", "second_height"]].to_numpy()
    alike = (heights.min(axis=1) >= LEAST_POLE) & (np.ptp(heights, axis=1) <= ALIKE * heights.max(axis=1))
    return np.asarray(alike)


def _angle_between(before: pd.DataFrame, after: pd.DataFrame) -> NDArray[np.float64]:
    """Return the angle between the axes of objects, degrees; NaN where one is not measured.

    An axis that is too upright for a direction is taken to lean as the other one: the angle is at least this.
    """
    axes = []
    ways = [np.radians(table["lean_azimuth"].to_numpy(dtype=np.float64)) for table in (before, after)]
    for table, way, other in ((before, *ways), (after, *ways[::-1])):
        tilt = np.radians(table["tilt"].to_numpy(dtype=np.float64))
        to = np.where(np.isfinite(way), way, np.nan_to_num(other))
        axes.append(np.column_stack([np.sin(tilt) * np.sin(to), np.sin(tilt) * np.cos(to), np.cos(tilt)]))
    across = np.linalg.norm(np.cross(axes[0], axes[1]), axis=1)
    return np.degrees(np.arctan2(across, (axes[0] * axes[1]).sum(axis=1)))


def _is_change(table: pd.DataFrame, name: str) -> NDArray[np.bool_]:
    """Return which matched objects have another measure in both inventories."""
    change = table[f"{name}_change"].abs().to_numpy()
    size = np.fmax(table[f"first_{name}"].to_numpy(), table[f"second_{name}"].to_numpy())
    least = np.maximum(LEAST_CHANGE[name], LEAST_SHARE.get(name, 0.0) * np.nan_to_num(size))
    found = (table["kind"].isin(MEASURED[name]) & (table["state"] == UNCHANGED)).to_numpy() & (change >= least)
    if name != "height":  # another pole, or another panel on it
        found &= table["distance"].to_numpy() <= SAME_BASE
    return np.asarray(found & _comparable(table) if name == "tilt" else found)


def _confirmed(table: pd.DataFrame, measured: MeasuredByPoints) -> dict[str, NDArray[np.bool_]]:
    """Return which changes of measures the points show too; of tilts and panels, those that they do not refute."""
    turn, growth, panel = (np.append(own, np.full(len(table) - len(own), np.nan)) for own in measured)
    change = table["height_change"].to_numpy()
    grown = (np.abs(growth) >= LEAST_GROWTH) & (np.sign(change) == np.sign(growth))
    least = np.maximum(LEAST_TURN, LEAST_AGREED * np.nan_to_num(table["tilt_change"].to_numpy()))
    return {"tilt": ~(turn < least), "height": grown, "panel_bottom": ~(panel > PANEL_STAYS)}


def _with_changes(table: pd.DataFrame, measured: MeasuredByPoints) -> pd.DataFrame:
    """Return the table with the changes of measures as text; a matched object with a change is `CHANGED`."""
    texts, confirmed = np.full(len(table), "", dtype=object), _confirmed(table, measured)
    for name in MEASURED:
        change = table[f"{name}_change"].abs().to_numpy()
        for row in np.flatnonzero(_is_change(table, name) & confirmed[name]).tolist():
            ends = (float(table[f"{end}_{name}"].iloc[row]) for end in ("first", "second"))
            text = f"{name.replace('_', ' ')} " + " to ".join(f"{value:.1f}" for value in ends)
            text += f"°, axis turned by {change[row]:.1f}°" if name == "tilt" else " m"
            texts[row] = f"{texts[row]}; {text}" if texts[row] else text
    state = np.where((table["state"] == UNCHANGED) & (texts != ""), CHANGED, table["state"])
    return table.assign(state=state, changes=texts)
