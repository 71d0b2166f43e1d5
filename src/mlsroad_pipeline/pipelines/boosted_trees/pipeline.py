"""Pipeline of the boosted trees."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import label_scene
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import SLUG
from mlsroad_pipeline.algorithms.models.boosted_trees.sampling import training_voxels
from mlsroad_pipeline.pipelines.boosted_trees.nodes import sample_of, train_boosted_trees
from mlsroad_pipeline.pipelines.per_scene import PerScene
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.pipelines.training_facts import FACTS, describing
from mlsroad_pipeline.surveys.plan import held_out_keys, training_keys


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: ground to a model, and to labels of the scenes that it was not trained on."""
    prepared, own = {"scene": "scenes", "ground": "ground"}, f"params:{SLUG}"
    configured = {"survey": "params:survey", "classes": "params:classes"}
    return Pipeline(
        [
            describing(),
            Node(
                PerScene(training_voxels, keys=training_keys, parameters=sample_of, scheme=training_scheme),
                inputs={**prepared, "own": own, **configured},
                outputs=f"{SLUG}.training_set",
                name="draw_training_voxels",
            ),
            Node(
                train_boosted_trees,
                inputs=[
                    f"{SLUG}.training_set", own, "params:ground_removal", *configured.values(), f"{SLUG}.checkpoints",
                    FACTS,
                ],
                outputs=[f"{SLUG}.model", f"{SLUG}.registered_model"],
                name=f"train_{SLUG}",
            ),
            Node(
                PerScene(label_scene, keys=held_out_keys),
                inputs={**prepared, "bundle": f"{SLUG}.model"},
                outputs=f"{SLUG}.labels",
                name=f"label_by_{SLUG}",
            ),
        ]
    )  # fmt: skip
