"""Pipelines by name, and those that are composed of others."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from pkgutil import iter_modules

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline import pipelines
from mlsroad_pipeline.algorithms.models.methods import METHODS, methods_of, trained_methods

_OF_TASK = {"labelling": "patch_labellers", "detection": "detectors", "recognition": "recognisers"}
"""Modules with the pipelines of methods that have no module of their own."""

_STAGES = ("ground_removal", "supervoxelise", "features", "patches", "segmentation")
_STUDIES = ("luo2016_study", "luo2019_study", "tomic2019_study", "yu2016_study")
_SHARED = {**dict.fromkeys(_STAGES, "stages"), **dict.fromkeys(_STUDIES, "study")}
"""Pipelines to their modules, where one module has several."""

_NO_PIPELINES = {*_OF_TASK.values(), *_SHARED.values(), "composition", "per_scene", "schemes", "training_facts"}
"""Modules beside the pipelines; every other module of the package is a pipeline of its name."""

_OF_SEVERAL = ("describe_training_scenes", "gather_patch_training")
"""Nodes that several methods share; their namespace is that of the task."""

_NAMESPACES = {
    "simulate": "survey",
    "ingest": "survey",
    "evaluation": "evaluation.scores",
    "compare": "evaluation.tables",
    "report": "evaluation.report",
    "object_recognition": "recognition",
}
"""Namespaces of parts that are not named after their pipeline; few of them are shown at first."""


def comparison() -> tuple[str, ...]:
    """Return the parts of the default pipeline in their order."""
    *stages, segmentation = _STAGES
    methods = (*methods_of("labelling"), segmentation, *methods_of("detection"))
    return ("simulate", "ingest", *stages, *methods, "evaluation", "compare", "report")


def all_parts() -> tuple[str, ...]:
    """Return the parts of `all_methods` in their order, its report excepted."""
    shared = (name for name in comparison() if name not in ("compare", "report"))
    return (*shared, "recognition", *methods_of("labelling", needs_images=True), "compare")


def _modules() -> set[str]:
    return {module.name for module in iter_modules(pipelines.__path__)} - _NO_PIPELINES


def pipeline_names() -> list[str]:
    """Return the names of all pipelines."""
    return sorted({*_modules(), *_SHARED, *trained_methods()})


def create_pipeline(name: str) -> Pipeline:
    """Return a pipeline: that of its module, or of the module that it shares with others."""
    own = name in _modules()
    place = name if own else _SHARED.get(name) or _OF_TASK[METHODS[name].task]
    create = import_module(f"{pipelines.__name__}.{place}").create_pipeline
    created: Pipeline = create() if own else create(name)
    return created


def named_pipeline(name: str) -> Pipeline:
    """Return a pipeline as a command runs it: its nodes have the names that they have in comparisons."""
    if name in {*comparison(), *all_parts(), *methods_of("recognition"), "object_recognition"}:
        return joined({name: create_pipeline(name)})
    return create_pipeline(name)


def joined(parts: Mapping[str, Pipeline]) -> Pipeline:
    """Join pipelines: tag the nodes of each with its name and put them into its namespace; datasets keep their names.

    `kedro viz` collapses the namespaces, and ``kedro run --tags=patch_graph`` runs a single method.
    """
    holders: dict[str, list[str]] = {}
    for name, part in parts.items():
        for node in part.nodes:
            holders.setdefault(node.name, []).append(name)
    placed = [_placed(node, holders[node.name]) for part in parts.values() for node in part.nodes]
    return Pipeline({node.name: node for node in placed}.values())


def _placed(node: Node, parts: Sequence[str]) -> Node:
    """Return a node in the namespace of its part, or in that of the task if several methods share it."""
    namespace = _namespace(parts[0])
    if len(parts) > 1 or node.name in _OF_SEVERAL:
        namespace = namespace.partition(".")[0]
    (placed,) = Pipeline([node], tags=parts, namespace=namespace, prefix_datasets_with_namespace=False).nodes
    return placed


def _namespace(part: str) -> str:
    """Return the namespace of a part: methods are grouped by their task."""
    if part in METHODS:
        task = METHODS[part].task
        return task if task == "recognition" else f"{task}.{part}"  # recognisers are one part
    return _NAMESPACES.get(part, part)
