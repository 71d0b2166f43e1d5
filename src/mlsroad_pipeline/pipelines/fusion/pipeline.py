"""Pipeline of the fusion."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.evaluation.pipeline import evaluate_seen
from mlsroad_pipeline.pipelines.fusion.nodes import fuse_scenes, learn_fusion, take_test_set_1

SLUG = "fusion"
ANSWERS = {
    "fusion": "label",
    "fusion_pool": "pool_label",
    "detrended_forest": "feature_label",
    "image_labels": "image_label",
}
"""Methods scored on test set 2, and the names of their labels in the store."""


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: labels of both methods to a model, trained on test set 1, and scores on test set 2.

    Like `image_labels`, without which it cannot run, it is no part of the comparison.
    """
    own, configured = f"params:{SLUG}", ["params:survey", "params:classes"]
    both = ["detrended_forest.labels", "image_labels.labels"]
    return Pipeline(
        [
            Node(
                take_test_set_1,
                inputs=["scenes", *both, own, *configured],
                outputs=f"{SLUG}.training_set",
                name="take_test_set_1",
            ),
            Node(
                learn_fusion,
                inputs=[f"{SLUG}.training_set", "detrended_forest.model", "image_labels.model", own, *configured],
                outputs=[f"{SLUG}.model", f"{SLUG}.registered_model"],
                name="learn_fusion",
            ),
            Node(fuse_scenes, inputs=[*both, f"{SLUG}.model", own], outputs=f"{SLUG}.labels", name="fuse_scenes"),
            *evaluate_seen(SLUG, ANSWERS, suffix="2"),
        ]
    )
