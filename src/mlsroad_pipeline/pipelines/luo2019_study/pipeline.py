"""Wiring of the study of Luo et al. 2019."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines import simulated_objects
from mlsroad_pipeline.pipelines.luo2019_study.nodes import (
    measure_networks,
    plan_study,
    read_folds,
    run_methods,
    tabulate_study,
)
from mlsroad_pipeline.pipelines.study import entries, report_node
from mlsroad_pipeline.studies.luo2019.parameters import JOINTNET, PRINTED, RIVALS
from mlsroad_pipeline.studies.luo2019.report import CAPTIONS, study_figures, study_sections
from mlsroad_pipeline.studies.luo2019.results import StudyTables

STUDY = "luo2019_study"


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: parameters to simulated sets, runs, tables, figures and a report."""
    given = [f"params:{name}" for name in (STUDY, "simulated_objects", "classes", JOINTNET, PRINTED, *RIVALS)]
    plan, folds, networks, runs = entries(STUDY, ["plan", "folds", "networks", "runs"])
    tables = entries(STUDY, StudyTables.names())
    own = Pipeline(
        [
            Node(plan_study, inputs=given, outputs=plan, name="plan_luo2019_study"),
            Node(read_folds, inputs=plan, outputs=folds, name="read_luo2019_folds"),
            Node(measure_networks, inputs=plan, outputs=networks, name="measure_luo2019_networks"),
            Node(run_methods, inputs=[plan, "simulated_objects.sets", folds], outputs=runs, name="run_luo2019_methods"),
            Node(tabulate_study, inputs=[plan, runs, networks], outputs=tables, name="tabulate_luo2019_study"),
            report_node(
                STUDY,
                tables=StudyTables,
                figures=[f"{name}_figure" for name in CAPTIONS],
                draw=study_figures,
                write=study_sections,
                title="Luo et al. 2019 on simulated objects",
            ),
        ]
    )
    return simulated_objects.create_pipeline() + own
