"""Sentences and facts on the offsets between files and passes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.registration.network import LEAST
from mlsroad_pipeline.algorithms.registration.offset import LARGEST_PLAN, Offset
from mlsroad_pipeline.surveys.pass_offsets import COPY, PairOffset, SurveyOffsets

MOST_LINES = 5
"""Largest number of sentences on pairs."""

LEAST_SEAM = 0.5
"""Least step of the ground between files that border on each other that is reported, metres."""


def disagrees(offset: Offset | None) -> bool:
    """Return whether an offset counts: 4 cm in plan or in height, a turn, or a step of half a metre at a border."""
    if offset is None:
        return False
    if offset.seam:
        return bool(abs(offset.shift[2]) >= LEAST_SEAM)
    return offset.heading != 0.0 or bool(_plan(offset.shift) >= LEAST or abs(np.nan_to_num(offset.shift[2])) >= LEAST)


def _plan(shift: NDArray[np.float64]) -> float:
    return float(np.hypot(*np.nan_to_num(shift[:2])))


def size_text(offset: Offset) -> str:
    """Return where the moving recording lies relative to the fixed one, such as ``0.51 m aside and 0.20 m above``."""
    away = -offset.shift
    parts = []
    if np.isfinite(away[0]):
        parts.append(f"{_plan(away):.2f} m aside ({away[0]:+.2f} m east, {away[1]:+.2f} m north)")
    if np.isfinite(away[2]):
        parts.append(f"{abs(away[2]):.2f} m {'above' if away[2] >= 0 else 'below'}")
    turn = f", turned by {abs(np.degrees(offset.heading)):.2f} degrees" if offset.heading else ""
    return " and ".join(parts) + turn


def offset_warnings(found: SurveyOffsets, *, aligned: bool = False) -> list[tuple[str, str]]:
    """Return pairs of a recording and a sentence: what disagrees, what was moved, and what is there twice."""
    names = [recording.name for recording in found.recordings]
    lines = [(names[pair.moving], _sentence(pair, names, aligned)) for pair in _worst(found)]
    shown = [line for line in lines[:MOST_LINES] if line[1]]
    if len(lines) > MOST_LINES:
        shown.append((f"{len(lines)} pairs of files or passes", f"disagree; the {MOST_LINES} largest are named"))
    if found.left_out:
        shown.append((f"{found.left_out} pairs of files or passes", "overlap little and were not compared"))
    return shown + _same_points(found, names)


def _worst(found: SurveyOffsets) -> list[PairOffset]:
    wrong = [pair for pair in found.pairs if pair.offset is not None and disagrees(pair.offset)]
    return sorted(
        wrong, key=lambda pair: -float(np.linalg.norm(np.nan_to_num(pair.offset.shift))) if pair.offset else 0
    )


def _sentence(pair: PairOffset, names: list[str], aligned: bool) -> str:
    offset = pair.offset
    if offset is None:
        return ""
    other = names[pair.fixed]
    if offset.seam:
        text = f"its ground lies {size_text(offset)} that of {other} at their border"
    else:
        text = f"lies {size_text(offset)} {other} where they overlap"
    if not aligned:
        advice = "" if offset.seam else "; objects may be wrong or listed twice"
        return f"{text}{advice}; align_passes (label.align_passes=true) moves them together"
    if pair.after is None:
        return f"{text}; after the alignment nothing measures what remains"
    rest = f"{_plan(pair.after.shift):.2f} m in plan and {abs(np.nan_to_num(pair.after.shift[2])):.2f} m in height"
    return f"{text}; aligned for the labelling, {rest} remain; the written points keep their coordinates"


def _same_points(found: SurveyOffsets, names: list[str]) -> list[tuple[str, str]]:
    lines = []
    for pair in found.pairs:
        if pair.same >= COPY:
            text = f"has the same points as {names[pair.fixed]}, a copy: objects are listed once, points labelled twice"
        elif pair.same:
            text = (
                f"{100 * pair.same:.0f} % of the points where it overlaps {names[pair.fixed]} are the same points, as"
                " in buffers of tiles: objects are listed once"
            )
        else:
            continue
        lines.append((names[pair.moving], text))
    return lines


def offset_facts(found: SurveyOffsets) -> list[dict[str, Any]]:
    """Return the offset of each pair as plain data for JSON; metres, degrees, None where nothing measures it."""
    return [_facts(pair, [recording.name for recording in found.recordings]) for pair in found.pairs]


def _facts(pair: PairOffset, names: list[str]) -> dict[str, Any]:
    offset = pair.offset
    shift, error = (np.full(3, np.nan),) * 2 if offset is None else (-offset.shift, offset.error)
    return {
        "file": names[pair.moving],
        "other": names[pair.fixed],
        **dict(zip(("east", "north", "up"), _plain(shift), strict=True)),
        "standard_errors": _plain(error),
        "degrees": None if offset is None else round(-float(np.degrees(offset.heading)), 4),
        "surfaces": 0 if offset is None else offset.n_surfaces,
        "at_border": offset is not None and offset.seam,
        "same_points": round(pair.same, 3),
        "largest_searched": LARGEST_PLAN,
    }


def _plain(values: NDArray[np.float64]) -> list[float | None]:
    return [round(float(value), 4) if np.isfinite(value) else None for value in values]
