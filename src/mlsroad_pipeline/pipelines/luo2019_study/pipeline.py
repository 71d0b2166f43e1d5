"""Pipeline of the study of Luo et al. 2019."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.papers.luo2019.study.figures import CAPTIONS, study_figures
from mlsroad_pipeline.papers.luo2019.study.parameters import BASELINES, JOINTNET, PRINTED, TUNED
from mlsroad_pipeline.papers.luo2019.study.plan import measure_networks, run_methods
from mlsroad_pipeline.papers.luo2019.study.report import study_sections
from mlsroad_pipeline.papers.luo2019.study.results import StudyTables
from mlsroad_pipeline.pipelines import simulated_objects
from mlsroad_pipeline.pipelines.luo2019_study.nodes import plan_study, read_folds, tabulate_study
from mlsroad_pipeline.pipelines.study import Stage, StudyReport, study_pipeline


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: parameters to simulated sets, runs, tables, figures and a report."""
    return simulated_objects.create_pipeline() + study_pipeline(
        "luo2019",
        parameters=("simulated_objects", "classes", JOINTNET, TUNED, PRINTED, *BASELINES),
        plan=plan_study,
        stages=[
            Stage("read_luo2019_folds", read_folds, [], "folds"),
            Stage("measure_luo2019_networks", measure_networks, [], "networks"),
            Stage("run_luo2019_methods", run_methods, ["simulated_objects.sets", "folds"], "runs"),
        ],
        report=StudyReport(
            "Luo et al. 2019 on simulated objects",
            tables=StudyTables,
            tabulate=tabulate_study,
            results=["runs", "networks"],
            captions=CAPTIONS,
            draw=study_figures,
            write=study_sections,
        ),
    )
