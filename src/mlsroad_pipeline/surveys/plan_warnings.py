"""Warnings on a planned survey, from what its ingest has computed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.quality.report import QualityReport
from mlsroad_pipeline.surveys.plan import SurveyPlan, trajectory_beside
from mlsroad_pipeline.surveys.reading import FileFacts
from mlsroad_pipeline.surveys.survey_warnings import SurveyFacts, gather, survey_warnings

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
    beside = {drive: trajectory_beside(files) is not None for drive, files in plan.drives().items()}
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
        state = "beside" if beside[file.drive] else "none" if trajectory else "off"
        note = notes.get(file.drive, "") if file.number == 0 and beside[file.drive] else ""
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
