"""Wiring of what all recognisers share, and of one recogniser."""

from __future__ import annotations

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.compare.nodes import compare_methods
from mlsroad_pipeline.pipelines.methods import RECOGNISERS, fix_arguments
from mlsroad_pipeline.pipelines.recognition.nodes import (
    cut_objects_of_scenes,
    read_object_folds,
    recognise_sets,
    score_recogniser,
    training_node,
)

PARAMETERS = {"hssi_net": "jointnet", "vqai_net": "jointnet", "vaai_net": "jointnet"}
"""Methods that take the parameters of another."""


def recogniser_pipeline(slug: str) -> Pipeline:
    """Return the pipeline of one recogniser."""
    own, configured = f"params:{PARAMETERS.get(slug, slug)}", ["params:recognition"]
    stages = ["params:ground_removal", "params:segmentation", "params:survey", "params:classes"]
    return Pipeline(
        [
            Node(
                training_node(slug),
                inputs=["object_sets", own, *configured, *stages],
                outputs=[f"{slug}.model", f"{slug}.registered_model"],
                name=f"train_{slug}",
            ),
            Node(
                fix_arguments(recognise_sets, method=slug),
                inputs=["object_sets", f"{slug}.model", own, *configured, "params:classes"],
                outputs=f"{slug}.recognitions",
                name=f"recognise_with_{slug}",
            ),
        ]
    )


def score_recognisers() -> Pipeline:
    """Return the pipeline that scores all recognisers and puts them into one table."""
    scores = [
        Node(
            fix_arguments(score_recogniser, method=slug),
            inputs=["object_sets", f"{slug}.recognitions", "params:recognition", "params:classes"],
            outputs=[f"{slug}.scores", f"{slug}.confusion_figure"],
            name=f"score_{slug}",
        )
        for slug in RECOGNISERS
    ]
    compared = Node(
        compare_methods,
        inputs=[f"{slug}.scores" for slug in RECOGNISERS],
        outputs="recognition_comparison",
        name="compare_recognisers",
    )
    return Pipeline([*scores, compared])


def read_folds() -> Pipeline:
    """Return the pipeline that reads objects from files: the survey's root to ``object_sets``."""
    return Pipeline(
        [
            Node(
                read_object_folds,
                inputs=["params:survey", "params:recognition", "params:classes"],
                outputs="object_sets",
                name="read_object_folds",
            )
        ]
    )


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes and their objects to sets of objects, and these to the scores of all recognisers."""
    cut = Node(
        cut_objects_of_scenes,
        inputs=["scenes", "objects", "params:recognition", "params:classes"],
        outputs="object_sets",
        name="cut_objects_of_scenes",
    )
    methods: list[Pipeline] = [recogniser_pipeline(slug) for slug in RECOGNISERS]
    return sum([*methods, score_recognisers()], Pipeline([cut]))
