"""The methods that there are; a new one is one line here."""

from collections.abc import Callable, Mapping
from functools import partial, update_wrapper
from typing import Any

from kedro.pipeline import Pipeline

LABELLERS = (
    "detrended_forest",
    "patch_graph",
    "patch_graph_mrf",
    "patch_svm",
    "patch_forest",
    "shape_based",
    "max_margin_markov",
)
"""Slugs of the methods that label points; each has a pipeline of its name that writes ``<slug>.model`` and
``<slug>.labels``."""

DETECTORS = ("visual_words", "hough_forest", "object_matching", "bottom_up_top_down")
"""Slugs of the methods that detect objects; each has a pipeline of its name that writes ``<slug>.model`` and
``<slug>.detections``."""

IMAGE_LABELLER = "image_labels"
"""The method that labels points through images; only surveys with images have it."""

IMAGE_METHODS = (IMAGE_LABELLER, "fusion")
"""Slugs of the methods that need images; each has a pipeline of its name that writes ``<slug>.model``,
``<slug>.labels`` and ``<slug>.scores``, over all points and over those that cameras see."""

RECOGNISERS = (
    "jointnet",
    "jointnet_printed",
    "hssi_net",
    "vqai_net",
    "vaai_net",
    "spin_image",
    "shot",
    "hierarchy_descriptor",
    "pointnet",
)
"""Slugs of the methods that recognise objects; each has a pipeline of its name that writes ``<slug>.model`` and
``<slug>.recognitions``."""

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
