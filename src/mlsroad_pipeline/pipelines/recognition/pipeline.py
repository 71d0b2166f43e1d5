"""Pipeline of the recognition of objects."""

from __future__ import annotations

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.papers.shared.recognition.cutting import cut_objects
from mlsroad_pipeline.pipelines.compare.nodes import compare_methods
from mlsroad_pipeline.pipelines.per_scene import PerScene, fix_arguments
from mlsroad_pipeline.pipelines.recognisers import create_pipeline as recogniser_pipeline
from mlsroad_pipeline.pipelines.recognition.nodes import read_object_folds, score_recogniser
from mlsroad_pipeline.pipelines.schemes import recognition_scheme


def train_recognisers() -> Pipeline:
    """Return the pipelines of all recognisers."""
    return sum((recogniser_pipeline(slug) for slug in methods_of("recognition")), Pipeline([]))


def score_recognisers() -> Pipeline:
    """Return the pipeline that scores all recognisers and compares them in a table."""
    scores = [
        Node(
            fix_arguments(score_recogniser, method=slug),
            inputs=["object_sets", f"{slug}.recognitions", "params:recognition", "params:classes"],
            outputs=[f"{slug}.scores", f"{slug}.confusion_figure"],
            name=f"score_{slug}",
        )
        for slug in methods_of("recognition")
    ]
    compared = Node(
        compare_methods,
        inputs=[f"{slug}.scores" for slug in methods_of("recognition")],
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
        PerScene(cut_objects, scheme=recognition_scheme),
        inputs={
            "scene": "scenes",
            "objects": "objects",
            "parameters": "params:recognition",
            "classes": "params:classes",
        },
        outputs="object_sets",
        name="cut_objects_of_scenes",
    )
    return Pipeline([cut]) + train_recognisers() + score_recognisers()
