"""Node functions that create one task per scene."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial, update_wrapper
from typing import Any, get_type_hints

from kedro.pipeline import Node

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile, is_loader, scene_tasks


class PerScene:
    """Node function of a stage whose tasks call one function.

    Its arguments are the required arguments of that function, by the same names. Stores and models become inputs of the
    tasks, other values parameters. Kedro reads the classes of parameter groups from the annotations.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        *,
        over: str = "",
        keys: Callable[[Iterable[str]], Iterable[str]] = list,
        fixed: Mapping[str, Any] | None = None,
        **derived: Callable[..., Any],
    ) -> None:
        self._function, self._over, self._keys = function, over, keys
        self._fixed, self._derived = dict(fixed or {}), derived
        own = [name for name in _required(function) if name not in {*self._fixed, *derived}]
        self._own = own
        more = [name for find in derived.values() for name in _required(find)]
        kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
        self.__name__ = function.__name__
        self.__signature__ = inspect.Signature([inspect.Parameter(name, kind) for name in dict.fromkeys(own + more)])
        self.__annotations__ = {
            name: hint
            for source in (*derived.values(), function)
            for name, hint in get_type_hints(source).items()
            if name in self.__signature__.parameters
        }

    def __call__(self, *args: Any, **kwargs: Any) -> dict[str, SceneTask]:
        """Return the task of each scene."""
        values = self.__signature__.bind(*args, **kwargs).arguments
        inputs = {k: values[k] for k in self._own if isinstance(values[k], SourceFile) or _has_scenes(values[k])}
        parameters = {k: values[k] for k in self._own if k not in inputs}
        for name, find in self._derived.items():
            parameters[name] = find(**{k: values[k] for k in _required(find)})
        stores = {name: value for name, value in inputs.items() if _has_scenes(value)}
        scenes = stores[self._over or next(iter(stores))]
        return scene_tasks(self._keys(scenes), self._function, inputs, parameters | self._fixed)


def _has_scenes(value: Any) -> bool:
    """Return whether a value has one result per scene: a scene store, or a data set of Kedro that keeps tasks."""
    if isinstance(value, SceneCollection):
        return True
    results = list(value.values()) if isinstance(value, Mapping) else []
    return bool(results) and all(isinstance(result, SceneTask) or is_loader(result) for result in results)


_ENTRIES = {
    "scene": "scenes",
    "features": "supervoxel_features",
    "survey": "params:survey",
    "classes": "params:classes",
}
"""Argument of a function of scenes to its entry in the catalog, where the names differ."""


def scene_node(
    function: Callable[..., Any], output: str, name: str, *, inputs: Mapping[str, str] | None = None, **options: Any
) -> Node:
    """Return a node with one task per scene; arguments not in `inputs` are entries of their names or of `_ENTRIES`."""
    stage = PerScene(function, **options)
    entries = {**_ENTRIES, **(inputs or {})}
    return Node(stage, {key: entries.get(key, key) for key in stage.__signature__.parameters}, output, name=name)


_NODE_ENTRIES = {
    **{name: f"params:{name}" for name in ("survey", "classes", "ingest", "detection", "recognition", "segmentation")},
    **{name: f"params:{name}" for name in ("features", "simulation", "shipped")},
    "ground": "params:ground_removal", "supervoxels": "params:supervoxelise", "sizes": "params:patches",
    "model": ".model", "labels": ".labels", "detections": ".detections", "counts": ".confusions",
    "checkpoints": ".checkpoints", "scene_facts": "training_facts",
}  # fmt: skip
"""Argument of a node function to its entry in the catalog, where the names differ; a dot stands for ``<slug>.``."""


def named_node(
    function: Callable[..., Any], outputs: str | Sequence[str], name: str = "", *, slug: str = "", **inputs: str
) -> Node:
    """Return a node, named after its function by default; its inputs are the entries of the function's arguments.

    Entries not in `inputs` are those of `_NODE_ENTRIES`, or of the argument's name. ``parameters`` are those of the
    method `slug`, whose own entries begin with a dot.
    """
    known = {**_NODE_ENTRIES, "parameters": f"params:{slug}", **inputs}

    def entry(given: str) -> str:
        return slug + given if given.startswith(".") else given

    made = entry(outputs) if isinstance(outputs, str) else [entry(output) for output in outputs]
    entries = {argument: entry(known.get(argument, argument)) for argument in _required(function)}
    return Node(function, entries, made, name=name or function.__name__)


MODEL = (".model", ".registered_model")
"""Outputs of a node that trains a method: the model for workers and for the registry."""


def _required(function: Callable[..., Any]) -> list[str]:
    parameters = inspect.signature(function, follow_wrapped=False).parameters.values()
    return [parameter.name for parameter in parameters if parameter.default is inspect.Parameter.empty]


def fix_arguments(function: Callable[..., Any], **fixed: Any) -> Callable[..., Any]:
    """Fix arguments of a node function; Kedro's messages keep its name."""
    return update_wrapper(partial(function, **fixed), function)
