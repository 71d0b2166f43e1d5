"""Wiring of the study of Luo et al. 2016."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.luo2016_study.nodes import (
    cut_streets,
    make_streets,
    plan_study,
    run_methods,
    tabulate_study,
    try_settings,
)
from mlsroad_pipeline.pipelines.study import entries, report_node
from mlsroad_pipeline.studies.luo2016.parameters import METHODS
from mlsroad_pipeline.studies.luo2016.report import study_figures, study_sections
from mlsroad_pipeline.studies.luo2016.results import StudyTables

STUDY = "luo2016_study"
FIGURES = ("methods_figure", "patch_size_figure", "search_radius_figure")


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: parameters to streets, runs, tables, figures and a report."""
    own = [f"params:{name}" for name in (STUDY, "classes", "ground_removal", "patches", *METHODS)]
    plan, streets, cut, tried, runs = entries(STUDY, ("plan", "streets", "patches", "tried", "runs"))
    tables = entries(STUDY, StudyTables.names())
    return Pipeline(
        [
            Node(plan_study, inputs=own, outputs=plan, name="plan_luo2016_study"),
            Node(make_streets, inputs=plan, outputs=streets, name="make_luo2016_streets"),
            Node(cut_streets, inputs=[plan, streets], outputs=cut, name="cut_luo2016_streets"),
            Node(try_settings, inputs=[plan, streets, cut], outputs=tried, name="try_luo2016_settings"),
            Node(run_methods, inputs=[plan, streets, cut, tried], outputs=runs, name="run_luo2016_methods"),
            Node(tabulate_study, inputs=[plan, tried, runs], outputs=tables, name="tabulate_luo2016_study"),
            report_node(
                STUDY, tables=StudyTables, figures=FIGURES, draw=study_figures, write=study_sections,
                title="Luo et al. 2016 on simulated streets",
            ),
        ]
    )  # fmt: skip
