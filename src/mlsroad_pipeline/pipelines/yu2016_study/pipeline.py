"""Wiring of the study of Yu et al. 2016."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.study import entries, report_node
from mlsroad_pipeline.pipelines.yu2016_study.nodes import (
    compare_segmentations,
    describe_surveys,
    make_surveys,
    plan_study,
    run_detectors,
    run_settings,
    segment_surveys,
    tabulate_study,
)
from mlsroad_pipeline.studies.yu2016.parameters import DETECTORS
from mlsroad_pipeline.studies.yu2016.report import study_figures, study_sections
from mlsroad_pipeline.studies.yu2016.results import StudyTables

STUDY = "yu2016_study"
FIGURES = ("segmentation_figure", "figure_12_figure")


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: parameters to streets, objects, detections, tables, figures and a report."""
    stages = (STUDY, "classes", "ground_removal", "segmentation", "detection", *DETECTORS)
    names = ("plan", "streets", "objects", "described", "runs", "settings", "compared")
    plan, streets, objects, described, runs, settings, compared = entries(STUDY, names)
    tables = entries(STUDY, StudyTables.names())
    stores = [streets, objects, described]
    return Pipeline(
        [
            Node(plan_study, inputs=[f"params:{name}" for name in stages], outputs=plan, name="plan_yu2016_study"),
            Node(make_surveys, inputs=plan, outputs=streets, name="make_yu2016_streets"),
            Node(segment_surveys, inputs=[plan, streets], outputs=objects, name="segment_yu2016_streets"),
            Node(describe_surveys, inputs=[plan, *stores[:2]], outputs=described, name="describe_yu2016_objects"),
            Node(run_detectors, inputs=[plan, *stores], outputs=runs, name="run_yu2016_detectors"),
            Node(run_settings, inputs=[plan, *stores], outputs=settings, name="run_yu2016_settings"),
            Node(compare_segmentations, inputs=[plan, streets], outputs=compared, name="compare_yu2016_segmentations"),
            Node(
                tabulate_study, inputs=[plan, *stores, runs, settings, compared], outputs=tables,
                name="tabulate_yu2016_study",
            ),
            report_node(
                STUDY, tables=StudyTables, figures=FIGURES, draw=study_figures, write=study_sections,
                title="Yu et al. 2016 on simulated streets",
            ),
        ]
    )  # fmt: skip
