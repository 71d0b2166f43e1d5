"""Evaluation of all methods by the same code, at full resolution."""

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pandas as pd
from kedro.pipeline import Node, Pipeline
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.model_store.bundle_files import ModelFile
from mlsroad_pipeline.papers.shared import evaluation as counting
from mlsroad_pipeline.papers.shared.detection.scoring import (
    DetectionParameters,
    count_detections_of_scene,
    detection_curves,
    detection_table,
)
from mlsroad_pipeline.papers.shared.figures import (
    detection_figure,
    precision_recall_figure,
    scene_figures,
    score_figures,
)
from mlsroad_pipeline.pipelines.per_scene import fix_arguments, named_node, scene_node
from mlsroad_pipeline.pipelines.schemes import detection_scheme, evaluation_scheme, training_scheme
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import middle_scenes

logger = logging.getLogger(__name__)


def score_method(
    counts: SceneCollection, model: ModelFile, survey: SurveyParameters, classes: Mapping[str, Any], *, method: str
) -> tuple[pd.DataFrame, Figure, Figure]:
    """Score a method and draw its figures."""
    trained, scheme = training_scheme(survey, classes), evaluation_scheme(survey, classes)
    matrices = counting.sum_by_split(counts.load_all())
    predicted = counting.given_classes(model.load().metadata, trained, scheme)
    table = counting.scores_table(matrices, method=method, scheme=scheme, given=predicted)
    return table, *score_figures(matrices, table, method=method, scheme=scheme)


def _title(method: str, chosen: Sequence[str]) -> str:
    return f"{method} on {chosen[0]} to {chosen[-1]}" if len(chosen) > 1 else f"{method} on {chosen[0]}"


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
        title=_title(method, chosen),
    )
    return figures["birds_eye"], figures["perspective"]


def score_seen_points(
    counts: SceneCollection, survey: SurveyParameters, classes: Mapping[str, Any], *, method: str, suffix: str
) -> tuple[pd.DataFrame, Figure, Figure]:
    """Score a method that uses images, over all points and over those inside images."""
    scheme = evaluation_scheme(survey, classes)
    table, matrices = counting.seen_scores_table(counts.load_all(), scheme=scheme, suffix=suffix)
    own = table[table["method"] == method]
    for split in matrices[method]:
        logger.info("%s: %s", method, counting.seen_share(own, split))
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
        title=_title(method, chosen),
    )


def _nodes_of(slug: str, count: Callable[..., Any], score: Callable[..., Any], **fixed: Any) -> list[Node]:
    """Return the nodes that count the points of each labelled scene by class, score them and draw the labels."""
    return [
        scene_node(
            count, f"{slug}.confusions", f"count_points_of_{slug}", inputs={"labels": f"{slug}.labels"},
            over="labels", fixed=fixed, trained=training_scheme, scored=evaluation_scheme,
        ),
        named_node(score, [".scores", ".confusion_figure", ".bars_figure"], f"score_{slug}", slug=slug),
        named_node(
            fix_arguments(picture_labels, method=slug), [".birds_eye_figure", ".perspective_figure"],
            f"picture_{slug}", slug=slug,
        ),
    ]  # fmt: skip


def evaluate_seen(slug: str, answers: counting.LabelNames, *, suffix: str = "") -> list[Node]:
    """Return the nodes that score a method with images, over all points and over those inside images."""
    score = fix_arguments(score_seen_points, method=slug, suffix=suffix)
    return _nodes_of(slug, counting.count_seen_scene, score, answers=dict(answers))


def _nodes_of_labeller(slug: str) -> list[Node]:
    return _nodes_of(slug, counting.count_scene, fix_arguments(score_method, method=slug))


def _nodes_of_detector(slug: str) -> list[Node]:
    return [
        scene_node(
            count_detections_of_scene, f"{slug}.detection_counts", f"count_detections_of_{slug}",
            inputs={"detections": f"{slug}.detections", "parameters": "params:detection"}, over="detections",
            scheme=detection_scheme,
        ),
        named_node(
            fix_arguments(score_detector, method=slug), [".scores", ".precision_recall_figure"], f"score_{slug}",
            slug=slug, counted=".detection_counts",
        ),
        named_node(
            fix_arguments(picture_detections, method=slug), ".detections_figure", f"picture_{slug}", slug=slug
        ),
    ]  # fmt: skip


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: labels and detections of every method to its scores and figures."""
    labellers = [node for slug in methods_of("labelling") for node in _nodes_of_labeller(slug)]
    return Pipeline([*labellers, *(node for slug in methods_of("detection") for node in _nodes_of_detector(slug))])
