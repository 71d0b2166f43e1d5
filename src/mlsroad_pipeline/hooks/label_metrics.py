"""Metrics of labelled surveys and of tables with one row per split."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

SUMMARY = "label_summary"
"""Catalog entry of the summary of `label`."""
STAGE_TABLES = {
    "ground_scores": "ground",
    "supervoxel_quality": "supervoxels",
    "segmentation_scores": "segmentation",
    "object_scores": "objects",
}
"""Catalog entries with one row per split or per kind of object, and the names of their metrics."""

_ILLEGAL = re.compile(r"[^\w.\- /]")


def _part(name: object) -> str:
    return _ILLEGAL.sub("_", str(name).replace("/", "_"))


def label_metrics(summary: Mapping[str, Any], seconds: float) -> dict[str, float]:
    """Return the metrics of a labelled survey."""
    points, confidence = int(summary["n_points"]), summary["confidence"]
    labelled = sum(summary["classes"].values())
    metrics: dict[str, float | None] = {
        "points": points,
        "files": int(summary["n_files"]),
        "seconds": seconds,
        "points_per_second": points / seconds,
        "warnings": len(summary["warnings"]),
        "unusual_properties": len(summary.get("unusual", ())),
        "objects": sum(summary["objects"].values()),
        "confidence/median": confidence["median"],
        "confidence/low_share": confidence["low_share"],
    }
    for name, count in summary["classes"].items():
        metrics[f"points/{_part(name)}"] = count
        metrics[f"share/{_part(name)}"] = count / labelled
    metrics |= {f"confidence/median/{_part(name)}": value for name, value in confidence["class_medians"].items()}
    metrics |= {f"objects/{_part(kind)}": count for kind, count in summary["objects"].items()}
    metrics |= {f"metres/{_part(kind)}": length for kind, length in summary.get("lines", {}).items()}
    return {name: float(value) for name, value in metrics.items() if value is not None and np.isfinite(value)}


def stage_metrics(table: pd.DataFrame, stage: str) -> dict[str, float]:
    """Return ``<split>/<stage>/<column>`` of a table with one row per split, or per kind."""
    groups = table["split" if "split" in table else "kind"]
    numbers = [name for name in table.columns if pd.api.types.is_numeric_dtype(table[name])]
    values = {
        f"{_part(group)}/{stage}/{_part(name)}": float(value)
        for name in numbers
        for group, value in zip(groups, table[name], strict=True)
    }
    return {name: value for name, value in values.items() if np.isfinite(value)}
