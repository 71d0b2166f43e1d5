"""Pipeline of the superpoint transformer."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.models.superpoint_transformer.labeller import label_scene
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import SLUG
from mlsroad_pipeline.algorithms.models.superpoint_transformer.training_graphs import training_graphs
from mlsroad_pipeline.pipelines.per_scene import PerScene
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.pipelines.superpoint_transformer.nodes import parameters_of_graphs, stages_of, train_network
from mlsroad_pipeline.pipelines.training_facts import FACTS, describing
from mlsroad_pipeline.surveys.plan import held_out_keys, training_keys


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: graphs of superpoints to a model, and to labels of the scenes it was not trained on."""
    prepared = {name: name for name in ("ground", "supervoxels")} | {
        "scene": "scenes",
        "features": "supervoxel_features",
    }
    own, stages = f"params:{SLUG}", ["params:ground_removal", "params:supervoxelise", "params:features"]
    configured = {"survey": "params:survey", "classes": "params:classes"}
    return Pipeline(
        [
            describing(),
            Node(
                PerScene(
                    training_graphs,
                    keys=training_keys,
                    parameters=parameters_of_graphs,
                    stages=stages_of,
                    scheme=training_scheme,
                ),
                inputs={
                    **prepared,
                    "own": own,
                    **dict(zip(("ground_removal", "supervoxelise", "description"), stages, strict=True)),
                    **configured,
                },
                outputs=f"{SLUG}.training_set",
                name="build_training_graphs",
            ),
            Node(
                train_network,
                inputs=[f"{SLUG}.training_set", own, *stages, *configured.values(), f"{SLUG}.checkpoints", FACTS],
                outputs=[f"{SLUG}.model", f"{SLUG}.registered_model", f"{SLUG}.objective"],
                name=f"train_{SLUG}",
            ),
            Node(
                PerScene(label_scene, keys=held_out_keys),
                inputs={**prepared, "bundle": f"{SLUG}.model"},
                outputs=f"{SLUG}.labels",
                name=f"label_by_{SLUG}",
            ),
        ]
    )
