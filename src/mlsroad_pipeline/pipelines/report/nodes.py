"""Report of a comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mlsroad_pipeline.reporting.comparison_page import comparison_sections
from mlsroad_pipeline.reporting.html.report import build_report
from mlsroad_pipeline.surveys.parameters import SurveyParameters


def write_report(
    survey: SurveyParameters,
    *parts: Any,
    tasks: Sequence[str],
    figures: Mapping[str, Sequence[str]],
    names: Sequence[str],
) -> str:
    """Write the scores and figures of all methods on one page."""
    values = dict(zip(names, parts, strict=True))
    methods = {slug: {name: values[f"{slug}.{name}_figure"] for name in mine} for slug, mine in figures.items()}
    scores = {slug: values[f"{slug}.scores"] for slug in figures}
    facts = {"survey": survey.root, "splits": dict(survey.splits), "classes": survey.evaluation_scheme or survey.scheme}
    tables = {name: table for name, table in values.items() if "." not in name}
    return build_report(comparison_sections(facts, tables, scores, methods, tasks=tasks), title="Comparison of methods")
