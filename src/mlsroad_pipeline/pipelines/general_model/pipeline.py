"""Pipeline of the models for all surveys: simulated streets and recordings to trained models in the package."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import SLUG
from mlsroad_pipeline.algorithms.models.boosted_trees.sampling import coarse_training_voxels
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import SLUG as NETWORK
from mlsroad_pipeline.algorithms.quality.scene_facts import stored_facts
from mlsroad_pipeline.pipelines import composition
from mlsroad_pipeline.pipelines.general_model.nodes import (
    read_training_recordings,
    recorded_sampling,
    recorded_scheme,
    ship_general_model,
    train_general_model,
)
from mlsroad_pipeline.pipelines.per_scene import PerScene
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.pipelines.training_facts import FACTS

_BEFORE = ("simulate", "ingest", "ground_removal", "supervoxelise", "features")
_GROUND, _TREES, _SHIPPED = "params:ground_removal", f"params:{SLUG}", "params:shipped"


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: boosted trees, also on recordings, scored; a network; then the files of both models."""
    network = composition.create_pipeline(NETWORK).to_outputs(f"{NETWORK}.model")
    parts = composition.joined(
        {name: composition.create_pipeline(name) for name in _BEFORE}
        | {SLUG: _trees(), NETWORK: network, "evaluation": composition.create_pipeline("evaluation")}
    )
    ship = Node(
        ship_general_model,
        [
            f"{SLUG}.model", f"{NETWORK}.model", f"{SLUG}.scores", _SHIPPED, "params:simulation",
            "general_model.scenes",
        ],
        ["shipped_model", "shipped_pool"],
        name="ship_general_model",
    )  # fmt: skip
    return Pipeline([parts.to_outputs(f"{SLUG}.scores", f"{NETWORK}.model"), ship])


def _trees() -> Pipeline:
    """Return the pipeline of the method with another training, which takes recordings too."""
    own = composition.create_pipeline(SLUG)
    kept = own.filter(node_names=[node.name for node in own.nodes if f"{SLUG}.model" not in node.outputs])
    configured = {"survey": "params:survey", "classes": "params:classes"}
    draw = PerScene(coarse_training_voxels, own=recorded_sampling, scheme=training_scheme, coarse=recorded_scheme)
    return Pipeline(
        [
            kept,
            Node(
                read_training_recordings,
                [_SHIPPED, configured["classes"]],
                "general_model.scenes",
                name="read_training_recordings",
            ),
            Node(
                draw,
                {"scene": "general_model.scenes", "filtered": _GROUND, "trees": _TREES, "shipped": _SHIPPED}
                | configured,
                "general_model.training_set",
                name="draw_recorded_voxels",
            ),
            Node(
                PerScene(stored_facts),
                {"cloud": "general_model.scenes"},
                "general_model.training_facts",
                name="describe_training_recordings",
            ),
            Node(
                train_general_model,
                [
                    f"{SLUG}.training_set", "general_model.training_set", _SHIPPED, _TREES, _GROUND,
                    *configured.values(), f"{SLUG}.checkpoints", FACTS, "general_model.training_facts",
                ],
                [f"{SLUG}.model", f"{SLUG}.registered_model"],
                name="train_general_model",
            ),
        ]
    )  # fmt: skip
