"""Scores and figures of methods."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.model_store.bundle_files import ModelFile
from mlsroad_pipeline.papers.shared.detection.scoring import (
    DetectionParameters,
    detection_curves,
    detection_table,
)
from mlsroad_pipeline.papers.shared.evaluation.labelling import (
    given_classes,
    scores_table,
    sum_by_split,
)
from mlsroad_pipeline.papers.shared.evaluation.visibility import seen_scores_table, seen_share
from mlsroad_pipeline.papers.shared.figures.detection import precision_recall_figure
from mlsroad_pipeline.papers.shared.figures.detection_pictures import detection_figure
from mlsroad_pipeline.papers.shared.figures.labelling import scene_figures, score_figures
from mlsroad_pipeline.pipelines.schemes import detection_scheme, evaluation_scheme, training_scheme
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import middle_scenes

logger = logging.getLogger(__name__)


def score_method(
    counts: SceneCollection, model: ModelFile, survey: SurveyParameters, classes: Mapping[str, Any], *, method: str
) -> tuple[pd.DataFrame, Figure, Figure]:
    """Score a method and draw its figures."""
    trained, scheme = training_scheme(survey, classes), evaluation_scheme(survey, classes)
    matrices = sum_by_split(counts.load_all())
    predicted = given_classes(model.load().metadata, trained, scheme)
    table = scores_table(matrices, method=method, scheme=scheme, given=predicted)
    return table, *score_figures(matrices, table, method=method, scheme=scheme)


def picture_labels(
    scenes: SceneCollection,
    labels: SceneCollection,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
    *,
    method: str,
) -> tuple[Figure, Figure]:
    """Draw reference, prediction and errors of some scenes."""
    chosen = middle_scenes(list(labels))
    figures = scene_figures(
        [scenes[key].load() for key in chosen],
        [labels[key].load() for key in chosen],
        trained=training_scheme(survey, classes),
        scored=evaluation_scheme(survey, classes),
        title=f"{method} on {chosen[0]} to {chosen[-1]}" if len(chosen) > 1 else f"{method} on {chosen[0]}",
    )
    return figures["birds_eye"], figures["perspective"]


def score_seen_points(
    counts: SceneCollection, survey: SurveyParameters, classes: Mapping[str, Any], *, method: str, suffix: str
) -> tuple[pd.DataFrame, Figure, Figure]:
    """Score a method that uses images, over all points and over those inside images."""
    scheme = evaluation_scheme(survey, classes)
    table, matrices = seen_scores_table(counts.load_all(), scheme=scheme, suffix=suffix)
    own = table[table["method"] == method]
    for split in matrices[method]:
        logger.info("%s: %s", method, seen_share(own, split))
    return table, *score_figures(matrices[method], own, method=method, scheme=scheme)


def score_detector(
    counted: SceneCollection, detection: DetectionParameters, *, method: str
) -> tuple[pd.DataFrame, Figure]:
    """Score a detector and draw its precision-recall curves."""
    counts = counted.load_all()
    split = SceneKey.parse(list(counts)[-1]).split
    curves = detection_curves(counts, split=split, classes=detection.classes)
    figure = precision_recall_figure(curves, title=f"{method} on {split}")
    return detection_table(counts, method=method, classes=detection.classes), figure


def picture_detections(
    scenes: SceneCollection,
    objects: SceneCollection,
    detections: SceneCollection,
    detection: DetectionParameters,
    classes: Mapping[str, Any],
    *,
    method: str,
) -> Figure:
    """Draw correct, missed and false detections of some scenes."""
    chosen = middle_scenes(list(detections))
    return detection_figure(
        *([store[key].load() for key in chosen] for store in (scenes, objects, detections)),
        scheme=detection_scheme(detection, classes),
        parameters=detection,
        title=f"{method} on {chosen[0]} to {chosen[-1]}" if len(chosen) > 1 else f"{method} on {chosen[0]}",
    )
