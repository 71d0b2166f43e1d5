"""Warnings on a survey, the same for `inspect` and `label`: one line per cause."""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.quality.density import count_places
from mlsroad_pipeline.algorithms.quality.report import QualityReport
from mlsroad_pipeline.formats.crs import SAME_UNIT, crs_label, crs_units, is_geographic, is_same_crs, place_outside
from mlsroad_pipeline.surveys.plan import SurveyPlan, trajectory_beside
from mlsroad_pipeline.surveys.reading import FileFacts

BYTE = 255.5 / 65535
"""Bound of the intensities of a LAS file that uses 8 of its 16 bits, after scaling to [0, 1]."""

BOUNDS_TOLERANCE = 0.01
"""Largest difference in metres between stated bounds and the points that is not reported."""

LOCAL = 1e5
"""Largest coordinate in metres that may be of a local system although the file states another."""

FAR = 1e8
"""Largest coordinate of a map system, metres: eastings with a number of the zone before them reach 6.1e7."""

LONG = 1e5
"""Extent in metres above which coordinates are probably wrong."""

AS_POINTS = (
    "is named as a trajectory and read as points; if it is a trajectory, set trajectory (label.trajectory) to its name"
)
"""Warning on a file that is named as a trajectory beside other files."""

NO_TRAJECTORY = "no trajectory: scenes follow the times of the points where possible, else the main axis"


@dataclass(frozen=True)
class SurveyFacts:
    """Facts of a file that warnings are made of."""

    quality: QualityReport  # Quality of the points; its `source` is the name of the file
    crs: str | None  # Coordinate reference system as WKT
    form: str  # Name of the format
    trajectory: str = "none"  # ``"none"``, ``"beside"`` the points, or ``"off"`` if the user wants none
    constant: tuple[str, ...] = ()  # Columns with a single value
    whole_numbers: bool = False  # Whether a sample of the coordinates has whole numbers only
    in_metres: bool = True  # Whether the coordinates of the file are taken for metres
    stated_crs: str | None = None  # System that the file states, if the options of the reader replace it by another
    columns: tuple[str, ...] = ()  # Columns of the file; the standard ones if empty
    notes: tuple[str, ...] = ()  # Further sentences, such as on the trajectory
    bounds: NDArray[np.float64] | None = None  # Bounds that the header states, metres; None or NaN without them

    @property
    def name(self) -> str:
        """Name of the file below the root of the survey."""
        return self.quality.source


def file_warnings(facts: SurveyFacts) -> list[str]:
    """Return one sentence per problem of a file."""
    prefix = f"{facts.name}: "
    skipped = "label codes outside the taxonomy"  # of files with labels; training checks the codes itself
    of_quality = [text.removeprefix(prefix) for text in facts.quality.warnings() if skipped not in text]
    return [
        *_crs_warnings(facts),
        *([NO_TRAJECTORY] if facts.trajectory == "none" else []),
        *of_quality,
        *_value_warnings(facts),
        *facts.notes,
        *_bounds(facts),
    ]


def _bounds(facts: SurveyFacts) -> list[str]:
    real = np.array([facts.quality.low, facts.quality.high])
    if facts.bounds is None or np.isnan(facts.bounds).all() or not np.isfinite(real).all():
        return []
    with np.errstate(invalid="ignore", over="ignore"):
        if (np.abs(facts.bounds - real) <= BOUNDS_TOLERANCE).all():
            return []
    texts = [
        " to ".join(str([float(f"{v:.12g}") for v in row]) for row in box.tolist()) for box in (facts.bounds, real)
    ]
    return [f"its header states the bounds {texts[0]}, its points have {texts[1]}: the points are used"]


def _crs_warnings(facts: SurveyFacts) -> list[str]:
    found = []
    if facts.crs is None:
        found.append("no coordinate reference system: results have no position on a map; set crs (label.crs, --crs)")
    if facts.stated_crs is not None:
        found.append(
            f"the option crs replaces the coordinate reference system {crs_label(facts.stated_crs)} of the file by "
            f"{crs_label(facts.crs)}; coordinates are not transformed"
        )
    units = None if facts.crs is None else crs_units(facts.crs)
    if facts.in_metres and units is not None and units.kind == "projected":
        other = next((u for u in (units.flat, units.height) if u is not None and abs(u[1] - 1.0) > SAME_UNIT), None)
        if other is not None:
            found.append(
                f"its coordinate reference system has the unit {other[0]}, but coordinates are read as metres; "
                "set units"
            )
    found += _place_warnings(facts)
    far = np.abs([facts.quality.low, facts.quality.high])[:, :2].max()
    if facts.crs is None and FAR < far < np.inf:
        found.append(f"its coordinates reach {far:.3g} m, farther than those of any map system: check export and units")
    if facts.in_metres and facts.whole_numbers:
        found.append("coordinates are whole numbers: perhaps millimetres or centimetres; set units")
    return found


def _place_warnings(facts: SurveyFacts) -> list[str]:
    """Return a warning for points outside the area of their system; local coordinates have none."""
    middle = (np.array(facts.quality.low) + np.array(facts.quality.high))[:2] / 2
    units = None if facts.crs is None else crs_units(facts.crs)
    metres = units is not None and units.flat is not None and abs(units.flat[1] - 1.0) <= SAME_UNIT
    if facts.crs is None or not metres or not np.isfinite(middle).all() or np.abs(middle).max() <= LOCAL:
        return []
    place = place_outside(facts.crs, float(middle[0]), float(middle[1]))
    if place is None:
        return []
    return [
        f"its points lie outside the area of {crs_label(facts.crs)}, at {place}: a wrong system, or x and y exchanged"
        " (read.columns)"
    ]


def _value_warnings(facts: SurveyFacts) -> list[str]:
    quality, found = facts.quality, []
    low, high = np.array(quality.low), np.array(quality.high)
    extent = high - low
    if np.isfinite(extent).all():
        if is_geographic(facts.crs) or looks_like_degrees(low, high):
            found.append("coordinates look like degrees, not metres; set reproject")
        if extent.max() > LONG:
            found.append(
                f"the points extend over {extent.max() / 1000:,.6g} km: stray points, or units other than metres"
            )
    found += [f"column {name} has a single value and carries no information" for name in facts.constant]
    if facts.form == "LAS" and "intensity" not in facts.constant and 0 < quality.intensity_max <= BYTE:
        found.append("intensity has 8 bits in a field of 16: all values are below 0.004; set intensity_scale to 255")
    return found


def looks_like_degrees(low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
    """Return whether points have a small extent in plan, as degrees have (0.1 are 10 km), and metres in height."""
    inside = (np.abs([low[:2], high[:2]]) <= [[180, 90], [180, 90]]).all()
    extent = high - low
    return bool(inside and 0 < extent[:2].max() < 0.1 and extent[2] > 1)


def survey_warnings(
    files: Sequence[SurveyFacts], skipped: Mapping[str, str], more: Mapping[str, Sequence[str]] | None = None
) -> list[tuple[str, str]]:
    """Return the warnings on a survey, one per cause, as pairs of the files and a sentence."""
    more = more or {}
    rows = [(name, reason) for name, reason in skipped.items()]
    named = [facts.name for facts in files if "trajectory" in PurePosixPath(facts.name).stem.lower()]
    rows += [(name, AS_POINTS) for name in named if len(named) < len(files)]
    rows += [(facts.name, text) for facts in files for text in (*file_warnings(facts), *more.get(facts.name, ()))]
    gathered = gather(rows, len(files) + len(skipped))
    systems: dict[str | None, str] = {}
    for facts in files:
        if not any(facts.crs == crs or (facts.crs and crs and is_same_crs(facts.crs, crs)) for crs in systems):
            systems[facts.crs] = facts.name
    if len(systems) > 1:
        examples = "; ".join(f"{name}: {crs_label(crs)}" for crs, name in systems.items())
        advice = "crs (label.crs) if it is one system" if None in systems else "reproject (label.read.reproject)"
        gathered.append(
            (files[0].name, f"files have different coordinate reference systems ({examples}); set {advice}")
        )
    n_files = Counter(name for facts in files for name in facts.columns or facts.quality.present)
    partial = sorted(name for name, count in n_files.items() if count < len(files))
    if partial:
        gathered.append((files[0].name, f"only some of the files have {', '.join(partial)}"))
    return gathered + _far_files(files)


def _far_files(files: Sequence[SurveyFacts]) -> list[tuple[str, str]]:
    """Return a warning for each folder whose files lie in separate places; they are cut together."""
    folders: dict[str, list[SurveyFacts]] = {}
    for facts in files:
        folders.setdefault(PurePosixPath(facts.name).parent.as_posix(), []).append(facts)
    found = []
    for folder, members in folders.items():
        boxes = np.array([[facts.quality.low[:2], facts.quality.high[:2]] for facts in members])
        boxes = boxes[np.isfinite(boxes).all(axis=(1, 2)) & ((boxes[:, 1] - boxes[:, 0]).max(axis=1) <= LONG)]
        filled = [
            np.stack(np.meshgrid(*(np.append(np.arange(a, b, 250.0), b) for a, b in box.T)), axis=-1).reshape(-1, 2)
            for box in boxes
        ]
        n_places = count_places(np.concatenate(filled)) if len(boxes) > 1 else 1
        if n_places > 1:
            name = members[0].name if folder == "." else f"{folder}/"
            found.append((name, f"{len(members)} files of the folder lie in {n_places} places more than 500 m apart"))
    return found


def gather(rows: Sequence[tuple[str, str]], n_files: int) -> list[tuple[str, str]]:
    """Return pairs of a file and a sentence, with sentences that differ at most in their numbers merged into the first.

    Examples
    --------
    >>> gather([("a.laz", "3 gaps"), ("b.laz", "2 gaps"), ("b.laz", "no colour")], 2)
    [('2 of 2 files, the first a.laz', '3 gaps'), ('b.laz', 'no colour')]
    """
    causes: dict[str, list[tuple[str, str]]] = {}
    for name, text in rows:
        causes.setdefault(re.sub(r"[\d.,]+", "#", text), []).append((name, text))
    return [
        (found[0][0] if len(found) == 1 else f"{len(found)} of {n_files} files, the first {found[0][0]}", found[0][1])
        for found in causes.values()
    ]


MissingOf = Callable[[Sequence[str]], Sequence[str]]
"""Function from the columns of a file to those that a model was trained with and the file lacks."""


def constant_warnings(plan: SurveyPlan, info: Mapping[str, FileFacts]) -> list[tuple[str, str]]:
    """Return a warning per column with a single value, for a comparison; `label` has them among the others."""
    if not plan.labels:
        return []
    rows = [(f.source.name, name) for f in plan.files for name in info[f.key]["constant"].tolist()]
    constant = [(file, f"column {name} has a single value and is not used") for file, name in rows]
    return gather(constant, len(plan.files))


def plan_warnings(
    plan: SurveyPlan,
    quality: pd.DataFrame,
    info: Mapping[str, FileFacts],
    notes: Mapping[str, str],
    *,
    trajectory: bool,
    missing_of: MissingOf,
) -> list[str]:
    """Return the warnings on a survey to label, one per cause."""
    rows: list[dict[str, Any]] = [{str(key): value for key, value in row.items()} for row in quality.to_dict("records")]
    reports = {str(row["source"]): QualityReport.from_row(row) for row in rows}
    beside = {pass_key: trajectory_beside(files) is not None for pass_key, files in plan.passes().items()}
    facts, lacking = [], {}
    for file in plan.files:
        name, described = file.source.name, info[file.key]
        absent = missing_of(reports[name].present)
        if absent:
            lacking[name] = [
                f"has no {' and no '.join(absent)}, which the model was trained with: accuracy may be lower"
            ]
        reported = {*absent, *described["constant"].tolist()}
        report = replace(reports[name], missing=tuple(c for c in reports[name].missing if c not in reported))
        state = "beside" if beside[file.pass_key] else "none" if trajectory else "off"
        note = notes.get(file.pass_key, "") if file.number == 0 and beside[file.pass_key] else ""
        facts.append(_survey_facts(report, described, state, note, in_metres=bool((plan.options.factors == 1.0).all())))
    return [f"{name}: {text}" for name, text in survey_warnings(facts, plan.skipped, lacking)]


def _survey_facts(
    report: QualityReport, described: FileFacts, trajectory: str, note: str, *, in_metres: bool
) -> SurveyFacts:
    return SurveyFacts(
        report,
        _text(described["crs"]) or None,
        _text(described["form"]),
        trajectory=trajectory,
        constant=tuple(described["constant"].tolist()),
        whole_numbers=bool(described["whole_numbers"][0]),
        in_metres=in_metres,
        stated_crs=_text(described["stated_crs"]) or None,
        notes=(*described["notes"].tolist(), *([note] if note else [])),
        bounds=described["bounds"],
    )


def _text(value: NDArray) -> str:
    return str(value[0])
