"""Pipeline of the labels through images."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.evaluation.pipeline import evaluate_seen
from mlsroad_pipeline.pipelines.image_labels.nodes import find_images, label_scenes, train_network

SLUG = "image_labels"


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes and images to a model, labels of the scenes that it was not trained on, and scores.

    It is no part of the comparison: only surveys with images have it, and training a network takes minutes.
    """
    own, configured = f"params:{SLUG}", ["params:survey", "params:classes"]
    return Pipeline(
        [
            Node(
                find_images,
                inputs=["scenes", own, "params:survey", "params:ingest", "params:classes"],
                outputs=f"{SLUG}.drives",
                name="find_images",
            ),
            Node(
                train_network,
                inputs=[f"{SLUG}.drives", own, *configured],
                outputs=[f"{SLUG}.model", f"{SLUG}.registered_model", f"{SLUG}.objective"],
                name="train_network",
            ),
            Node(
                label_scenes,
                inputs=["scenes", f"{SLUG}.drives", f"{SLUG}.model", own],
                outputs=f"{SLUG}.labels",
                name="label_through_images",
            ),
            *evaluate_seen(SLUG, {SLUG: "label"}),
        ]
    )
