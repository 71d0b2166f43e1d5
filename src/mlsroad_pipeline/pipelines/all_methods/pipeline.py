"""Wiring of all methods: the default comparison, the recognisers, the labels through images and their fusion."""

from importlib import import_module

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.compare.nodes import compare_methods
from mlsroad_pipeline.pipelines.methods import EVERYTHING, IMAGE_METHODS, joined
from mlsroad_pipeline.pipelines.report.pipeline import report_on_everything


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: a survey with images to the scores of every method, and one page of them."""
    parts = {name: import_module(f"mlsroad_pipeline.pipelines.{name}").create_pipeline() for name in EVERYTHING}
    images = Node(
        compare_methods,
        inputs=[f"{slug}.scores" for slug in IMAGE_METHODS],
        outputs="image_comparison",
        name="compare_image_methods",
    )
    parts["compare"] = Pipeline([parts["compare"], images])
    return joined({**parts, "report": report_on_everything()})
