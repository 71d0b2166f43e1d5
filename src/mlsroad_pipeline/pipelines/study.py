"""Pipeline that all studies share: plan, stages of scene tasks, tables, figures and a report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from kedro.pipeline import Node, Pipeline
from matplotlib.figure import Figure

from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.papers.shared.studies.tables import Tables
from mlsroad_pipeline.reporting.html.report import Section, build_report


class Stage(NamedTuple):
    """Node that creates scene tasks from the plan and earlier stages."""

    name: str  # name of the node
    tasks: Callable[..., Mapping[str, SceneTask]]  # takes the plan and the inputs, and returns a task per key
    inputs: Sequence[str]  # scene stores; a name with a dot is one of the catalog, others are the study's
    output: str  # scene store of the study


@dataclass(frozen=True)
class StudyReport:
    """Tables, figures and page of a study."""

    title: str  # title of the page
    tables: type[Tables]  # class of the tables; its fields are their names in the catalog
    tabulate: Callable[..., Tables]  # takes the plan and the stores of `results`, and returns the tables
    results: Sequence[str]  # scene stores that the tables are made from
    captions: Mapping[str, str]  # name of each figure to its caption; its catalog entry ends in ``_figure``
    draw: Callable[..., Sequence[Figure]]  # takes the tables and the entries of `shown`, and returns the figures
    # takes the plan, the tables and the figures, and returns the sections of the page
    write: Callable[[Any, Any, Sequence[Figure]], list[Section]]
    shown: Sequence[str] = ()  # the plan and scene stores, where figures need more than the tables


def study_pipeline(
    paper: str,
    *,
    parameters: Sequence[str],
    plan: Callable[..., Any],
    stages: Sequence[Stage],
    report: StudyReport,
) -> Pipeline:
    """Return the pipeline of a study; its plan is made from the study's own parameters and further groups."""
    study = f"{paper}_study"
    n_tables = len(report.tables.names())

    def entries(*names: str) -> list[str]:
        return [name if "." in name else f"{study}.{name}" for name in names]

    def tabulate_study(plan: Any, *stores: Any) -> tuple[Any, ...]:
        return report.tabulate(plan, *stores).as_tuple()

    def report_study(plan: Any, *loaded: Any) -> tuple[Figure | str, ...]:
        tables = report.tables(*loaded[:n_tables])
        figures = tuple(report.draw(tables, *loaded[n_tables:]))
        return *figures, build_report(report.write(plan, tables, figures), title=report.title)

    groups = [f"params:{group}" for group in (study, *parameters)]
    figures = entries(*(f"{name}_figure" for name in report.captions), "report")
    tables = entries(*report.tables.names())
    return Pipeline(
        [
            Node(plan, groups, f"{study}.plan", name=f"plan_{study}"),
            *(Node(s.tasks, entries("plan", *s.inputs), *entries(s.output), name=s.name) for s in stages),
            Node(tabulate_study, entries("plan", *report.results), tables, name=f"tabulate_{study}"),
            Node(report_study, [*entries("plan"), *tables, *entries(*report.shown)], figures, name=f"report_{study}"),
        ]
    )
