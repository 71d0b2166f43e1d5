"""Descriptions and aliases of registered models."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import mlflow
import pandas as pd

from mlsroad_pipeline.algorithms.models.methods import METHODS, trained_methods

CHALLENGER = "challenger"
"""Alias of the newest version of a registered model. (MLflow reserves the alias ``latest``.)"""

_SCORES = "\n\nScores: "
_PAGES_OF_SEVERAL = {
    "patch_baselines": ("patch_svm", "patch_forest", "shape_based", "max_margin_markov"),
    "detection_baselines": ("hough_forest", "object_matching", "bottom_up_top_down"),
    "recognition_baselines": ("spin_image", "shot", "hierarchy_descriptor", "pointnet"),
}
"""Page of the manual to the folders of its methods; the page of any other method has the name of its folder."""


def annotate_version(name: str, number: int, slug: str, metadata: Mapping[str, Any]) -> None:
    """Set the alias and the descriptions of a new version; the alias `champion` is the user's."""
    client = mlflow.MlflowClient()
    client.set_registered_model_alias(name, CHALLENGER, str(number))
    client.update_model_version(name, str(number), model_description(metadata))
    if slug in trained_methods():
        client.update_registered_model(name, f"Method `{slug}` ({METHODS[slug].task}): {manual_page(slug)}")


def manual_page(slug: str) -> str:
    """Return the path of the page of the manual on a method."""
    folder = METHODS[slug].folder.rsplit(".", 1)[-1]
    page = next((page for page, folders in _PAGES_OF_SEVERAL.items() if folder in folders), folder)
    return f"docs/methods/{page}.md"


def model_description(metadata: Mapping[str, Any]) -> str:
    """Return the text of a version: training data, classes and seed."""
    trained_on = metadata.get("trained_on", "unknown data")
    if isinstance(trained_on, Mapping):
        trained_on = ", ".join(f"{key} {_short(value)}" for key, value in trained_on.items())
    lines = [f"Trained on {trained_on}.", f"Classes: {', '.join(map(str, metadata.get('classes', ())))}."]
    seeds = sorted({str(seed) for seed in _seeds(metadata.get("parameters"))})
    if seeds:
        lines.append(f"Seed: {', '.join(seeds)}.")
    return "\n\n".join(lines)


def describe_version(name: str, number: str, scores: pd.DataFrame) -> None:
    """Add scores over all classes, one row per method and split, to the description of a version."""
    client = mlflow.MlflowClient()
    before = (client.get_model_version(name, number).description or "").split(_SCORES)[0]
    rows = []
    for split, values in zip(scores.index.get_level_values("split"), scores.to_dict("records"), strict=True):
        defined = {str(metric).replace("_", " "): value for metric, value in values.items() if pd.notna(value)}
        rows.append(f"{split}: " + ", ".join(f"{metric} {value:.3f}" for metric, value in defined.items()))
    client.update_model_version(name, number, f"{before}{_SCORES}{'; '.join(rows)}.")


def _short(value: Any) -> str:
    return f"{len(value)} of them" if isinstance(value, list | tuple) else str(value)


def _seeds(parameters: Any) -> Iterator[Any]:
    if isinstance(parameters, Mapping):
        for name, value in parameters.items():
            if name == "seed":
                yield value
            else:
                yield from _seeds(value)
