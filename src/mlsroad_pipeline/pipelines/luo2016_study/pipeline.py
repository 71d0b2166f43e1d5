"""Pipeline of the study of Luo et al. 2016."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.papers.luo2016.study.figures import CAPTIONS, study_figures
from mlsroad_pipeline.papers.luo2016.study.parameters import METHODS
from mlsroad_pipeline.papers.luo2016.study.plan import cut_streets, plan_study, run_methods, try_settings
from mlsroad_pipeline.papers.luo2016.study.report import study_sections
from mlsroad_pipeline.papers.luo2016.study.results import StudyTables
from mlsroad_pipeline.pipelines.luo2016_study.nodes import make_streets, tabulate_study
from mlsroad_pipeline.pipelines.study import Stage, StudyReport, study_pipeline


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: parameters to streets, runs, tables, figures and a report."""
    return study_pipeline(
        "luo2016",
        parameters=("classes", "ground_removal", "patches", *METHODS),
        plan=plan_study,
        stages=[
            Stage("make_luo2016_streets", make_streets, [], "streets"),
            Stage("cut_luo2016_streets", cut_streets, ["streets"], "patches"),
            Stage("try_luo2016_settings", try_settings, ["streets", "patches"], "tried"),
            Stage("run_luo2016_methods", run_methods, ["streets", "patches", "tried"], "runs"),
        ],
        report=StudyReport(
            "Luo et al. 2016 on simulated streets",
            tables=StudyTables,
            tabulate=tabulate_study,
            results=["patches", "tried", "runs"],
            captions=CAPTIONS,
            draw=study_figures,
            write=study_sections,
            shown=["plan", "streets", "runs"],
        ),
    )
