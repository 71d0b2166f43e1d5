"""A new survey labelled by a registered model."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import pandas as pd

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.quality.tables import quality_table
from mlsroad_pipeline.algorithms.scenes.cutting import IngestParameters
from mlsroad_pipeline.algorithms.stages import GroundParameters
from mlsroad_pipeline.datasets.inventory.road_inventory import RoadInventory
from mlsroad_pipeline.datasets.models.bundle_files import ModelFile
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile
from mlsroad_pipeline.label.images import LabelImages, images_to_label
from mlsroad_pipeline.label.inventory import OBJECTS, inventory_of, objects_task, survey_crs
from mlsroad_pipeline.label.outputs import attribute_warnings, label_report_sections, planned_outputs
from mlsroad_pipeline.label.scene import object_rules, output_codes
from mlsroad_pipeline.label.tasks import label_tasks
from mlsroad_pipeline.label.work import write_file
from mlsroad_pipeline.reporting.html.report import build_report
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import SurveyPlan, plan_labelling

logger = logging.getLogger(__name__)


def plan_label_files(parameters: LabelParameters, ingest: IngestParameters) -> SurveyPlan:
    """List the files of the survey."""
    return plan_labelling(parameters, ingest)


def take_model(registered: ModelBundle) -> ModelBundle:
    """Take the registered model and say what it was trained on."""
    told = registered.metadata
    logger.info("Labelling with %s, trained on %s", told.get("registered", registered.slug), told.get("trained_on"))
    return registered


def _quality(plan: SurveyPlan, pieces: SceneCollection) -> pd.DataFrame:
    return quality_table({f.source.name: f.key for f in plan.files}, pieces.load_all("quality"))


def find_label_images(plan: SurveyPlan, model: ModelFile, parameters: LabelParameters) -> LabelImages:
    """Find the images of the survey, where the model looks at any."""
    return images_to_label(plan, model.load(), parameters.images)


def label_new_scenes(
    plan: SurveyPlan,
    pieces: SceneCollection,
    corridors: SceneCollection,
    model: ModelFile,
    images: LabelImages,
    parameters: LabelParameters,
    ingest: IngestParameters,
    ground: GroundParameters,
    classes: Mapping[str, Any],
) -> dict[str, SceneTask]:
    """Name the work that labels each scene."""
    bundle = model.load()
    for warning in attribute_warnings(bundle, _quality(plan, pieces)):
        logger.warning(warning)
    fixed = {
        "outliers": ingest.outliers,
        "codes": output_codes(bundle, parameters.scheme, classes["schemes"]),
        "rules": object_rules(bundle, parameters.inventory),
        "ground": ground,
    }
    return label_tasks(plan, pieces, corridors, model, images, ingest, fixed)


def write_labelled_files(
    plan: SurveyPlan,
    files: SceneCollection,
    corridors: SceneCollection,
    pieces: SceneCollection,
    results: SceneCollection,
    model: ModelFile,
    parameters: LabelParameters,
) -> dict[str, SceneTask]:
    """Name the work that writes each file with its labels, and the work that joins the objects meanwhile."""
    survey_crs(plan, files)  # an inventory needs a single one: that is better known before hours of writing
    bundle = model.load()
    rules = object_rules(bundle, parameters.inventory)
    copies = {"copc": parameters.copc, "coloured_ply": parameters.coloured_ply}
    outputs = planned_outputs(plan, pieces, results, str(parameters.output), **copies)
    return {OBJECTS: objects_task(plan, corridors, results, rules, bundle)} | {
        output.file.key: SceneTask(
            write_file,
            {"path": SourceFile(output.file.source.path), "scenes": output.scenes},
            output.parameters(plan.options),
            outputs=output.written,
        )
        for output in outputs
    }


def make_inventory(
    plan: SurveyPlan, files: SceneCollection, corridors: SceneCollection, written: SceneCollection
) -> tuple[RoadInventory, RoadInventory]:
    """Put the objects on the map."""
    found = inventory_of(plan, files, corridors, written)
    return found, found


def write_report(
    plan: SurveyPlan,
    pieces: SceneCollection,
    results: SceneCollection,
    written: SceneCollection,
    inventory: RoadInventory,
    model: ModelFile,
    parameters: LabelParameters,
) -> str:
    """Put what was found on one page."""
    quality = _quality(plan, pieces)
    sections = label_report_sections(
        model.load(), parameters, quality, results.load_all("counts"), written.load_all(), inventory.objects
    )
    return build_report(sections, title="Labelled survey", subtitle=str(parameters.survey))
