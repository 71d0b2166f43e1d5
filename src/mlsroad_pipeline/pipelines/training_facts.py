"""Facts of the training scenes, which labellers store with their models."""

from __future__ import annotations

from dataclasses import replace

from kedro.pipeline import Node

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.quality.scene_facts import stored_facts, training_facts
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.pipelines.per_scene import PerScene
from mlsroad_pipeline.surveys.plan import training_keys

FACTS = "training_facts"
"""Catalog entry of the facts of the training scenes."""


def describing() -> Node:
    """Return the node that describes the training scenes; the pipelines of labellers share it."""
    describe = PerScene(stored_facts, keys=training_keys)
    return Node(describe, {"cloud": "scenes"}, FACTS, name="describe_training_scenes")


def with_training_facts(bundle: ModelBundle, *scenes: SceneCollection) -> ModelBundle:
    """Return a model whose metadata have the ranges of the facts of the training scenes."""
    stored = [scene for collection in scenes for scene in collection.load_all().values()]
    facts = [{name: float(value) for name, value in scene.items()} for scene in stored]
    return replace(bundle, metadata={**bundle.metadata, FACTS: training_facts(facts)})
