"""Pipeline of the study of Tomic et al. 2019."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.papers.tomic2019.study.figures import CAPTIONS, study_figures
from mlsroad_pipeline.papers.tomic2019.study.plan import (
    fuse_surveys,
    label_by_features,
    label_by_images,
    plan_study,
    train_network,
)
from mlsroad_pipeline.papers.tomic2019.study.report import study_sections
from mlsroad_pipeline.papers.tomic2019.study.results import StudyTables
from mlsroad_pipeline.pipelines.study import Stage, StudyReport, study_pipeline
from mlsroad_pipeline.pipelines.tomic2019_study.nodes import (
    make_photographs,
    make_surveys,
    tabulate_study,
)


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: parameters to surveys, labels, fusions, tables, figures and a report."""
    return study_pipeline(
        "tomic2019",
        parameters=(
            "classes", "ground_removal", "supervoxelise", "features", "detrended_forest", "image_labels", "fusion"
        ),
        plan=plan_study,
        stages=[
            Stage("make_tomic2019_surveys", make_surveys, [], "streets"),
            Stage("make_tomic2019_photographs", make_photographs, [], "photographs"),
            Stage("train_tomic2019_network", train_network, ["photographs"], "networks"),
            Stage("label_tomic2019_by_features", label_by_features, ["streets"], "by_features"),
            Stage("label_tomic2019_by_images", label_by_images, ["streets", "networks"], "by_images"),
            Stage("fuse_tomic2019_surveys", fuse_surveys, ["streets", "by_features", "by_images"], "runs"),
        ],
        report=StudyReport(
            "Tomic et al. 2019 on simulated surveys",
            tables=StudyTables,
            tabulate=tabulate_study,
            results=["by_features", "by_images", "runs"],
            captions=CAPTIONS,
            draw=study_figures,
            write=study_sections,
            shown=["plan", "streets", "by_features", "by_images", "runs"],
        ),
    )  # fmt: skip
