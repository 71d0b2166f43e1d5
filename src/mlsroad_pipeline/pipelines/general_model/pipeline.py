"""Pipeline of the models for all surveys: simulated streets and recordings to trained models in the package."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.baselines.boosted_trees.parameters import SLUG
from mlsroad_pipeline.algorithms.baselines.boosted_trees.sampling import coarse_training_voxels
from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.parameters import SLUG as NETWORK
from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.training_graphs import coarse_training_graphs
from mlsroad_pipeline.algorithms.quality.scene_facts import stored_facts
from mlsroad_pipeline.pipelines import composition
from mlsroad_pipeline.pipelines.general_model.nodes import (
    read_training_recordings,
    recorded_sampling,
    recorded_scheme,
    ship_general_model,
    train_general_model,
    train_general_network,
)
from mlsroad_pipeline.pipelines.per_scene import PerScene
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.pipelines.superpoint_transformer.nodes import parameters_of_graphs, stages_of
from mlsroad_pipeline.pipelines.training_facts import FACTS

_BEFORE = ("simulate", "ingest", "ground_removal", "supervoxelise", "features")
_GROUND, _TREES, _SHIPPED = "params:ground_removal", f"params:{SLUG}", "params:shipped"
_STAGES = {"ground_removal": _GROUND, "supervoxelise": "params:supervoxelise", "description": "params:features"}
_CONFIGURED = {"survey": "params:survey", "classes": "params:classes"}


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: boosted trees, scored, and a network, both also on recordings; then the files of both."""
    parts = composition.joined(
        {name: composition.create_pipeline(name) for name in _BEFORE}
        | {SLUG: _trees(), NETWORK: _network(), "evaluation": composition.create_pipeline("evaluation")}
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
    draw = PerScene(coarse_training_voxels, own=recorded_sampling, scheme=training_scheme, coarse=recorded_scheme)
    return Pipeline(
        [
            kept,
            Node(
                read_training_recordings,
                [_SHIPPED, _CONFIGURED["classes"]],
                "general_model.scenes",
                name="read_training_recordings",
            ),
            Node(
                draw,
                {"scene": "general_model.scenes", "filtered": _GROUND, "trees": _TREES, "shipped": _SHIPPED}
                | _CONFIGURED,
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
                    *_CONFIGURED.values(), f"{SLUG}.checkpoints", FACTS, "general_model.training_facts",
                ],
                [f"{SLUG}.model", f"{SLUG}.registered_model"],
                name="train_general_model",
            ),
        ]
    )  # fmt: skip


def _network() -> Pipeline:
    """Return the pipeline of the network up to its model, with another training, which takes recordings too."""
    own = composition.create_pipeline(NETWORK).to_outputs(f"{NETWORK}.model")
    kept = own.filter(node_names=[node.name for node in own.nodes if f"{NETWORK}.model" not in node.outputs])
    build = PerScene(
        coarse_training_graphs,
        parameters=parameters_of_graphs,
        stages=stages_of,
        scheme=training_scheme,
        coarse=recorded_scheme,
    )
    return Pipeline(
        [
            kept,
            Node(
                build,
                {"scene": "general_model.scenes", "own": f"params:{NETWORK}", "shipped": _SHIPPED}
                | _STAGES
                | _CONFIGURED,
                "general_model.training_graphs",
                name="build_recorded_graphs",
            ),
            Node(
                train_general_network,
                [
                    f"{NETWORK}.training_set", "general_model.training_graphs", _SHIPPED, f"params:{NETWORK}",
                    *_STAGES.values(), *_CONFIGURED.values(), f"{NETWORK}.checkpoints", FACTS,
                    "general_model.training_facts",
                ],
                [f"{NETWORK}.model", f"{NETWORK}.registered_model", f"{NETWORK}.objective"],
                name="train_general_network",
            ),
        ]
    )  # fmt: skip
