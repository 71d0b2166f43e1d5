"""All labellers, detectors and recognisers on one survey."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.pipelines import composition
from mlsroad_pipeline.pipelines.compare import compare_methods
from mlsroad_pipeline.pipelines.report import report_on_everything


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: a survey with images to the scores of every method and a report."""
    parts = {name: composition.create_pipeline(name) for name in composition.all_parts()}
    images = Node(
        compare_methods,
        [f"{slug}.scores" for slug in methods_of("labelling", needs_images=True)],
        "image_comparison",
        name="compare_image_methods",
    )
    parts["compare"] = Pipeline([parts["compare"], images])
    return composition.joined({**parts, "report": report_on_everything()})
