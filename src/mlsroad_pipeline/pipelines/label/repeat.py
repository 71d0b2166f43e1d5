"""Pipeline that replaces `label` where its results are finished, and the end of a run."""

import logging
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.algorithms.models.given_labels.labeller import SLUG as GIVEN_LABELS
from mlsroad_pipeline.algorithms.models.methods import METHODS, needs_images
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.execution.output_lock import OutputInUseError, lock_output
from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.execution.run_identity import FINISHED
from mlsroad_pipeline.label.further_outputs import write_further_outputs
from mlsroad_pipeline.label.model_choice import ModelChoice, StoredModel, choose_model
from mlsroad_pipeline.label.runs import missing_outputs
from mlsroad_pipeline.label.summary import LabelSummary, moved_summary
from mlsroad_pipeline.model_store.registered_models import PREFIX, configured_store
from mlsroad_pipeline.model_store.shipped_models import ShippedModel
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import plan_labelling

logger = logging.getLogger(__name__)


def is_finished(
    folder: str, settings: Mapping[str, Any], parameters: LabelParameters, ingest: IngestParameters,
    images: Any,
) -> bool:  # fmt: skip
    """Return whether the labels of a run are there and nothing has changed; copies and exports may be missing."""
    run = RunFolder(folder, settings)
    record = run.read()
    if record.get("state") != FINISHED:
        return False
    try:
        if missing_outputs(run, record, plan_labelling(parameters, ingest), parameters) is None:
            return False
        summary = record["summary"]
        if needs_images(summary["method"]) and not _is_segmented(images, summary.get("segmentation") or {}):
            return False
        own_images = images.own_segmentation and parameters.method == summary["method"] == "image_labels"
        if own_images or (parameters.needs_no_model and summary["method"] == GIVEN_LABELS):
            return parameters.model is None  # no registered model takes part
        chosen = choose_model(method=parameters.method, model=parameters.model, store=configured_store())
    except MlsRoadError:  # the run itself reports it
        return False
    return _is_same(chosen, summary["model"])


def _is_segmented(images: Any, used: Mapping[str, str]) -> bool:
    """Return whether the images were segmented by the masks or the weights that are named, else by the model."""
    if not images.own_segmentation:
        return True
    name_of = METHODS["image_labels"].function(".own_segmentation:segmentation_name")
    return bool(used.get("name") == name_of(images))


def _is_same(chosen: ModelChoice, used: Any) -> bool:
    """Return whether the chosen model is the one that labelled."""
    name, version, shipped = used["name"], str(used["version"]), used.get("source") == "shipped"
    if isinstance(chosen.model, ShippedModel):
        return shipped and chosen.model.name == name
    if isinstance(chosen.model, StoredModel):
        return used.get("source") == "stored" and used.get("folder") == chosen.model.folder
    return not shipped and (f"{PREFIX}{chosen.method}", str(chosen.model.version)) == (name, version)


def repeat_summary(run: RunFolder, parameters: LabelParameters, ingest: IngestParameters) -> LabelSummary:
    """Return the summary of a finished run, and remove what a kill may have left of its state.

    Copies, exports and photos that it lacks are written.
    """
    plan = plan_labelling(parameters, ingest)
    missing = missing_outputs(run, run.read(), plan, parameters)
    if missing:
        summary = write_further_outputs(run, missing, plan, parameters)
        run.remove_state(keep=parameters.keep_state)
        return summary
    with suppress(OutputInUseError):
        lock_output(run.output)
        run.remove_state(keep=parameters.keep_state)
    logger.info("Nothing to do: %s holds the results; label.overwrite=true labels again", run.output)
    return moved_summary(run.read()["summary"], run.output)


def repeat_pipeline() -> Pipeline:
    """Return the pipeline that reports the summary of a finished run."""
    inputs = ["label_run", "params:label", "params:ingest"]
    return Pipeline([Node(repeat_summary, inputs, "label_summary", name="repeat_label_summary")])
