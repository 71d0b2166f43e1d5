"""Sections of the report of `label`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from mlsroad_pipeline.algorithms.inventory.measures import EXTENT
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme, model_source
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.label.confidence import confidence_table
from mlsroad_pipeline.label.scene import LabelCounts
from mlsroad_pipeline.label.summary import class_counts, summed_counts, written_clouds
from mlsroad_pipeline.label.work import WrittenFile
from mlsroad_pipeline.reporting.html.report import Section
from mlsroad_pipeline.reporting.html.sections import (
    DistributionSection,
    FactsSection,
    InventorySection,
    TableSection,
    WarningsSection,
)
from mlsroad_pipeline.surveys.parameters import LabelParameters

_NOT_LISTED = (*EXTENT, "scene", "method", "model_version", "footprint")
"""Columns of the inventory that the report omits."""

CONFIDENCE_NOTE = (
    "Median confidence of the points of each class. There is a warning above if a fifth of all points, or half of the "
    "points of a class, are below 0.5."
)


def _plain_text(value: object) -> str:
    """Return a mapping as ``name value, name value``, anything else as its string."""
    return ", ".join(f"{name} {item}" for name, item in value.items()) if isinstance(value, Mapping) else str(value)


def label_report_sections(
    bundle: ModelBundle,
    parameters: LabelParameters,
    quality: pd.DataFrame,
    counts: Mapping[str, LabelCounts],
    written: Mapping[str, WrittenFile],
    objects: pd.DataFrame,
    warnings: Sequence[str],
) -> list[Section]:
    """Return the sections of the report."""
    scheme = bundle_scheme(bundle)
    total = summed_counts(written)
    facts = {
        "survey": parameters.survey_name,
        "output": parameters.output,
        "model": _plain_text(model_source(bundle)),
        "trained on": _plain_text(bundle.metadata.get("trained_on", "")),
        "codes": parameters.scheme,
        "files": len(quality),
        "points": int(quality["n_points"].sum()),
    }
    facts |= _seen_by_cameras(bundle, counts)
    return [
        FactsSection("Run", facts),
        WarningsSection("Warnings", list(warnings)),
        DistributionSection("Classes", class_counts(bundle, total), scheme=scheme),
        TableSection("Confidence", confidence_table(total["confidences"], scheme.classes), note=CONFIDENCE_NOTE),
        InventorySection("Inventory", objects.drop(columns=list(_NOT_LISTED)), geopackage="inventory.gpkg"),
        TableSection("Quality of the survey", quality),
        TableSection("Files written", pd.DataFrame({"file": written_clouds(written)})),
    ]


def _seen_by_cameras(bundle: ModelBundle, counts: Mapping[str, LabelCounts]) -> dict[str, str]:
    """Return the number and share of points in an image, for methods that use images."""
    if not needs_images(bundle.slug):
        return {}
    total = sum(int(scene["counts"].sum()) for scene in counts.values())
    seen = sum(int(scene["seen"][0]) for scene in counts.values() if "seen" in scene)
    return {"seen by cameras": f"{seen} points, {100 * seen / max(total, 1):.1f} %"}
