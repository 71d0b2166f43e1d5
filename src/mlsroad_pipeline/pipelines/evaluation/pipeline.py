"""Wiring of the evaluation: the same nodes for every labeller, and the same for every detector."""

from collections.abc import Mapping

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.evaluation.nodes import (
    count_detections,
    count_points,
    count_seen_points,
    picture_detections,
    picture_labels,
    score_detector,
    score_method,
    score_seen_points,
)
from mlsroad_pipeline.pipelines.methods import DETECTORS, LABELLERS, fix_arguments


def _nodes_of(slug: str) -> list[Node]:
    configured = ["params:survey", "params:classes"]
    return [
        Node(
            count_points,
            inputs=["scenes", f"{slug}.labels", *configured],
            outputs=f"{slug}.confusions",
            name=f"count_points_of_{slug}",
        ),
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


def evaluate_seen(slug: str, answers: Mapping[str, str], *, suffix: str = "") -> list[Node]:
    """Return the nodes that score a method which uses images, over all points and over those that cameras see."""
    configured = ["params:survey", "params:classes"]
    return [
        Node(
            fix_arguments(count_seen_points, answers=dict(answers)),
            inputs=["scenes", f"{slug}.labels", *configured],
            outputs=f"{slug}.confusions",
            name=f"count_points_of_{slug}",
        ),
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
            count_detections,
            inputs=["scenes", "objects", f"{slug}.detections", "params:detection", "params:classes"],
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
    """Return the pipeline: labels of every method to its scores and figures."""
    labellers = [node for slug in LABELLERS for node in _nodes_of(slug)]
    return Pipeline([*labellers, *(node for slug in DETECTORS for node in _nodes_of_detector(slug))])
