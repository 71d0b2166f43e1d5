"""The same scoring for every labeller."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.detection.scoring import (
    DetectionParameters,
    count_detections_of_scene,
    detection_curves,
    detection_table,
)
from mlsroad_pipeline.algorithms.evaluation.labelling import (
    count_scene,
    find_scheme,
    given_classes,
    scores_table,
    sum_by_split,
)
from mlsroad_pipeline.algorithms.evaluation.visibility import count_seen_scene, seen_scores_table, seen_share
from mlsroad_pipeline.datasets.models.model_bundle_dataset import open_model
from mlsroad_pipeline.datasets.scene_store_dataset import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile, scene_tasks
from mlsroad_pipeline.reporting.clouds.detection_pictures import detection_figure
from mlsroad_pipeline.reporting.figures.detection import precision_recall_figure
from mlsroad_pipeline.reporting.figures.labelling import scene_figures, score_figures
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import middle_scenes

logger = logging.getLogger(__name__)


def _schemes(survey: SurveyParameters, classes: Mapping[str, Any]) -> dict[str, ClassScheme]:
    """Return the scheme that methods are trained on and the one that they are scored on."""
    return {
        "trained": find_scheme(classes["schemes"], survey.scheme),
        "scored": find_scheme(classes["schemes"], survey.evaluation_scheme or survey.scheme),
    }


def count_points(
    scenes: SceneCollection, labels: SceneCollection, survey: SurveyParameters, classes: Mapping[str, Any]
) -> dict[str, SceneTask]:
    """Name the work that counts each labelled scene's points by true and predicted class."""
    return scene_tasks(labels, count_scene, {"scene": scenes, "labels": labels}, _schemes(survey, classes))


def score_method(
    counts: SceneCollection, model: SourceFile, survey: SurveyParameters, classes: Mapping[str, Any], *, method: str
) -> tuple[pd.DataFrame, Figure, Figure]:
    """Score a method and draw its figures."""
    schemes = _schemes(survey, classes)
    scheme = schemes["scored"]
    matrices = sum_by_split(counts.load_all())
    given = given_classes(open_model(model.load()).metadata, schemes["trained"], scheme)
    table = scores_table(matrices, method=method, scheme=scheme, given=given)
    return table, *score_figures(matrices, table, method=method, scheme=scheme)


def picture_labels(
    scenes: SceneCollection,
    labels: SceneCollection,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
    *,
    method: str,
) -> tuple[Figure, Figure]:
    """Draw truth, prediction and errors of some scenes."""
    chosen = middle_scenes(list(labels))
    figures = scene_figures(
        [scenes[key].load() for key in chosen],
        [labels[key].load() for key in chosen],
        **_schemes(survey, classes),
        title=f"{method} on {chosen[0]} to {chosen[-1]}" if len(chosen) > 1 else f"{method} on {chosen[0]}",
    )
    return figures["birds_eye"], figures["perspective"]


def count_seen_points(
    scenes: SceneCollection,
    labels: SceneCollection,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
    *,
    answers: Mapping[str, str],
) -> dict[str, SceneTask]:
    """Name the work that counts each scene's points, all of them and those that cameras see."""
    fixed = {"answers": answers, **_schemes(survey, classes)}
    return scene_tasks(labels, count_seen_scene, {"scene": scenes, "labels": labels}, fixed)


def score_seen_points(
    counts: SceneCollection, survey: SurveyParameters, classes: Mapping[str, Any], *, method: str, suffix: str
) -> tuple[pd.DataFrame, Figure, Figure]:
    """Score a method that uses images, over all points and over those that cameras see."""
    scheme = _schemes(survey, classes)["scored"]
    table, matrices = seen_scores_table(counts.load_all(), scheme=scheme, suffix=suffix)
    mine = table[table["method"] == method]
    for split in matrices[method]:
        logger.info("%s: %s", method, seen_share(mine, split))
    return table, *score_figures(matrices[method], mine, method=method, scheme=scheme)


def count_detections(
    scenes: SceneCollection,
    objects: SceneCollection,
    detections: SceneCollection,
    detection: DetectionParameters,
    classes: Mapping[str, Any],
) -> dict[str, SceneTask]:
    """Name the work that compares each scene's detections with its reference objects."""
    parameters = {"scheme": find_scheme(classes["schemes"], detection.scheme), "parameters": detection}
    inputs = {"scene": scenes, "objects": objects, "detections": detections}
    return scene_tasks(detections, count_detections_of_scene, inputs, parameters)


def score_detector(
    counted: SceneCollection, detection: DetectionParameters, *, method: str
) -> tuple[pd.DataFrame, Figure]:
    """Score a detector and draw its precision-recall curves."""
    found = counted.load_all()
    split = SceneKey.parse(list(found)[-1]).split
    curves = detection_curves(found, split=split, classes=detection.classes)
    figure = precision_recall_figure(curves, title=f"{method} on {split}")
    return detection_table(found, method=method, classes=detection.classes), figure


def picture_detections(
    scenes: SceneCollection,
    objects: SceneCollection,
    detections: SceneCollection,
    detection: DetectionParameters,
    classes: Mapping[str, Any],
    *,
    method: str,
) -> Figure:
    """Draw the right, missed and false detections of some scenes."""
    chosen = middle_scenes(list(detections))
    return detection_figure(
        *([found[key].load() for key in chosen] for found in (scenes, objects, detections)),
        scheme=find_scheme(classes["schemes"], detection.scheme),
        parameters=detection,
        title=f"{method} on {chosen[0]} to {chosen[-1]}" if len(chosen) > 1 else f"{method} on {chosen[0]}",
    )
