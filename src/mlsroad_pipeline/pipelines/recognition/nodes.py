"""The same work for every method that recognises objects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.baselines.descriptor_machine import DescriptorParameters
from mlsroad_pipeline.algorithms.baselines.pointnet_parameters import PointNetParameters
from mlsroad_pipeline.algorithms.evaluation import find_scheme
from mlsroad_pipeline.algorithms.jointnet.parameters import JointNetParameters
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.algorithms.object_detectors import DetectionStages
from mlsroad_pipeline.algorithms.object_segmentation import SegmentationParameters
from mlsroad_pipeline.algorithms.recognisers import (
    RecognitionParameters,
    cut_objects,
    train_and_recognise,
    train_recogniser,
)
from mlsroad_pipeline.algorithms.recognition_scores import score_recognitions
from mlsroad_pipeline.algorithms.scene_stages import GroundParameters
from mlsroad_pipeline.datasets.object_files import find_folds, listed_files, read_fold
from mlsroad_pipeline.datasets.recognition_work import recognise_with_model
from mlsroad_pipeline.datasets.scene_store import SceneCollection
from mlsroad_pipeline.datasets.scene_task import SceneTask, SourceFile
from mlsroad_pipeline.datasets.survey_parameters import SurveyParameters

TRAIN = "train."


def cut_objects_of_scenes(
    scenes: SceneCollection, objects: SceneCollection, recognition: RecognitionParameters, classes: Mapping[str, Any]
) -> dict[str, SceneTask]:
    """Name the work that cuts the objects out of each scene.

    Parameters
    ----------
    scenes, objects : SceneCollection
        The scenes and their objects.
    recognition : RecognitionParameters
        Which objects.
    classes : mapping
        The class schemes.

    Returns
    -------
    dict of str to SceneTask
        One task per scene.
    """
    parameters = {"scheme": find_scheme(classes["schemes"], recognition.scheme), "parameters": recognition}
    return {key: SceneTask(cut_objects, {"scene": scenes[key], "objects": objects[key]}, parameters) for key in scenes}


def read_object_folds(
    survey: SurveyParameters, recognition: RecognitionParameters, classes: Mapping[str, Any]
) -> dict[str, SceneTask]:
    """Name the work that reads the objects of each fold.

    Parameters
    ----------
    survey : SurveyParameters
        Its root.
    recognition : RecognitionParameters
        Where the lists of the folds lie.
    classes : mapping
        The class schemes.

    Returns
    -------
    dict of str to SceneTask
        One task per fold.
    """
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


def train_jointnet(
    sets: SceneCollection,
    parameters: JointNetParameters,
    recognition: RecognitionParameters,
    ground: GroundParameters,
    segmentation: SegmentationParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
    *,
    method: str,
) -> tuple[ModelBundle, ModelBundle]:
    """Train JointNet or a sub-network.

    Parameters
    ----------
    sets : SceneCollection
        The objects; those of the training scenes, or of all folds, are learned.
    parameters : JointNetParameters
        Parameters of the method.
    recognition : RecognitionParameters
        Which objects.
    ground : GroundParameters
        How the ground was found.
    segmentation : SegmentationParameters
        How objects were found.
    survey : SurveyParameters
        Names the survey.
    classes : mapping
        The class schemes.
    method : str
        The method's slug.

    Returns
    -------
    model, registered : ModelBundle
        The model, for the workers and for the registry.
    """
    return _train(sets, parameters, recognition, DetectionStages(ground, segmentation), survey, classes, method)


def train_machine(
    sets: SceneCollection,
    parameters: DescriptorParameters,
    recognition: RecognitionParameters,
    ground: GroundParameters,
    segmentation: SegmentationParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
    *,
    method: str,
) -> tuple[ModelBundle, ModelBundle]:
    """Train a descriptor with a machine.

    Parameters
    ----------
    sets : SceneCollection
        The objects; those of the training scenes, or of all folds, are learned.
    parameters : DescriptorParameters
        Parameters of the method.
    recognition : RecognitionParameters
        Which objects.
    ground : GroundParameters
        How the ground was found.
    segmentation : SegmentationParameters
        How objects were found.
    survey : SurveyParameters
        Names the survey.
    classes : mapping
        The class schemes.
    method : str
        The method's slug.

    Returns
    -------
    model, registered : ModelBundle
        The model, for the workers and for the registry.
    """
    return _train(sets, parameters, recognition, DetectionStages(ground, segmentation), survey, classes, method)


def train_pointnet(
    sets: SceneCollection,
    parameters: PointNetParameters,
    recognition: RecognitionParameters,
    ground: GroundParameters,
    segmentation: SegmentationParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
    *,
    method: str,
) -> tuple[ModelBundle, ModelBundle]:
    """Train PointNet.

    Parameters
    ----------
    sets : SceneCollection
        The objects; those of the training scenes, or of all folds, are learned.
    parameters : PointNetParameters
        Parameters of the method.
    recognition : RecognitionParameters
        Which objects.
    ground : GroundParameters
        How the ground was found.
    segmentation : SegmentationParameters
        How objects were found.
    survey : SurveyParameters
        Names the survey.
    classes : mapping
        The class schemes.
    method : str
        The method's slug.

    Returns
    -------
    model, registered : ModelBundle
        The model, for the workers and for the registry.
    """
    return _train(sets, parameters, recognition, DetectionStages(ground, segmentation), survey, classes, method)


def _train(
    sets: SceneCollection,
    parameters: Any,
    recognition: RecognitionParameters,
    stages: DetectionStages,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
    method: str,
) -> tuple[ModelBundle, ModelBundle]:
    """Learn from the training scenes, or from all folds; return the model for the workers and for the registry."""
    chosen = [key for key in sets if recognition.folds or key.startswith(TRAIN)]
    bundle = train_recogniser(
        [sets[key].load() for key in chosen],
        slug=method,
        parameters=parameters,
        recognition=recognition,
        stages=stages,
        scheme=find_scheme(classes["schemes"], recognition.scheme),
        trained_on={"survey": survey.root, "sets": chosen},
    )
    return bundle, bundle


def recognise_sets(
    sets: SceneCollection,
    model: SourceFile,
    parameters: Any,
    recognition: RecognitionParameters,
    classes: Mapping[str, Any],
    *,
    method: str,
) -> dict[str, SceneTask]:
    """Name the work that recognises the objects of each scene that the model was not trained on, or of each fold.

    Parameters
    ----------
    sets : SceneCollection
        The objects.
    model : SourceFile
        The model's folder.
    parameters : dataclass
        Parameters of the method: of each fold, a model of its own is trained on the others.
    recognition : RecognitionParameters
        Which objects.
    classes : mapping
        The class schemes.
    method : str
        The method's slug.

    Returns
    -------
    dict of str to SceneTask
        One task per scene or fold.
    """
    if not recognition.folds:
        test = [key for key in sets if not key.startswith(TRAIN)]
        return {key: SceneTask(recognise_with_model, {"objects": sets[key], "model": model}) for key in test}
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
    """Score a method on the objects that it was not trained on.

    Parameters
    ----------
    sets, recognitions : SceneCollection
        The objects, and what the method made of them.
    recognition : RecognitionParameters
        Names the class scheme.
    classes : mapping
        The class schemes.
    method : str
        The method's slug.

    Returns
    -------
    scores : DataFrame
        The table of scores.
    confusion : Figure
        The confusion matrix of the last split.
    """
    truth = {key: sets[key].load()["label"] for key in recognitions}
    return score_recognitions(
        truth,
        {key: found["label"] for key, found in recognitions.load_all().items()},
        method=method,
        scheme=find_scheme(classes["schemes"], recognition.scheme),
        folds=recognition.folds is not None,
    )
