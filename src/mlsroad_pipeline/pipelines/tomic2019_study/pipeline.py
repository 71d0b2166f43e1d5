"""Wiring of the study of Tomic et al. 2019."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.study import entries
from mlsroad_pipeline.pipelines.tomic2019_study.nodes import (
    draw_study,
    fuse_surveys,
    label_by_features,
    label_by_images,
    make_photographs,
    make_surveys,
    plan_study,
    tabulate_study,
    train_network,
)
from mlsroad_pipeline.studies.tomic2019.report import CAPTIONS
from mlsroad_pipeline.studies.tomic2019.results import StudyTables

STUDY = "tomic2019_study"


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: parameters to surveys, labels, fusions, tables, figures and a report."""
    stages = (
        STUDY, "classes", "ground_removal", "supervoxelise", "features", "detrended_forest", "image_labels", "fusion"
    )  # fmt: skip
    names = ("plan", "streets", "photographs", "networks", "by_features", "by_images", "runs")
    plan, streets, photographs, networks, features, images, runs = entries(STUDY, names)
    tables = entries(STUDY, StudyTables.names())
    figures = entries(STUDY, [f"{name}_figure" for name in CAPTIONS])
    report = f"{STUDY}.report"
    return Pipeline(
        [
            Node(plan_study, inputs=[f"params:{name}" for name in stages], outputs=plan, name="plan_tomic2019_study"),
            Node(make_surveys, inputs=plan, outputs=streets, name="make_tomic2019_surveys"),
            Node(make_photographs, inputs=plan, outputs=photographs, name="make_tomic2019_photographs"),
            Node(train_network, inputs=[plan, photographs], outputs=networks, name="train_tomic2019_network"),
            Node(label_by_features, inputs=[plan, streets], outputs=features, name="label_tomic2019_by_features"),
            Node(label_by_images, inputs=[plan, streets, networks], outputs=images, name="label_tomic2019_by_images"),
            Node(fuse_surveys, inputs=[plan, streets, features, images], outputs=runs, name="fuse_tomic2019_surveys"),
            Node(tabulate_study, [plan, features, images, runs], tables, name="tabulate_tomic2019_study"),
            Node(
                draw_study,
                inputs=[plan, streets, features, images, runs, *tables],
                outputs=[*figures, report],
                name="report_tomic2019_study",
            ),
        ]
    )
