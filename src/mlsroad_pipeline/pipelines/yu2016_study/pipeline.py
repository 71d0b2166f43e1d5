"""Pipeline of the study of Yu et al. 2016."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.papers.yu2016.study.figures import CAPTIONS, study_figures
from mlsroad_pipeline.papers.yu2016.study.parameters import METHODS_OF_STUDY
from mlsroad_pipeline.papers.yu2016.study.plan import (
    compare_segmentations,
    describe_surveys,
    plan_study,
    run_detectors,
    run_settings,
    segment_surveys,
)
from mlsroad_pipeline.papers.yu2016.study.report import study_sections
from mlsroad_pipeline.papers.yu2016.study.results import StudyTables
from mlsroad_pipeline.pipelines.study import Stage, StudyReport, study_pipeline
from mlsroad_pipeline.pipelines.yu2016_study.nodes import make_surveys, tabulate_study


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: parameters to streets, objects, detections, tables, figures and a report."""
    stores = ["streets", "objects", "described"]
    return study_pipeline(
        "yu2016",
        parameters=("classes", "ground_removal", "segmentation", "detection", *METHODS_OF_STUDY),
        plan=plan_study,
        stages=[
            Stage("make_yu2016_streets", make_surveys, [], "streets"),
            Stage("segment_yu2016_streets", segment_surveys, ["streets"], "objects"),
            Stage("describe_yu2016_objects", describe_surveys, ["streets", "objects"], "described"),
            Stage("run_yu2016_detectors", run_detectors, stores, "runs"),
            Stage("run_yu2016_settings", run_settings, stores, "settings"),
            Stage("compare_yu2016_segmentations", compare_segmentations, ["streets"], "compared"),
        ],
        report=StudyReport(
            "Yu et al. 2016 on simulated streets",
            tables=StudyTables,
            tabulate=tabulate_study,
            results=[*stores, "runs", "settings", "compared"],
            captions=CAPTIONS,
            draw=study_figures,
            write=study_sections,
        ),
    )
