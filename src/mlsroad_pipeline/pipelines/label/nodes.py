"""Nodes of `label`: label a new survey with a shipped or a registered model."""

import logging
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import pandas as pd

from mlsroad_pipeline.algorithms.core.classes import find_scheme
from mlsroad_pipeline.algorithms.core.palette import class_palette
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme, missing_attributes
from mlsroad_pipeline.algorithms.models.given_labels.labeller import SLUG as GIVEN_LABELS
from mlsroad_pipeline.algorithms.models.given_labels.labeller import given_bundle
from mlsroad_pipeline.algorithms.models.labelling import context_of
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.label import inventory as label_inventory
from mlsroad_pipeline.label.alignment import moves_of_passes, offsets_of_pieces
from mlsroad_pipeline.label.checks import check_device, check_headers, check_outputs
from mlsroad_pipeline.label.given_classes import (
    GIVEN_SCHEME,
    check_any_kept,
    check_predictions,
    given_classes,
    given_counts,
)
from mlsroad_pipeline.label.images import LabelImages, images_of_survey, images_to_label
from mlsroad_pipeline.label.model_choice import ModelRequest, choose_model, image_request
from mlsroad_pipeline.label.photos import write_photos
from mlsroad_pipeline.label.report import ReportPictures, label_report_sections, report_pictures
from mlsroad_pipeline.label.result_warnings import doubt_warnings, label_warnings, unusual_properties, unusual_warnings
from mlsroad_pipeline.label.runs import open_run
from mlsroad_pipeline.label.scene import LabelSettings, object_rules
from mlsroad_pipeline.label.summary import LabelSummary, summarise_labels
from mlsroad_pipeline.label.tasks import label_tasks, planned_outputs
from mlsroad_pipeline.label.weight_fit import fitted_weight
from mlsroad_pipeline.label.written_file import code_names, output_codes, write_file
from mlsroad_pipeline.model_store.bundle_files import ModelFile
from mlsroad_pipeline.model_store.object_classifiers import classifier_digest
from mlsroad_pipeline.model_store.registered_models import configured_store
from mlsroad_pipeline.reporting.html.report import build_report
from mlsroad_pipeline.surveys.given_classes import FIT
from mlsroad_pipeline.surveys.offset_warnings import offset_warnings
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.pass_offsets import SurveyOffsets
from mlsroad_pipeline.surveys.plan import SurveyPlan, plan_labelling
from mlsroad_pipeline.surveys.survey_warnings import plan_warnings

ImageLabelsParameters: Any = METHODS["image_labels"].load("parameters")

logger = logging.getLogger(__name__)


def plan_label_files(
    parameters: LabelParameters, ingest: IngestParameters, run: RunFolder, classes: Mapping[str, Any]
) -> SurveyPlan:
    """Return the plan of a survey, and begin its run: lock the output and check what would be replaced."""
    plan = plan_labelling(parameters, ingest)
    check_headers(plan, parameters)
    check_predictions(plan, classes)
    open_run(plan, parameters, run)
    return plan


def check_label_outputs(
    plan: SurveyPlan, files: SceneCollection, read_quality: pd.DataFrame, parameters: LabelParameters
) -> pd.DataFrame:
    """Check that all results can be written, and return the quality of the files."""
    check_outputs(plan, files, read_quality, parameters)
    return read_quality


def find_named_model(
    parameters: LabelParameters, image_labels: ImageLabelsParameters, classes: Mapping[str, Any]
) -> ModelRequest:
    """Return the request for the model, before the survey is read."""
    scheme = find_scheme(classes["schemes"], GIVEN_SCHEME)
    parameters.given_classes.check_class_maps(scheme, classes["codings"])
    if parameters.needs_no_model:
        return ModelRequest(GIVEN_LABELS, own=given_bundle(scheme))
    choice = None
    if parameters.method != "image_labels" or parameters.model is not None or not image_labels.own_segmentation:
        choice = choose_model(method=parameters.method, model=parameters.model, store=configured_store())
    return image_request(ModelRequest(parameters.method, choice), image_labels, classes["schemes"])


def compare_passes(plan: SurveyPlan, pieces: SceneCollection) -> SurveyOffsets:
    """Return the offsets between files and passes where they overlap."""
    return offsets_of_pieces(plan, pieces)


def load_model(request: ModelRequest, checked: pd.DataFrame) -> ModelBundle:
    """Return the model, and log the reason of its choice; `checked` orders the node after the check of the outputs."""
    del checked
    bundle, line = request.bundle()
    check_device(bundle)
    logger.info(line)
    return bundle


def warn_of_survey(
    plan: SurveyPlan,
    files: SceneCollection,
    corridors: SceneCollection,
    quality: pd.DataFrame,
    model: ModelFile,
    parameters: LabelParameters,
    facts: dict[str, float],
    offsets: SurveyOffsets,
) -> list[str]:
    """Log and return what is unusual about the survey, and what it lacks for the model; `inspect` warns of the same."""
    warnings = plan_warnings(
        plan,
        quality,
        files.load_all("info"),
        {drive: str(corridor["note"]) for drive, corridor in corridors.load_all().items() if "note" in corridor},
        trajectory=parameters.trajectory is not None,
        missing_of=partial(missing_attributes, model.load()),
    )
    label_inventory.check_paths(corridors, parameters)
    bundle = model.load()
    warnings += label_inventory.marking_warnings(plan, files, bundle, parameters)
    warnings += unusual_warnings(unusual_properties(bundle, facts))
    warnings += [f"{name}: {text}" for name, text in offset_warnings(offsets, aligned=parameters.align_passes)]
    for warning in warnings:
        logger.warning(warning)
    return warnings


def find_label_images(
    plan: SurveyPlan, model: ModelFile, parameters: LabelParameters, image_labels: ImageLabelsParameters
) -> LabelImages:
    """Return the images of the survey for a model that uses images."""
    return images_to_label(plan, model.load(), parameters.images, image_labels.masks)


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
    offsets: SurveyOffsets,
) -> dict[str, SceneTask]:
    """Create one task per scene, which labels its points."""
    bundle = model.load()
    codes = output_codes(bundle, parameters.scheme, classes["schemes"])
    rules = object_rules(bundle, parameters.inventory)
    limits, contrast = parameters.kerb_limits(), parameters.least_contrast
    given = given_classes(plan, bundle, codes, classes["codings"])
    settings = LabelSettings(codes, rules, ground, ingest.outliers, classifier_digest(), limits, contrast, given)
    cut = ingest.with_context(context_of(bundle))
    moves = moves_of_passes(plan, offsets, bundle) if parameters.align_passes else {}
    tasks = label_tasks(plan, pieces, corridors, model, images, cut, settings, moves)
    if given is None or given.weight != FIT:
        return tasks
    pooled = replace(given, weight=fitted_weight(tasks, bundle, plan.given, classes["codings"]))
    return label_tasks(plan, pieces, corridors, model, images, cut, replace(settings, given=pooled), moves)


def join_label_objects(
    plan: SurveyPlan,
    corridors: SceneCollection,
    results: SceneCollection,
    model: ModelFile,
    parameters: LabelParameters,
) -> dict[str, SceneTask]:
    """Create the task that joins the objects of all scenes and numbers them."""
    bundle = model.load()
    if bundle.slug == GIVEN_LABELS and parameters.given_classes.labels is None:
        check_any_kept(given_counts(results.load_all("counts").values()), parameters.survey_name)
    rules = object_rules(bundle, parameters.inventory)
    return {label_inventory.OBJECTS: label_inventory.objects_task(plan, corridors, results, rules, model, parameters)}


def write_labelled_files(
    plan: SurveyPlan,
    pieces: SceneCollection,
    results: SceneCollection,
    joined: SceneCollection,
    model: ModelFile,
    parameters: LabelParameters,
    classes: Mapping[str, Any],
    run: RunFolder,
    pictures: Future[ReportPictures],
) -> dict[str, SceneTask]:
    """Create one task per file, which writes it with its labels; `pictures` orders the node after their begin."""
    del pictures
    bundle = model.load()
    codes = output_codes(bundle, parameters.scheme, classes["schemes"])
    names = code_names(bundle, parameters.scheme, classes["schemes"])
    given = given_classes(plan, bundle, codes, classes["codings"])
    names = names if given is None else given.code_names(names)
    tasks = {}
    for output in planned_outputs(plan, pieces, results, joined, run, parameters):
        settings = output.parameters(plan.options, run, parameters, codes=codes, class_names=names)
        tasks[output.file.key] = SceneTask(write_file, output.inputs, settings, outputs=output.paths)
    return tasks


def make_inventory(
    plan: SurveyPlan,
    files: SceneCollection,
    corridors: SceneCollection,
    joined: SceneCollection,
    parameters: LabelParameters,
    run: RunFolder,
) -> tuple[label_inventory.Inventory, label_inventory.Inventory, label_inventory.Inventory]:
    """Return the inventory, for the later nodes and once per output format."""
    inventory = label_inventory.inventory_of(plan, files, corridors, joined, parameters, run.output)
    return label_inventory.as_of_files(inventory), inventory, inventory


def draw_pictures(
    results: SceneCollection, inventory: label_inventory.Inventory, model: ModelFile
) -> Future[ReportPictures]:
    """Begin to draw the pictures of the report, in a thread, while the workers write the files."""
    palette = class_palette(bundle_scheme(model.load()))
    pool = ThreadPoolExecutor(1, "draw-pictures")
    drawing = pool.submit(report_pictures, results, inventory, palette)
    pool.shutdown(wait=False)
    return drawing


def export_label_inventory(
    plan: SurveyPlan, inventory: label_inventory.Inventory, parameters: LabelParameters, run: RunFolder
) -> list[str]:
    """Write the inventory in the formats of `label.export` and the photos of its objects, and return the paths."""
    written = label_inventory.export_inventory(inventory, parameters.export, run)
    if parameters.photos:
        written.append(write_photos(inventory.objects, images_of_survey(plan, parameters.images), run))
    return written


def write_report(
    quality: pd.DataFrame,
    results: SceneCollection,
    written: SceneCollection,
    inventory: label_inventory.Inventory,
    pictures: Future[ReportPictures],
    exports: list[str],
    model: ModelFile,
    parameters: LabelParameters,
    survey_warnings: list[str],
    facts: dict[str, float],
) -> tuple[str, LabelSummary]:
    """Return the report of the labelled survey as HTML and its summary, and log the warnings."""
    bundle = model.load()
    counts, files = results.load_all("counts"), written.load_all()
    doubts = pd.concat(results.load_all("doubts").values(), ignore_index=True)
    warnings = [*label_warnings(bundle, counts, files), *doubt_warnings(doubts)]
    for warning in warnings:
        logger.warning(warning)
    warnings += survey_warnings
    drawn = pictures.result()
    sections = label_report_sections(bundle, parameters, quality, counts, files, inventory, drawn, warnings, doubts)
    given = given_counts(counts.values())
    summary = summarise_labels(
        *(bundle, parameters, quality, files, inventory, warnings),
        unusual=unusual_properties(bundle, facts),
        exports=exports,
        kept=0 if given is None else int(given[0]),
    )
    return build_report(sections, title="Labelled survey", subtitle=summary["survey"]), summary
