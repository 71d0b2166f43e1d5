"""Pipelines of recognisers: sets of objects to a model and to the classes of the objects it was not trained on."""

# Annotations are evaluated: Kedro reads from them the class of the parameters, which differs between methods.
from collections.abc import Callable, Mapping
from typing import Any

from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.core.classes import find_scheme
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, scene_tasks
from mlsroad_pipeline.model_store.bundle_files import ModelFile
from mlsroad_pipeline.papers.shared.detection.detector import DetectionStages
from mlsroad_pipeline.papers.shared.recognition.cutting import RecognitionParameters
from mlsroad_pipeline.papers.shared.recognition.recogniser import recognise_objects, train_and_recognise
from mlsroad_pipeline.pipelines.per_scene import MODEL, fix_arguments, named_node
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import held_out_keys, training_keys


def create_pipeline(slug: str) -> Pipeline:
    """Return the pipeline of a recogniser."""
    inputs = {"slug": slug, "parameters": f"params:{METHODS[slug].group or slug}", "sets": "object_sets"}
    recognise = fix_arguments(recognise_sets, method=slug)
    return Pipeline(
        [
            named_node(_training(slug), MODEL, f"train_{slug}", **inputs),
            named_node(recognise, ".recognitions", f"recognise_with_{slug}", **inputs),
        ]
    )


def _training(slug: str) -> Callable[..., tuple[ModelBundle, ModelBundle]]:
    """Return the node function that trains a recogniser; it returns the model for workers and for the registry."""
    kind: Any = METHODS[slug].load("parameters")

    def train_recogniser(
        sets: SceneCollection,
        parameters: kind,
        recognition: RecognitionParameters,
        ground: GroundParameters,
        segmentation: SegmentationParameters,
        survey: SurveyParameters,
        classes: Mapping[str, Any],
    ) -> tuple[ModelBundle, ModelBundle]:
        """Train the recogniser on the training scenes, or on all folds."""
        chosen = list(sets) if recognition.folds else training_keys(sets)
        bundle = METHODS[slug].load("train")(
            [sets[key].load() for key in chosen],
            slug=slug,
            parameters=parameters,
            recognition=recognition,
            stages=DetectionStages(ground, segmentation),
            scheme=find_scheme(classes["schemes"], recognition.scheme),
            trained_on={"survey": survey.root, "sets": chosen},
        )
        return bundle, bundle

    return train_recogniser


def recognise_sets(
    sets: SceneCollection,
    model: ModelFile,
    parameters: Any,
    recognition: RecognitionParameters,
    classes: Mapping[str, Any],
    *,
    method: str,
) -> dict[str, SceneTask]:
    """Create one task per held-out scene, or per fold with a model trained on the other folds."""
    if not recognition.folds:
        return scene_tasks(held_out_keys(sets), recognise_objects, {"objects": sets, "bundle": model})
    fixed = {
        "slug": method,
        "parameters": parameters,
        "recognition": recognition,
        "n_classes": len(find_scheme(classes["schemes"], recognition.scheme)),
    }
    return {
        key: SceneTask(train_and_recognise, {"train": {k: sets[k] for k in sets if k != key}, "test": sets[key]}, fixed)
        for key in sets
    }
