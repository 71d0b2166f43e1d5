"""Pipeline of the multiscale forest."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.baselines.multiscale_forest.labeller import label_scene
from mlsroad_pipeline.algorithms.baselines.multiscale_forest.parameters import SLUG
from mlsroad_pipeline.algorithms.baselines.multiscale_forest.training import training_spheres
from mlsroad_pipeline.pipelines.multiscale_forest.nodes import train_multiscale_forest
from mlsroad_pipeline.pipelines.per_scene import PerScene
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.pipelines.training_facts import FACTS, describing
from mlsroad_pipeline.surveys.plan import held_out_keys, training_keys


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes to a model, and to labels of the scenes that it was not trained on."""
    configured = {"survey": "params:survey", "classes": "params:classes"}
    return Pipeline(
        [
            describing(),
            Node(
                PerScene(training_spheres, keys=training_keys, scheme=training_scheme),
                inputs={"scene": "scenes", "own": f"params:{SLUG}", **configured},
                outputs=f"{SLUG}.training_set",
                name="draw_training_spheres",
            ),
            Node(
                train_multiscale_forest,
                inputs=[f"{SLUG}.training_set", f"params:{SLUG}", *configured.values(), FACTS],
                outputs=[f"{SLUG}.model", f"{SLUG}.registered_model"],
                name=f"train_{SLUG}",
            ),
            Node(
                PerScene(label_scene, keys=held_out_keys),
                inputs={"scene": "scenes", "bundle": f"{SLUG}.model"},
                outputs=f"{SLUG}.labels",
                name=f"label_by_{SLUG}",
            ),
        ]
    )
