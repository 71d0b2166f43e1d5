"""The same work for every method that recognises objects."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.detection.detector import DetectionStages
from mlsroad_pipeline.algorithms.evaluation.labelling import find_scheme
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.algorithms.recognition.cutting import RecognitionParameters, cut_objects
from mlsroad_pipeline.algorithms.recognition.recogniser import train_and_recognise, train_recogniser
from mlsroad_pipeline.algorithms.recognition.scores import score_recognitions
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters
from mlsroad_pipeline.algorithms.stages import GroundParameters
from mlsroad_pipeline.datasets.scene_store_dataset import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile, scene_tasks
from mlsroad_pipeline.pipelines.recognition.work import recognise_with_model
from mlsroad_pipeline.reporting.figures.scores import confusion_figure
from mlsroad_pipeline.surveys.object_files import find_folds, listed_files, read_fold
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import held_out_keys, training_keys


def cut_objects_of_scenes(
    scenes: SceneCollection, objects: SceneCollection, recognition: RecognitionParameters, classes: Mapping[str, Any]
) -> dict[str, SceneTask]:
    """Name the work that cuts the objects out of each scene."""
    parameters = {"scheme": find_scheme(classes["schemes"], recognition.scheme), "parameters": recognition}
    return scene_tasks(scenes, cut_objects, {"scene": scenes, "objects": objects}, parameters)


def read_object_folds(
    survey: SurveyParameters, recognition: RecognitionParameters, classes: Mapping[str, Any]
) -> dict[str, SceneTask]:
    """Name the work that reads the objects of each fold."""
    survey.check_root()
    scheme = find_scheme(classes["schemes"], recognition.scheme)
    return {
        name: SceneTask(
            read_fold,
            {"path": SourceFile(str(path)), "files": [SourceFile(str(file)) for file in listed_files(path)]},
            {"scheme": scheme},
        )
        for name, path in find_folds(survey.root, str(recognition.folds)).items()
    }


def training_node(slug: str) -> Callable[..., tuple[ModelBundle, ModelBundle]]:
    """Return the node that trains a method."""

    def train_method(
        sets: SceneCollection,
        parameters: Any,
        recognition: RecognitionParameters,
        ground: GroundParameters,
        segmentation: SegmentationParameters,
        survey: SurveyParameters,
        classes: Mapping[str, Any],
    ) -> tuple[ModelBundle, ModelBundle]:
        chosen = list(sets) if recognition.folds else training_keys(sets)
        bundle = train_recogniser(
            [sets[key].load() for key in chosen],
            slug=slug,
            parameters=parameters,
            recognition=recognition,
            stages=DetectionStages(ground, segmentation),
            scheme=find_scheme(classes["schemes"], recognition.scheme),
            trained_on={"survey": survey.root, "sets": chosen},
        )
        return bundle, bundle

    # Kedro reads here which class the parameters become.
    train_method.__annotations__["parameters"] = METHODS[slug].load("parameters")
    return train_method


def recognise_sets(
    sets: SceneCollection,
    model: SourceFile,
    parameters: Any,
    recognition: RecognitionParameters,
    classes: Mapping[str, Any],
    *,
    method: str,
) -> dict[str, SceneTask]:
    """Name the work that recognises the objects of each scene that the model was not trained on, or of each fold."""
    if not recognition.folds:
        return scene_tasks(held_out_keys(sets), recognise_with_model, {"objects": sets, "model": model})
    fixed = {
        "slug": method,
        "parameters": parameters,
        "recognition": recognition,
        "n_classes": len(find_scheme(classes["schemes"], recognition.scheme)),
    }
    return {
        key: SceneTask(
            train_and_recognise,
            {"train": {other: sets[other] for other in sets if other != key}, "test": sets[key]},
            fixed,
        )
        for key in sets
    }


def score_recogniser(
    sets: SceneCollection,
    recognitions: SceneCollection,
    recognition: RecognitionParameters,
    classes: Mapping[str, Any],
    *,
    method: str,
) -> tuple[pd.DataFrame, Figure]:
    """Score a method on the objects that it was not trained on."""
    truth = {key: sets[key].load()["label"] for key in recognitions}
    scheme = find_scheme(classes["schemes"], recognition.scheme)
    scores, matrices = score_recognitions(
        truth,
        {key: found["label"] for key, found in recognitions.load_all().items()},
        method=method,
        scheme=scheme,
        folds=recognition.folds is not None,
    )
    last = list(matrices)[-1]
    return scores, confusion_figure(matrices[last], classes=scheme.classes, title=f"{method}, split {last}")
