"""Pipeline that reads a survey and cuts it into scenes."""

import logging
from collections.abc import Mapping
from typing import Any

import pandas as pd
from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.quality.tables import quality_table
from mlsroad_pipeline.algorithms.scenes.joining import join_pieces
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile
from mlsroad_pipeline.pipelines.per_scene import named_node
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import (
    SurveyPlan,
    cut_ranges,
    estimated_passes,
    plan_comparison,
    plan_pass,
    trajectory_beside,
)
from mlsroad_pipeline.surveys.reading import describe_file, find_corridor, read_and_cut
from mlsroad_pipeline.surveys.survey_warnings import constant_warnings

logger = logging.getLogger(__name__)


def plan_files(
    parameters: SurveyParameters, ingest: IngestParameters, classes: Mapping[str, Any], simulated: SceneCollection
) -> SurveyPlan:
    """List the files of each split, those of simulated surveys included."""
    if len(simulated):
        n_points = sum(int(survey["n_points"]) for survey in simulated.load_all().values())
        logger.info("%s: %d simulated surveys of %d points together", parameters.root, len(simulated), n_points)
    return plan_comparison(parameters, ingest, classes["codings"])


def describe_files(plan: SurveyPlan, ingest: IngestParameters) -> dict[str, SceneTask]:
    """Create one task per file, which counts its points and takes a sample."""
    estimated = estimated_passes(plan, ingest)
    return {
        f.key: SceneTask(
            describe_file,
            {"path": SourceFile(f.source.path)},
            {"options": plan.options, "labels": plan.labels, "windows": f.pass_key in estimated},
        )
        for f in plan.files
    }


def find_corridors(plan: SurveyPlan, files: SceneCollection, ingest: IngestParameters) -> dict[str, SceneTask]:
    """Create one task per pass, which finds the corridor that it is cut along."""
    samples, windows, facts = files.part("sample"), files.part("windows"), files.load_all("info")
    tasks = {}
    for pass_key, members in plan.passes().items():
        beside = trajectory_beside(members)
        inputs = {
            "samples": [samples[f.key] for f in members],
            "windows": [windows[f.key] for f in members],
            "trajectory": None if beside is None else SourceFile(beside),
        }
        factors = facts[members[0].key]["factors"]
        tasks[pass_key] = SceneTask(find_corridor, inputs, {"along": ingest.cut == "along", "factors": factors})
    return tasks


def cut_files(
    plan: SurveyPlan, files: SceneCollection, corridors: SceneCollection, ingest: IngestParameters
) -> dict[str, SceneTask]:
    """Create one task per range of rows, which reads it and sorts it into bins of the corridor."""
    for pass_key, corridor in corridors.load_all().items():
        if "note" in corridor:
            logger.info("%s: %s", pass_key, corridor["note"])
    info = files.load_all("info")
    for name, warning in constant_warnings(plan, info):
        logger.warning("%s: %s", name, warning)
    return {
        cut.key: SceneTask(
            read_and_cut,
            {"path": SourceFile(cut.file.source.path), "corridor": corridors[cut.file.pass_key]}
            | ({"predictions": SourceFile(plan.predictions[cut.file.key])} if plan.predictions else {}),
            cut.parameters(plan, ingest),
        )
        for cut in cut_ranges(plan, info, ingest)
    }


def assemble_scenes(plan: SurveyPlan, pieces: SceneCollection, ingest: IngestParameters) -> dict[str, SceneTask]:
    """Create one task per scene, which joins its pieces."""
    bins, points = pieces.load_all("bins"), pieces.part("points", mapped=True)
    return {
        scene.key: SceneTask(
            join_pieces,
            {"pieces": [points[key] for key in scene.pieces]},
            {"span": scene.span, "outliers": ingest.outliers, "source": scene.source},
        )
        for pass_key in plan.passes()
        for scene in plan_pass(pass_key, plan, bins, ingest)
    }


def report_quality(plan: SurveyPlan, pieces: SceneCollection) -> pd.DataFrame:
    """Return the quality of each file."""
    return quality_table({f.source.name: f.key for f in plan.files}, pieces.load_all("quality"))


_STORES = {"plan": "survey_plan", "files": "survey_files"}


def cut_survey() -> Pipeline:
    """Return the pipeline from the plan of a survey to its pieces and its quality; `label` has it in a namespace."""
    return Pipeline(
        [
            named_node(describe_files, "survey_files", **_STORES),
            named_node(find_corridors, "corridors", **_STORES),
            named_node(cut_files, "pieces", **_STORES),
            named_node(report_quality, "survey_quality", **_STORES),
        ]
    )


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline from the files of a comparison, simulated ones included, to scenes and a quality report."""
    # Importing `label` imports this module and must not load the simulator.
    from mlsroad_pipeline.pipelines.simulate import create_pipeline as simulate  # noqa: PLC0415

    plan = named_node(plan_files, "survey_plan", parameters="params:survey", simulated="simulated_surveys")
    assemble = named_node(assemble_scenes, "scenes", **_STORES)
    return simulate() + Pipeline([plan, cut_survey(), assemble])
