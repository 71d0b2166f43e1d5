"""Protocol of a check: who decided what and when, what is left, and estimates of precision and recall."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_table
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.reporting.html.report import build_report, facts_section, table_section
from mlsroad_pipeline.review.corrections.checked_states import counts_of_checks
from mlsroad_pipeline.review.corrections.decisions import Decision
from mlsroad_pipeline.review.corrections.line_decisions import line_states
from mlsroad_pipeline.review.corrections.states import ObjectState, States
from mlsroad_pipeline.review.delivery.corrected_objects import KindsOf, kind_of, new_rows

FEWEST = 5
"""Fewest decided objects of a stratum."""

_NORMAL = 1.959963984540054  # quantile of the normal distribution for 95 %


class Estimate(NamedTuple):
    """A share with its interval of 95 %."""

    share: float
    low: float
    high: float

    def __str__(self) -> str:
        """Return the share and its interval, a dash without one."""
        if np.isnan(self.share):
            return "–"
        return f"{self.share:.2f} ({self.low:.2f} to {self.high:.2f})"


UNKNOWN = Estimate(np.nan, np.nan, np.nan)


def wilson(share: float, size: float) -> Estimate:
    """Return a share of a sample with the interval of Wilson (1927); a sample without end has no uncertainty.

    Examples
    --------
    >>> print(wilson(0.8, 10))
    0.80 (0.49 to 0.94)
    """
    if not size > 0:
        return UNKNOWN
    square = _NORMAL**2 / size
    middle = (share + square / 2) / (1 + square)
    half = np.sqrt(square * (share * (1 - share) + square / 4)) / (1 + square)
    return Estimate(share, float(max(0.0, middle - half)), float(min(1.0, middle + half)))


class Strata(NamedTuple):
    """Strata of the objects of a kind by score: number of objects, of decided ones, and of right ones among these."""

    size: NDArray[np.int64]
    decided: NDArray[np.int64]
    right: NDArray[np.int64]

    @property
    def shares(self) -> NDArray[np.float64]:
        """Share of right objects among the decided ones of each stratum."""
        share: NDArray[np.float64] = self.right / self.decided
        return share

    @property
    def precision(self) -> Estimate:
        """Precision of all objects: each stratum has the share of its decided ones."""
        if not len(self.size):
            return UNKNOWN
        weight = self.size / self.size.sum()
        share = float(weight @ self.shares)
        # A stratum of right objects alone is not certain: two more answers, one right and one wrong, give its variance.
        careful = (self.right + 1) / (self.decided + 2)
        left = 1 - self.decided / self.size
        variance = float((weight**2 * careful * (1 - careful) / self.decided * left).sum())
        if variance == 0:  # all were looked at
            return Estimate(share, share, share)
        middle = (share * self.decided.sum() + 1) / (self.decided.sum() + 2)
        return wilson(share, middle * (1 - middle) / variance)


def strata_of(score: NDArray[np.float64], decided: NDArray[np.bool_], right: NDArray[np.bool_]) -> Strata:
    """Return strata of ascending score with at least `FEWEST` decided objects each; none without decisions.

    Decisions begin with uncertain objects, so that all decided ones together would not be a sample of the listed ones.
    """
    order = np.argsort(score, kind="stable")
    done = np.cumsum(decided[order])
    if not len(done) or not done[-1]:
        return Strata(*(np.zeros(0, np.int64) for _ in range(3)))
    n_strata = max(1, int(done[-1]) // FEWEST)
    stratum = np.minimum(np.maximum(done - 1, 0) * n_strata // int(done[-1]), n_strata - 1)
    chosen = decided[order]
    counts = (
        np.bincount(stratum[rows], minlength=n_strata)
        for rows in (np.ones(len(order), bool), chosen, chosen & right[order])
    )
    return Strata(*counts)


_HOW = (
    "Precision: share of right objects. The objects of a kind are divided by score into strata of at least five "
    "decided ones; objects that nobody looked at count as the decided ones of their stratum. Recall: share of the true "
    "objects that was listed; true ones are the right ones and those that users added, so that it is an upper limit "
    "where not all missing objects were added. Intervals of 95 % (Wilson 1927); – without decisions."
)


def decision_table(history: Sequence[Decision]) -> pd.DataFrame:
    """Return all decisions, also those that were taken back: one row each."""
    rows = []
    for decision in history:
        given = decision.correction
        points = len(given.payload["points"]) if given.action == "paint" else ""
        where = given.payload.get("file", "")
        row: dict[str, Any] = {"decision": decision.identifier, "made_utc": decision.made, "who": decision.who}
        row |= {
            "action": given.action,
            "object": given.object_id or "",
            "given": given.checked_class if given.action == "paint" else given.described,
        }
        rows.append(row | {"points": points, "file": where, "taken_back_utc": decision.undone})
    columns = ("decision", "made_utc", "who", "action", "object", "given", "points", "file", "taken_back_utc")
    return pd.DataFrame(rows, columns=list(columns))


def kind_table(objects: pd.DataFrame, states: States, kinds: KindsOf) -> pd.DataFrame:
    """Return for each kind the numbers of objects by decision, what is left, and estimated precision and recall."""
    listed = dict(zip(objects["object_id"].tolist(), objects["kind"].astype(str), strict=True))
    new = new_rows(objects, states, kinds=kinds)
    added = Counter(str(row["kind"]) for row in new if row["object_id"] not in listed)
    became = {number: kind_of(state, listed[number], kinds) for number, state in states.of_objects.items()}
    added.update(now for number, now in became.items() if now != listed[number] and _stays(states.of_objects[number]))
    rows = []
    for kind in [*KINDS, *sorted({*listed.values()} - {*KINDS})]:
        own = objects[objects["kind"] == kind]
        outcome = [_outcome(states.of_objects.get(n), became.get(n, kind), kind) for n in own["object_id"].tolist()]
        found = Counter(outcome)
        row = {"kind": kind, "listed": len(own), "looked at": len(own) - found["left"], "right": found["right"]}
        row |= {"wrong": found["wrong"], "other kind": found["other kind"], "added": added[kind], "left": found["left"]}
        row["delivered"] = found["right"] + found["left"] + added[kind]
        rows.append(row | _estimated(own["score"].to_numpy(np.float64), outcome, added[kind]))
    return pd.DataFrame(rows)


def _stays(state: ObjectState) -> bool:
    return state["status"] != "rejected" and "merged_into" not in state


def _outcome(state: ObjectState | None, became: str, kind: str) -> str:
    """Return what was decided about an object: right, wrong, other kind, or left where nobody looked at it."""
    if state is None or not state["status"]:
        return "left"
    if not _stays(state):
        return "wrong"
    return "right" if became == kind else "other kind"


_ESTIMATES = ("precision as labelled", "precision as delivered", "recall as labelled")


def _estimated(score: np.ndarray, outcome: Sequence[str], missing: int) -> dict[str, str]:
    """Return the precision of the list as labelled and as delivered, and its recall as labelled."""
    decided, right = (np.array([test(o) for o in outcome], bool) for test in ("left".__ne__, "right".__eq__))
    listed = strata_of(score, decided, right).precision
    if listed is UNKNOWN:
        return dict.fromkeys(_ESTIMATES, str(UNKNOWN))
    n_left, n_sure = int((~decided).sum()), int(right.sum()) + missing
    rest = [float(np.clip(bound * len(score) - right.sum(), 0, n_left)) for bound in listed]  # right ones of the rest
    delivered = Estimate(*((n + n_sure) / max(n_left + n_sure, 1) for n in rest))
    n_right = listed.share * len(score)
    recall = wilson(n_right / max(n_right + missing, 1e-9), n_right + missing)
    return dict(zip(_ESTIMATES, map(str, (listed, delivered, recall)), strict=True))


def lines_by_kind(lines: pd.DataFrame | None, states: States) -> pd.DataFrame:
    """Return for each kind the lines and metres that are listed, the decisions by their present kind, and the rest."""
    rows = []
    listed = line_table([]) if lines is None else lines
    found = line_states(states.lines, listed)
    present = found.apply(listed)
    present["status"] = [found.status.get(number, "") for number in present["line_id"].tolist()]
    for kind in sorted({*listed["kind"], *present["kind"]}):
        own, now = listed[listed["kind"] == kind], present[present["kind"] == kind]
        status = Counter(now["status"])
        row = {"kind": kind, "listed": len(own), "length, m": round(float(own["length"].sum()), 1)}
        row |= {"right": status["accepted"], "wrong": status["rejected"], "other kind": status["changed"]}
        row |= {"other vertices": sum(status[name] for name in ("moved", "cut", "joined")), "added": status["added"]}
        row |= {"left": status[""], "delivered": len(now) - status["rejected"]}
        rows.append(
            row | {"length delivered, m": round(float(now.loc[now["status"] != "rejected", "length"].sum()), 1)}
        )
    return pd.DataFrame(rows)


def protocol_page(
    facts: dict[str, Any],
    history: Sequence[Decision],
    kinds: pd.DataFrame,
    lines: pd.DataFrame,
    checked: Mapping[str, pd.DataFrame],
) -> str:
    """Return the protocol as one HTML page; tables of `kind_table`, `lines_by_kind` and `checked_tables`."""
    decisions = decision_table(history)
    valid = decisions[decisions["taken_back_utc"] == ""]
    made = valid["made_utc"]
    when = f"{made.min()[:16]} to {made.max()[:16]}".replace("T", " ") if len(made) else "no decisions"
    facts = {**facts, "decisions in force": len(valid), "taken back": len(decisions) - len(valid), "made (UTC)": when}
    by_user = valid.groupby(["who", "action"], sort=True).size().unstack(fill_value=0).reset_index()
    sections = [
        facts_section("Survey", facts),
        table_section("Objects by kind", kinds, _HOW),
        table_section("Lines by kind", lines),
        *(table_section(f"States of {name}", counts_of_checks(table)) for name, table in checked.items()),
        table_section("Decisions by user", by_user.rename_axis(columns=None)),
        table_section("Decisions", decisions, "Times are UTC. The table beside this page has all of them."),
    ]
    return build_report(sections, title="Protocol of the check", subtitle=str(facts["survey"]))
