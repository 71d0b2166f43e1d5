"""Pipeline that trains the default model of the package on simulated streets and recordings."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from joblib import cpu_count
from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.core.classes import ClassScheme, find_scheme
from mlsroad_pipeline.algorithms.core.stage_parameters import (
    FeatureParameters,
    GroundParameters,
    StageParameters,
    SupervoxelParameters,
)
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import SLUG, BoostedTreesParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.sampling import coarse_training_voxels, join_voxels
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.familiarity import facts_of_changes, with_familiarity
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.algorithms.models.pool.recorded_graphs import recorded_graphs
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import SLUG as NETWORK
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import SuperpointTransformerParameters
from mlsroad_pipeline.algorithms.quality.scene_facts import stored_facts
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile
from mlsroad_pipeline.model_store.bundle_files import ModelFile
from mlsroad_pipeline.model_store.object_classifiers import VOXELS, replay_arrays
from mlsroad_pipeline.model_store.shipped_entry import ShippedParameters, describe_model, shipped_pool, split_scores
from mlsroad_pipeline.model_store.shipped_models import ShippedModel
from mlsroad_pipeline.pipelines import composition
from mlsroad_pipeline.pipelines.boosted_trees import load_lightgbm
from mlsroad_pipeline.pipelines.per_scene import MODEL, named_node, scene_node
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.pipelines.superpoint_transformer import parameters_of_graphs, stages_of
from mlsroad_pipeline.pipelines.training_facts import FACTS, with_training_facts
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import training_keys
from mlsroad_pipeline.surveys.recordings import TrainingRecording, described_recordings, read_training_scene
from mlsroad_pipeline.surveys.simulated import selected_surveys

REPLAYED = 6000
"""Number of voxels that `mlsroad learn` replays."""


def read_training_recordings(shipped: ShippedParameters, classes: Mapping[str, Any]) -> dict[str, SceneTask]:
    """Create one task per file of a recording that reads it."""
    return {
        f"{name}.{stem}": SceneTask(
            read_training_scene,
            {"path": SourceFile(str(path))},
            {"coding": recording.read_coding(classes["codings"]), "read": dict(recording.read)},
        )
        for name, recording in TrainingRecording.configured(shipped.recordings).items()
        for stem, path in recording.paths(Path(shipped.root)).items()
    }


def recorded_sampling(trees: BoostedTreesParameters, shipped: ShippedParameters) -> BoostedTreesParameters:
    """Return the parameters with which scenes of recordings are sampled."""
    return replace(trees.of_sample(), max_per_class=shipped.recorded_per_class)


def recorded_scheme(shipped: ShippedParameters, classes: Mapping[str, Any]) -> ClassScheme:
    """Return the scheme that the labels of recordings separate."""
    return find_scheme(classes["schemes"], shipped.recorded_scheme)


def train_general_model(
    simulated: SceneCollection,
    recorded: SceneCollection,
    shipped: ShippedParameters,
    parameters: BoostedTreesParameters,
    ground: GroundParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
    checkpoints: Any,
    simulated_facts: SceneCollection,
    recorded_facts: SceneCollection,
) -> tuple[ModelBundle, ModelBundle]:
    """Train the trees on the voxels of simulated streets and recordings."""
    load_lightgbm()
    model = METHODS[SLUG].load("train")(
        [*simulated.load_all().values(), *recorded.load_all().values()],
        parameters=parameters,
        ground=ground,
        scheme=training_scheme(survey, classes),
        trained_on={"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(simulated)},
        sources=["simulated"] * len(simulated) + [key.partition(".")[0] for key in recorded],
        weights=[shipped.weight] * len(simulated) + [1.0] * len(recorded),
        groups=training_scheme(survey, classes).coarsen(recorded_scheme(shipped, classes)).tolist(),
        n_threads=cpu_count(),
        checkpoints=checkpoints,
    )
    model = with_training_facts(model, simulated_facts, recorded_facts)
    return model, model


def train_network(
    simulated: SceneCollection,
    recorded: SceneCollection,
    parameters: SuperpointTransformerParameters,
    ground: GroundParameters,
    supervoxels: SupervoxelParameters,
    features: FeatureParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
    checkpoints: Any,
    simulated_facts: SceneCollection,
    recorded_facts: SceneCollection,
) -> tuple[ModelBundle, ModelBundle, pd.DataFrame]:
    """Train the network on the graphs of simulated streets and recordings."""
    model, losses = METHODS[NETWORK].load("train")(
        [graph for store in (simulated, recorded) for views in store.load_all().values() for graph in views.values()],
        parameters=parameters,
        stages=StageParameters(ground, supervoxels, features),
        scheme=training_scheme(survey, classes),
        trained_on={"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(simulated)},
        checkpoints=checkpoints,
    )
    model = with_training_facts(model, simulated_facts, recorded_facts)
    return model, model, pd.DataFrame({"step": range(len(losses)), "loss": losses})


def draw_replay(
    simulated: SceneCollection, parameters: BoostedTreesParameters, survey: SurveyParameters, classes: Mapping[str, Any]
) -> dict[str, dict[str, Any]]:
    """Draw voxels of simulated streets in proportion to their training weights, which `mlsroad learn` replays."""
    scheme = training_scheme(survey, classes)
    values, allowed, weight = join_voxels(list(simulated.load_all().values()), scheme=scheme, prior=parameters.prior)
    rows = np.random.default_rng(2026).choice(
        len(values), min(REPLAYED, len(values)), replace=False, p=weight / weight.sum()
    )
    return {VOXELS.name: replay_arrays(values[rows], allowed[rows], scheme.classes)}


def ship_general_model(
    model: ModelFile,
    network: ModelFile,
    scores: pd.DataFrame,
    shipped: ShippedParameters,
    simulation: Mapping[str, Any],
    recorded: SceneCollection,
    simulated_changes: SceneCollection,
    recorded_changes: SceneCollection,
) -> tuple[tuple[ModelBundle, ShippedModel], tuple[ModelBundle, ShippedModel]]:
    """Return the trees and the pool of trees and network, each with its registry entry."""
    tables = [*simulated_changes.load_all().values(), *recorded_changes.load_all().values()]
    sources = ["simulated"] * len(simulated_changes) + [key.partition(".")[0] for key in recorded_changes]
    bundle = with_familiarity(model.load(), tables, sources)
    training = {name: dict(street) for name, street in selected_surveys(simulation).items() if name.startswith("train")}
    entry = describe_model(
        bundle, shipped, training=training, scores=split_scores(scores, shipped.command()),
        recordings=described_recordings(shipped.recordings, recorded),
    )  # fmt: skip
    return (bundle, entry), shipped_pool(bundle, entry, network.load(), shipped)


_SEED = 2026
_BEFORE = ("simulate", "ingest", "ground_removal", "supervoxelise", "features")
_GROUND, _TREES, _SHIPPED = "params:ground_removal", f"params:{SLUG}", "params:shipped"


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: boosted trees, also on recordings, scored; a network; then the files of both models."""
    parts = composition.joined(
        {name: composition.create_pipeline(name) for name in _BEFORE}
        | {SLUG: _trees(), NETWORK: _network(), "evaluation": composition.create_pipeline("evaluation")}
    )
    inputs = {
        "network": f"{NETWORK}.model", "scores": ".scores", "recorded": "general_model.scenes",
        "simulated_changes": "general_model.simulated_changes", "recorded_changes": "general_model.recorded_changes",
    }  # fmt: skip
    ship = named_node(ship_general_model, ["shipped_model", "shipped_pool"], slug=SLUG, **inputs)
    replay = named_node(draw_replay, "shipped_replay", slug=SLUG, simulated=".training_set")
    changes = [
        scene_node(
            facts_of_changes, f"general_model.{name}_changes", f"describe_{name}_changes",
            inputs={"scene": scenes, "ground": _GROUND}, keys=keys, fixed={"seed": _SEED},
        )
        for name, scenes, keys in (
            ("simulated", "scenes", training_keys),
            ("recorded", "general_model.scenes", list),
        )
    ]  # fmt: skip
    return Pipeline([parts.to_outputs(f"{SLUG}.scores", f"{NETWORK}.model"), ship, replay, *changes])


def _trees() -> Pipeline:
    """Return the pipeline of the method with another training, which takes recordings too."""
    own = composition.create_pipeline(SLUG)
    kept = own.filter(node_names=[node.name for node in own.nodes if f"{SLUG}.model" not in node.outputs])
    recorded = {"recorded": "general_model.training_set", "recorded_facts": "general_model.training_facts"}
    simulated = {"simulated": ".training_set", "simulated_facts": FACTS}
    return Pipeline(
        [
            kept,
            named_node(read_training_recordings, "general_model.scenes"),
            scene_node(
                coarse_training_voxels, "general_model.training_set", "draw_recorded_voxels",
                inputs={"scene": "general_model.scenes", "filtered": _GROUND, "trees": _TREES, "shipped": _SHIPPED},
                own=recorded_sampling, scheme=training_scheme, coarse=recorded_scheme,
            ),
            scene_node(
                stored_facts, "general_model.training_facts", "describe_training_recordings",
                inputs={"cloud": "general_model.scenes"},
            ),
            named_node(train_general_model, MODEL, slug=SLUG, **simulated, **recorded),
        ]
    )  # fmt: skip


def _network() -> Pipeline:
    """Return the pipeline of the network with another training, which takes recordings too."""
    own = composition.create_pipeline(NETWORK).to_outputs(f"{NETWORK}.training_set")
    return Pipeline(
        [
            *own.nodes,
            scene_node(
                recorded_graphs, "general_model.graphs", "build_recorded_graphs",
                inputs={
                    "scene": "general_model.scenes", "trees": f"{SLUG}.model", "own": f"params:{NETWORK}",
                    "shipped": _SHIPPED, "ground_removal": _GROUND, "supervoxelise": "params:supervoxelise",
                    "description": "params:features",
                },
                parameters=parameters_of_graphs, stages=stages_of, scheme=training_scheme, coarse=recorded_scheme,
            ),
            named_node(
                train_network, [*MODEL, ".objective"], "train_general_network", slug=NETWORK,
                simulated=".training_set", recorded="general_model.graphs", simulated_facts=FACTS,
                recorded_facts="general_model.training_facts",
            ),
        ]
    )  # fmt: skip
