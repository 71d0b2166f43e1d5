"""Wiring of the study of Yu et al. 2016."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.studies.yu2016_parameters import DETECTORS
from mlsroad_pipeline.pipelines.yu2016_study.nodes import (
    describe_surveys,
    make_surveys,
    plan_study,
    report_study,
    run_detectors,
    run_settings,
    segment_surveys,
    tabulate_study,
)

STUDY = "yu2016_study"
TABLES = (
    "scores", "segmentation", "table_2", "table_3", "table_4", "table_5", "differences", "figure_12", "curves"
)  # fmt: skip


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: parameters to streets, objects, detections, tables, figures and a report.

    Parameters
    ----------
    **_ : object
        Not used; Kedro lets callers of any pipeline give keyword arguments.

    Returns
    -------
    Pipeline
        Parameters to ``yu2016_study.*``.
    """
    stages = (STUDY, "classes", "ground_removal", "segmentation", "detection", *DETECTORS)
    names = ("plan", "streets", "objects", "described", "runs", "settings")
    plan, streets, objects, described, runs, settings = (f"{STUDY}.{name}" for name in names)
    tables = [f"{STUDY}.{name}" for name in TABLES]
    drawn = [f"{STUDY}.{name}" for name in ("segmentation_figure", "figure_12_figure", "report")]
    stores = [streets, objects, described]
    return Pipeline(
        [
            Node(plan_study, inputs=[f"params:{name}" for name in stages], outputs=plan, name="plan_yu2016_study"),
            Node(make_surveys, inputs=plan, outputs=streets, name="make_yu2016_streets"),
            Node(segment_surveys, inputs=[plan, streets], outputs=objects, name="segment_yu2016_streets"),
            Node(describe_surveys, inputs=[plan, *stores[:2]], outputs=described, name="describe_yu2016_objects"),
            Node(run_detectors, inputs=[plan, *stores], outputs=runs, name="run_yu2016_detectors"),
            Node(run_settings, inputs=[plan, *stores], outputs=settings, name="run_yu2016_settings"),
            Node(tabulate_study, inputs=[plan, *stores, runs, settings], outputs=tables, name="tabulate_yu2016_study"),
            Node(report_study, inputs=[plan, *tables], outputs=drawn, name="report_yu2016_study"),
        ]
    )
