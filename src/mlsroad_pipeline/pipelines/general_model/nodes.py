"""Nodes of the default model of the package."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
from joblib import cpu_count

from mlsroad_pipeline.algorithms.core.classes import ClassScheme, find_scheme
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import SLUG, BoostedTreesParameters
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile
from mlsroad_pipeline.model_store.bundle_files import ModelFile
from mlsroad_pipeline.model_store.shipped_entry import (
    ShippedParameters,
    describe_model,
    shipped_pool,
    split_scores,
)
from mlsroad_pipeline.model_store.shipped_models import ShippedModel
from mlsroad_pipeline.pipelines.boosted_trees.nodes import load_lightgbm
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.pipelines.training_facts import with_training_facts
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.recording_scenes import read_training_scene
from mlsroad_pipeline.surveys.simulated import selected_surveys
from mlsroad_pipeline.surveys.training_recordings import TrainingRecording, described_recordings


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


def ship_general_model(
    model: ModelFile,
    network: ModelFile,
    scores: pd.DataFrame,
    shipped: ShippedParameters,
    simulation: Mapping[str, Any],
    recorded: SceneCollection,
) -> tuple[tuple[ModelBundle, ShippedModel], tuple[ModelBundle, ShippedModel]]:
    """Return the trees and the pool of trees and network, each with its registry entry."""
    bundle = model.load()
    training = {name: dict(street) for name, street in selected_surveys(simulation).items() if name.startswith("train")}
    entry = describe_model(
        bundle, shipped, training=training, scores=split_scores(scores, shipped.command()),
        recordings=described_recordings(shipped.recordings, recorded),
    )  # fmt: skip
    return (bundle, entry), shipped_pool(bundle, entry, network.load(), shipped)
