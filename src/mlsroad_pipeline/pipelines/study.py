"""Pipelines of the studies of the papers."""

from importlib import import_module
from typing import Any

from kedro.pipeline import Node, Pipeline
from matplotlib.figure import Figure

from mlsroad_pipeline import papers
from mlsroad_pipeline.papers.shared.studies.study import Study
from mlsroad_pipeline.pipelines import composition


def study_pipeline(study: Study) -> Pipeline:
    """Return the pipeline of a study: parameters to a plan, scene tasks, tables, figures and a page."""
    own = f"{study.name}_study"

    def entries(*names: str) -> list[str]:
        return [name if "." in name else f"{own}.{name}" for name in names]

    def tabulate_study(plan: Any, *stores: Any) -> tuple[Any, ...]:
        made = study.tabulate(plan, *stores)
        return tuple(made[name] for name in study.tables)

    def report_study(plan: Any, *loaded: Any) -> tuple[Figure | str, ...]:
        tables = dict(zip(study.tables, loaded, strict=False))
        figures = tuple(study.draw(tables, *loaded[len(tables) :]))
        return *figures, study.report(plan, tables, figures)

    groups = {"study": f"params:{own}", **{group: f"params:{group}" for group in study.parameters}}
    figures = entries(*(f"{name}_figure" for name in study.captions), "report")
    shown = entries("plan", *study.tables, *study.shown)
    return Pipeline(
        [
            Node(study.plan, inputs=groups, outputs=f"{own}.plan", name=f"plan_{own}"),
            *(Node(s.tasks, entries("plan", *s.inputs), *entries(s.output), name=s.name) for s in study.stages),
            Node(tabulate_study, entries("plan", *study.results), entries(*study.tables), name=f"tabulate_{own}"),
            Node(report_study, shown, figures, name=f"report_{own}"),
        ]
    )


def create_pipeline(name: str) -> Pipeline:
    """Return the pipeline ``<paper>_study``, after the pipelines that make its inputs: those of entries with a dot."""
    study: Study = import_module(f"{papers.__name__}.{name.removesuffix('_study')}.study.study").STUDY
    needed = {entry.partition(".")[0] for stage in study.stages for entry in stage.inputs if "." in entry}
    return sum(map(composition.create_pipeline, sorted(needed)), study_pipeline(study))
