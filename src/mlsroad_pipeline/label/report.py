"""Sections of the report of `label`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from shlex import quote

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.palette import class_palette
from mlsroad_pipeline.algorithms.inventory.objects.measures import EXTENT
from mlsroad_pipeline.algorithms.inventory.objects.table import FIELDS
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme, model_source
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory, line_vertices
from mlsroad_pipeline.label.confidence import confidence_table
from mlsroad_pipeline.label.report_pictures import ReportPictures
from mlsroad_pipeline.label.scene import LabelCounts
from mlsroad_pipeline.label.summary import class_counts, segmentation_source, summed_counts, written_clouds
from mlsroad_pipeline.label.written_file import WrittenFile
from mlsroad_pipeline.reporting.html.gallery import GallerySection
from mlsroad_pipeline.reporting.html.object_map import ObjectMapSection, shown_objects
from mlsroad_pipeline.reporting.html.object_table import ObjectTableSection
from mlsroad_pipeline.reporting.html.report import Section
from mlsroad_pipeline.reporting.html.sections import (
    DistributionSection,
    FactsSection,
    SceneSection,
    TableSection,
    WarningsSection,
)
from mlsroad_pipeline.surveys.parameters import LabelParameters

_NOT_LISTED = (*EXTENT, "scene", "method", "model_version", "footprint")
"""Columns of the inventory that the report omits."""

SECTION_NOTE = "Number of objects, and metres of each kind of line, by station along the path."
OBJECT_NOTE = "From above and from the south; a red cross marks the base point. Colours are those of the classes."
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
    inventory: RoadInventory,
    pictures: ReportPictures,
    warnings: Sequence[str],
) -> list[Section]:
    """Return the sections of the report."""
    scheme = bundle_scheme(bundle)
    total = summed_counts(written)
    facts = {
        "survey": parameters.survey_name,
        "output": parameters.output,
        "look and correct": f"mlsroad open {quote(str(parameters.output))}",
        "model": _plain_text(model_source(bundle)),
        "trained on": _plain_text(bundle.metadata.get("trained_on", "")),
        "codes": parameters.scheme,
        "files": len(quality),
        "points": int(quality["n_points"].sum()),
    }
    segmentation = segmentation_source(bundle)
    if segmentation is not None:
        facts["images segmented by"] = f"{segmentation['name']}, classes of {segmentation['classes']}"
    facts |= _seen_by_cameras(bundle, counts)
    return [
        *_map_and_pictures(inventory, pictures, scheme),
        *_sections_of_the_road(inventory),
        FactsSection("Run", facts),
        WarningsSection("Warnings", list(warnings)),
        DistributionSection("Classes", class_counts(bundle, total), scheme=scheme),
        TableSection("Confidence", confidence_table(total["confidences"], scheme.classes), note=CONFIDENCE_NOTE),
        _object_table(inventory.objects, pictures),
        TableSection("Quality of the survey", quality),
        TableSection("Files written", pd.DataFrame({"file": written_clouds(written)})),
    ]


def _map_and_pictures(inventory: RoadInventory, pictures: ReportPictures, scheme: ClassScheme) -> list[Section]:
    """Return the map, pictures of a scene with the colours of the classes, and of single objects."""
    objects, trajectory = inventory.objects, inventory.trajectory
    counts = {str(kind): int(n) for kind, n in objects["kind"].value_counts().sort_index().items()}
    path = None if trajectory is None else trajectory.xyz[:, :2]
    lines = _lines_by_kind(inventory)
    colours = dict(zip(scheme.classes, class_palette(scheme), strict=False))
    return [
        ObjectMapSection("Map", shown_objects(objects), pictures.frame, counts, path, pictures.background, lines),
        SceneSection("Pictures", pictures.scene, colours),
        GallerySection("Most and least certain objects", pictures.objects, OBJECT_NOTE),
    ]


def _lines_by_kind(inventory: RoadInventory) -> dict[str, list[NDArray[np.float64]]]:
    """Return the vertices of the lines of each kind in plan."""
    if inventory.lines is None:
        return {}
    return {str(kind): [xyz[:, :2] for xyz in line_vertices(lines)] for kind, lines in inventory.lines.groupby("kind")}


def _sections_of_the_road(inventory: RoadInventory) -> list[Section]:
    """Return the table of objects per section of the road; none without a single trajectory."""
    if inventory.sections is None:
        return []
    return [TableSection("Sections of the road", inventory.sections, SECTION_NOTE)]


def _object_table(objects: pd.DataFrame, pictures: ReportPictures) -> ObjectTableSection:
    """Return the section with all objects."""
    shown = shown_objects(objects)
    total = objects.groupby(["kind", "class"], sort=True).size().rename("objects").reset_index()
    names = {name: field.alias for name, field in FIELDS.items() if name not in _NOT_LISTED}
    places = pictures.frame.place(shown[["x", "y"]].to_numpy())
    return ObjectTableSection("Inventory", shown, total, names, places, geopackage="inventory.gpkg")


def _seen_by_cameras(bundle: ModelBundle, counts: Mapping[str, LabelCounts]) -> dict[str, str]:
    """Return the number and share of points in an image, for methods that use images."""
    if not needs_images(bundle.slug):
        return {}
    total = sum(int(scene["counts"].sum()) for scene in counts.values())
    seen = sum(int(scene["seen"][0]) for scene in counts.values() if "seen" in scene)
    return {"seen by cameras": f"{seen} points, {100 * seen / max(total, 1):.1f} %"}
