"""Summary of a labelled survey: counts, confidences, warnings and paths, printed and logged at the end of a run."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import numpy as np
import pandas as pd

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme, model_source
from mlsroad_pipeline.algorithms.models.labelling import member
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.execution.run_identity import absolute
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory
from mlsroad_pipeline.label.confidence import LOW, confidence_table
from mlsroad_pipeline.label.scene import LabelCounts
from mlsroad_pipeline.label.written_file import WrittenFile
from mlsroad_pipeline.surveys.parameters import LabelParameters

UNLABELLED = "unlabelled"
"""Name of the points without a class."""


class ConfidenceSummary(TypedDict):
    """Confidences of the labelled points: share below 0.5, medians over all and per class; None without points."""

    low_share: float | None
    median: float | None
    class_medians: dict[str, float]


class OutputPaths(TypedDict):
    """Paths of the results."""

    clouds: list[str]
    inventory: str
    inventory_table: str
    exports: list[str]
    report: str


class LabelSummary(TypedDict):
    """Counts, warnings and output paths of a labelled survey; JSON values only."""

    survey: str
    output: str
    method: str
    model: Any
    trained_on: Any
    segmentation: dict[str, str] | None
    n_files: int
    n_points: int
    classes: dict[str, int]
    confidence: ConfidenceSummary
    objects: dict[str, int]
    lines: dict[str, float]
    unusual: list[str]
    warnings: list[str]
    outputs: OutputPaths
    kept: NotRequired[int]  # points that keep their class


def written_clouds(written: Mapping[str, WrittenFile]) -> list[str]:
    """Return the paths of the labelled point clouds, in the order of the files."""
    return [str(name) for part in written.values() for name in part["files"]]


def summed_counts(counts: Mapping[str, LabelCounts | WrittenFile]) -> LabelCounts:
    """Return the counts of all scenes or files together."""
    return {
        "counts": np.sum([scene["counts"] for scene in counts.values()], axis=0),
        "confidences": np.sum([scene["confidences"] for scene in counts.values()], axis=0),
    }


def class_counts(bundle: ModelBundle, total: LabelCounts) -> dict[str, int]:
    """Return the number of points per class and without a class."""
    names = (*bundle_scheme(bundle).classes, UNLABELLED)
    return dict(zip(names, total["counts"].tolist(), strict=True))


def segmentation_source(bundle: ModelBundle) -> dict[str, str] | None:
    """Return the name and the class map of the segmentation of a model that uses images, None for other models."""
    if not needs_images(bundle.slug):
        return None
    segmentation = member(bundle, "image_labels").metadata.get("segmentation")
    if segmentation is None:  # a network that an earlier version trained
        return {"name": "trained network", "classes": f"scheme {bundle_scheme(bundle).name!r}"}
    return {"name": str(segmentation["name"]), "classes": str(segmentation["classes"]["source"])}


def summarise_labels(
    bundle: ModelBundle,
    parameters: LabelParameters,
    quality: pd.DataFrame,
    written: Mapping[str, WrittenFile],
    inventory: RoadInventory,
    warnings: Sequence[str],
    *,
    unusual: Sequence[str] = (),
    exports: Sequence[str] = (),
    kept: int = 0,
) -> LabelSummary:
    """Return the summary of a labelled survey; `unusual` are its properties outside the range of the training data.

    `exports` are the files of `label.export`; `lines` has the metres of line of each kind. `kept` are the points that
    keep their class.
    """
    total, objects = summed_counts(written), inventory.objects
    output = Path(str(parameters.output))
    return {
        "survey": parameters.survey_name,
        "output": str(output),
        "method": bundle.slug,
        "model": model_source(bundle),
        "trained_on": bundle.metadata.get("trained_on"),
        "segmentation": segmentation_source(bundle),
        "n_files": len(quality),
        "n_points": int(quality["n_points"].sum()),
        "classes": {name: count for name, count in class_counts(bundle, total).items() if count},
        "confidence": _confidence(confidence_table(total["confidences"], bundle_scheme(bundle).classes)),
        "objects": {str(kind): int(count) for kind, count in objects["kind"].value_counts(sort=False).items()},
        "lines": line_totals(inventory.lines),
        "unusual": list(unusual),
        "warnings": list(warnings),
        "outputs": {
            "clouds": written_clouds(written),
            "inventory": str(output / "inventory.gpkg"),
            "inventory_table": str(output / "inventory.parquet"),
            "exports": list(exports),
            "report": str(output / "report.html"),
        },
        "kept": kept,
    }


def line_totals(lines: pd.DataFrame | None) -> dict[str, float]:
    """Return the metres of line of each kind."""
    if lines is None:
        return {}
    return {str(kind): round(float(length), 1) for kind, length in lines.groupby("kind")["length"].sum().items()}


def _confidence(table: pd.DataFrame) -> ConfidenceSummary:
    rows = {str(row["class"]): row for row in table.to_dict("records")}
    whole = rows.pop("all")
    return {
        "low_share": float(whole[f"share_below_{LOW}"]) if whole["points"] else None,
        "median": float(whole["median_confidence"]) if whole["points"] else None,
        "class_medians": {name: float(row["median_confidence"]) for name, row in rows.items()},
    }


def moved_summary(summary: LabelSummary, output: Path) -> LabelSummary:
    """Return the summary with the paths of a folder that has been moved or copied to `output`."""

    def moved(path: str) -> str:
        for old in (Path(summary["output"]), Path(absolute(summary["output"]))):
            if Path(path).is_relative_to(old):
                return str(output / Path(path).relative_to(old))
        return path

    old = summary["outputs"]
    paths: OutputPaths = {
        "clouds": [moved(path) for path in old["clouds"]],
        "inventory": moved(old["inventory"]),
        "inventory_table": moved(old["inventory_table"]),
        "exports": [moved(path) for path in old["exports"]],
        "report": moved(old["report"]),
    }
    return {**summary, "output": str(output), "outputs": paths}
