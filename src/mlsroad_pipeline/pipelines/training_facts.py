"""Nodes of all labellers: the facts of the training scenes, which models store, and the labels of the other scenes."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from kedro.pipeline import Node

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.quality.scene_facts import stored_facts, training_facts
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.pipelines.per_scene import scene_node
from mlsroad_pipeline.surveys.plan import held_out_keys, training_keys

FACTS = "training_facts"
"""Catalog entry of the facts of the training scenes."""


def describing() -> Node:
    """Return the node that describes the training scenes; the pipelines of labellers share it."""
    return scene_node(stored_facts, FACTS, "describe_training_scenes", inputs={"cloud": "scenes"}, keys=training_keys)


def labelling(function: Callable[..., Any], slug: str, name: str = "", **options: Any) -> Node:
    """Return the node that labels the scenes that a method was not trained on."""
    model, labels = {"bundle": f"{slug}.model"}, f"{slug}.labels"
    return scene_node(function, labels, name or f"label_by_{slug}", inputs=model, keys=held_out_keys, **options)


def with_training_facts(bundle: ModelBundle, *scenes: SceneCollection) -> ModelBundle:
    """Return a model whose metadata have the ranges of the facts of the training scenes."""
    stored = [scene for collection in scenes for scene in collection.load_all().values()]
    facts = [{name: float(value) for name, value in scene.items()} for scene in stored]
    return replace(bundle, metadata={**bundle.metadata, FACTS: training_facts(facts)})
