"""Node functions that create one task per scene."""

import inspect
import typing
from dataclasses import dataclass

import numpy as np
import pytest
from kedro.pipeline import Node

from mlsroad_pipeline.datasets.scene_store_dataset import SceneStoreDataset
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.model_store.bundle_files import ModelFile
from mlsroad_pipeline.pipelines.per_scene import PerScene, fix_arguments


@dataclass(frozen=True)
class Size:
    width: float = 1.0


@dataclass(frozen=True)
class Options:
    factor: float = 2.0


def measure(scene: dict, other: dict, bundle: object, *, size: Size, factor: float, kind: str, rounds: int = 3) -> dict:
    """Take all kinds of arguments."""
    return {"value": np.array(size.width * factor * rounds)}


def factor_of(options: Options) -> float:
    """Derive an argument."""
    return options.factor


def first(keys):
    return list(keys)[:1]


@pytest.fixture
def stores():
    stores = {"scenes": "abc", "others": "bc"}
    for name, keys in stores.items():
        dataset = SceneStoreDataset(filepath=f"memory://per_scene/{name}", execution={"backend": "sequential"})
        dataset.save({key: SceneTask(dict, parameters={"x": np.zeros(1)}) for key in keys})
        stores[name] = dataset.load()
    return stores


def test_the_signature_is_that_of_the_function_without_what_is_fixed_or_derived():
    tasks = PerScene(measure, fixed={"kind": "k"}, factor=factor_of)
    assert list(inspect.signature(tasks, follow_wrapped=False).parameters) == [
        "scene", "other", "bundle", "size", "options",
    ]  # fmt: skip
    hints = typing.get_type_hints(tasks)
    assert (hints["size"], hints["options"]) == (Size, Options) and "return" not in hints
    inputs = {"options": "params:options", "scene": "scenes", "size": "params:size", "other": "o", "bundle": "m"}
    node = Node(tasks, inputs=inputs, outputs="out")
    assert node.inputs == ["scenes", "o", "m", "params:size", "params:options"] and "measure" in str(node)
    with pytest.raises(TypeError, match="Inputs of 'measure' function expected"):
        Node(tasks, inputs={"scene": "scenes"}, outputs="out")


def test_stores_and_models_are_inputs_and_all_else_is_a_parameter(stores):
    tasks = PerScene(measure, over="other", fixed={"kind": "k"}, factor=factor_of)
    model = ModelFile("folder")
    made = tasks(stores["scenes"], stores["others"], model, Size(3.0), options=Options(5.0))
    assert list(made) == ["b", "c"] and made["b"].function is measure
    assert made["b"].inputs == {"scene": stores["scenes"]["b"], "other": stores["others"]["b"], "bundle": model}
    assert made["c"].parameters == {"size": Size(3.0), "factor": 5.0, "kind": "k"}


def test_scenes_are_those_of_the_first_store_and_may_be_selected(stores):
    arguments = {"scene": stores["others"], "other": stores["scenes"], "bundle": None, "size": Size(), "factor": 1.0}
    assert list(PerScene(measure, fixed={"kind": "k"})(**arguments)) == ["b", "c"]
    assert list(PerScene(measure, keys=first, fixed={"kind": "k"})(**arguments)) == ["b"]


def test_fixed_arguments_keep_name_and_annotations():
    fixed = fix_arguments(measure, kind="k", factor=1.0)
    assert fixed.__name__ == "measure" and typing.get_type_hints(fixed)["size"] is Size
    assert fixed({}, {}, None, size=Size(2.0)) == {"value": np.array(6.0)}
