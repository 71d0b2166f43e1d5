"""Pipeline of all methods: the default comparison, the recognisers, the labels through images and their fusion."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.pipelines import composition
from mlsroad_pipeline.pipelines.compare.nodes import compare_methods
from mlsroad_pipeline.pipelines.report.pipeline import report_on_everything


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: a survey with images to the scores of every method and a report."""
    parts = {name: composition.create_pipeline(name) for name in composition.all_parts()}
    images = Node(
        compare_methods,
        inputs=[f"{slug}.scores" for slug in methods_of("labelling", needs_images=True)],
        outputs="image_comparison",
        name="compare_image_methods",
    )
    parts["compare"] = Pipeline([parts["compare"], images])
    return composition.joined({**parts, "report": report_on_everything()})
