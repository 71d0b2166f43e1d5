"""Pipeline of the evaluation, the same nodes for every labeller and for every detector."""

from collections.abc import Callable
from typing import Any

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.papers.shared.detection.scoring import count_detections_of_scene
from mlsroad_pipeline.papers.shared.evaluation.labelling import count_scene
from mlsroad_pipeline.papers.shared.evaluation.visibility import LabelNames, count_seen_scene
from mlsroad_pipeline.pipelines.evaluation.nodes import (
    picture_detections,
    picture_labels,
    score_detector,
    score_method,
    score_seen_points,
)
from mlsroad_pipeline.pipelines.per_scene import PerScene, fix_arguments
from mlsroad_pipeline.pipelines.schemes import detection_scheme, evaluation_scheme, training_scheme


def _counting(slug: str, function: Callable[..., Any], **fixed: Any) -> Node:
    """Return the node that counts the points of each labelled scene by true and predicted class."""
    count = PerScene(function, over="labels", fixed=fixed, trained=training_scheme, scored=evaluation_scheme)
    return Node(
        count,
        inputs={
            "scene": "scenes",
            "labels": f"{slug}.labels",
            "survey": "params:survey",
            "classes": "params:classes",
        },
        outputs=f"{slug}.confusions",
        name=f"count_points_of_{slug}",
    )


def _nodes_of(slug: str) -> list[Node]:
    configured = ["params:survey", "params:classes"]
    return [
        _counting(slug, count_scene),
        Node(
            fix_arguments(score_method, method=slug),
            inputs=[f"{slug}.confusions", f"{slug}.model", *configured],
            outputs=[f"{slug}.scores", f"{slug}.confusion_figure", f"{slug}.bars_figure"],
            name=f"score_{slug}",
        ),
        _picturing(slug),
    ]


def _picturing(slug: str) -> Node:
    return Node(
        fix_arguments(picture_labels, method=slug),
        inputs=["scenes", f"{slug}.labels", "params:survey", "params:classes"],
        outputs=[f"{slug}.birds_eye_figure", f"{slug}.perspective_figure"],
        name=f"picture_{slug}",
    )


def evaluate_seen(slug: str, answers: LabelNames, *, suffix: str = "") -> list[Node]:
    """Return the nodes that score a method with images, over all points and over those inside images."""
    configured = ["params:survey", "params:classes"]
    return [
        _counting(slug, count_seen_scene, answers=dict(answers)),
        Node(
            fix_arguments(score_seen_points, method=slug, suffix=suffix),
            inputs=[f"{slug}.confusions", *configured],
            outputs=[f"{slug}.scores", f"{slug}.confusion_figure", f"{slug}.bars_figure"],
            name=f"score_{slug}",
        ),
        _picturing(slug),
    ]


def _nodes_of_detector(slug: str) -> list[Node]:
    return [
        Node(
            PerScene(count_detections_of_scene, over="detections", scheme=detection_scheme),
            inputs={
                "scene": "scenes",
                "objects": "objects",
                "detections": f"{slug}.detections",
                "parameters": "params:detection",
                "classes": "params:classes",
            },
            outputs=f"{slug}.detection_counts",
            name=f"count_detections_of_{slug}",
        ),
        Node(
            fix_arguments(score_detector, method=slug),
            inputs=[f"{slug}.detection_counts", "params:detection"],
            outputs=[f"{slug}.scores", f"{slug}.precision_recall_figure"],
            name=f"score_{slug}",
        ),
        Node(
            fix_arguments(picture_detections, method=slug),
            inputs=["scenes", "objects", f"{slug}.detections", "params:detection", "params:classes"],
            outputs=f"{slug}.detections_figure",
            name=f"picture_{slug}",
        ),
    ]


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: labels and detections of every method to its scores and figures."""
    labellers = [node for slug in methods_of("labelling") for node in _nodes_of(slug)]
    return Pipeline([*labellers, *(node for slug in methods_of("detection") for node in _nodes_of_detector(slug))])
