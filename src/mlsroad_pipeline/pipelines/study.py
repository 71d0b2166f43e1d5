"""What the pipelines of the studies share: tasks that make streets, tables by name, and the node of the report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pandas as pd
from kedro.pipeline import Node
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.stages import GroundParameters
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.reporting.html.report import Section, build_report
from mlsroad_pipeline.studies.tables import Tables
from mlsroad_pipeline.surveys.simulated import simulation_parameters


def street_tasks(
    make: Callable[..., Any], surveys: Mapping[str, Mapping[str, Any]], ground: GroundParameters
) -> dict[str, SceneTask]:
    """Name the work that simulates each street."""
    return {
        key: SceneTask(make, parameters={"simulation": simulation_parameters(survey), "ground": ground})
        for key, survey in surveys.items()
    }


def entries(study: str, names: Sequence[str]) -> list[str]:
    """Return names in the catalog."""
    return [f"{study}.{name}" for name in names]


def report_node(
    study: str,
    *,
    tables: type[Tables],
    figures: Sequence[str],
    draw: Callable[[Any], Sequence[Figure]],
    write: Callable[[Any, Any, Sequence[Figure]], list[Section]],
    title: str,
) -> Node:
    """Return the node that draws the figures of a study and writes its report."""

    def report_study(plan: Any, *given: pd.DataFrame) -> tuple[Figure | str, ...]:
        found = tables(*given)
        drawn = tuple(draw(found))
        return *drawn, build_report(write(plan, found, drawn), title=title)

    return Node(
        report_study,
        inputs=entries(study, ["plan", *tables.names()]),
        outputs=entries(study, [*figures, "report"]),
        name=f"report_{study}",
    )
