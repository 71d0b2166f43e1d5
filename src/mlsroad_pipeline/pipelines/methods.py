"""The methods that there are; a new one is one line here."""

from collections.abc import Callable, Mapping
from functools import partial, update_wrapper
from typing import Any

from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.models.methods import methods_of

LABELLERS, IMAGE_METHODS = methods_of("labelling"), methods_of("labelling", needs_images=True)
DETECTORS, RECOGNISERS = methods_of("detection"), methods_of("recognition")
IMAGE_LABELLER = "image_labels"

COMPARISON = (
    "simulate",
    "ingest",
    "ground_removal",
    "supervoxelise",
    "features",
    "patches",
    *LABELLERS,
    "segmentation",
    *DETECTORS,
    "evaluation",
    "compare",
    "report",
)
"""Pipelines that make up the default one, in their order."""

EVERYTHING = (
    *(name for name in COMPARISON if name not in ("compare", "report")),
    "recognition",
    *IMAGE_METHODS,
    "compare",
)
"""Pipelines that make up `all_methods`, in their order; its report is one of its own."""


def fix_arguments(function: Callable[..., Any], **given: Any) -> Callable[..., Any]:
    """Fix arguments of a node's function, which keeps its name in Kedro's messages."""
    return update_wrapper(partial(function, **given), function)


def joined(parts: Mapping[str, Pipeline]) -> Pipeline:
    """Join pipelines, and tag the nodes of each with its name.

    By the tags `kedro viz` shows a stage or a method by itself, and ``kedro run --tags=patch_graph`` runs it.
    """
    return sum((Pipeline(part, tags=name) for name, part in parts.items()), Pipeline([]))
