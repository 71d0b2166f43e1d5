"""Sections, map and pictures of the report of `label`."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from shlex import quote
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.palette import class_palette
from mlsroad_pipeline.algorithms.inventory.lines.extraction import LINE_FIELDS
from mlsroad_pipeline.algorithms.inventory.objects.measures import EXTENT
from mlsroad_pipeline.algorithms.inventory.objects.review import FAR
from mlsroad_pipeline.algorithms.inventory.objects.table import FIELDS
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme, model_source
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.algorithms.quality.report import HEADINGS
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory, fields_with_notes, line_vertices
from mlsroad_pipeline.label.confidence import confidence_table
from mlsroad_pipeline.label.scene import LabelCounts, PictureSample
from mlsroad_pipeline.label.summary import class_counts, segmentation_source, summed_counts, written_clouds
from mlsroad_pipeline.label.written_file import WrittenFile
from mlsroad_pipeline.reporting.clouds.pictures import (
    MapFrame,
    map_frame,
    object_picture,
    overview_picture,
    scene_pictures,
)
from mlsroad_pipeline.reporting.html import report as html
from mlsroad_pipeline.reporting.html.objects import object_map_section, object_table_section, shown_objects
from mlsroad_pipeline.review.corrections.line_decisions import corrected_lines
from mlsroad_pipeline.surveys.parameters import LabelParameters

FRAME_STEP = 100
"""The frame of the map is computed from one of so many points of each scene: few points far away do not widen it."""


class ReportPictures(NamedTuple):
    """Frame of the map, its background, pictures of the scene with most objects, and pictures of single objects."""

    frame: MapFrame
    background: NDArray[np.uint8] | None
    scene: dict[str, NDArray[np.uint8]]
    objects: dict[str, list[html.Picture]]


def report_pictures(results: SceneCollection, inventory: RoadInventory, palette: NDArray[np.uint8]) -> ReportPictures:
    """Return the map and the pictures; scenes are read one at a time by each of three threads."""
    samples, objects = results.part("sample"), inventory.objects
    points = np.concatenate([_some(samples[key].load()) for key in samples])
    path = np.zeros((0, 2)) if inventory.trajectory is None else inventory.trajectory.xyz[:, :2]
    frame = map_frame(points, np.concatenate([objects[["x", "y"]].to_numpy(), path]))
    if not len(points):
        return ReportPictures(frame, None, {}, {})
    with ThreadPoolExecutor(2) as pool:
        scene = pool.submit(_busiest, samples, objects, palette)
        extremes = pool.submit(_extremes, samples, objects, palette)
        background = overview_picture(_cores(samples), palette, frame)
        return ReportPictures(frame, background, scene.result(), extremes.result())


def _some(sample: PictureSample) -> NDArray[np.float64]:
    rows = np.flatnonzero(sample["core"])[::FRAME_STEP]
    return sample["xyz"][rows, :2].astype(np.float64) + sample["origin"][:2]


def _cores(samples: SceneCollection) -> Iterator[tuple[NDArray[np.float64], NDArray[np.integer]]]:
    for handle in samples.values():
        sample = handle.load()
        yield sample["xyz"][sample["core"]].astype(np.float64) + sample["origin"], sample["label"][sample["core"]]


def _busiest(
    samples: SceneCollection, objects: pd.DataFrame, palette: NDArray[np.uint8]
) -> dict[str, NDArray[np.uint8]]:
    """Return pictures of the scene with most objects."""
    counts = objects["scene"].value_counts().reindex(list(samples), fill_value=0)
    key = str(counts.index[int(counts.to_numpy().argmax())])
    sample = samples[key].load()
    if len(sample["xyz"]) < 2:
        return {}
    above, side = scene_pictures(sample["xyz"].astype(np.float64), sample["label"], palette)
    which = "" if len(samples) == 1 else f"Part of the survey{' with most objects' if len(objects) else ''}, "
    captions = (f"{which}from above.", f"{which}from the side: what lies beyond its middle.")
    return {text[0].upper() + text[1:]: picture for text, picture in zip(captions, (above, side), strict=True)}


def _extremes(
    samples: SceneCollection, objects: pd.DataFrame, palette: NDArray[np.uint8]
) -> dict[str, list[html.Picture]]:
    """Return a picture of the most and of the least certain object of each kind."""
    shown: dict[str, list[html.Picture]] = {}
    for kind, rows in objects[objects["scene"].isin(list(samples))].groupby("kind", sort=True):
        ordered = rows.sort_values(["score", "object_id"], ascending=[False, True], kind="stable")
        ends = (
            {"most certain": ordered.iloc[0], "least certain": ordered.iloc[-1]}
            if len(rows) > 1
            else {"only one": ordered.iloc[0]}
        )
        shown[str(kind)] = [
            html.Picture(
                _picture(row, samples[row["scene"]].load(), palette),
                f"{text}: {row['object_id']} {row['class']}, score {row['score']:.2f}, {row['height']:.1f} m high",
            )
            for text, row in ends.items()
        ]
    return shown


def _picture(row: pd.Series, sample: PictureSample, palette: NDArray[np.uint8]) -> NDArray[np.uint8]:
    reach = float(np.clip(0.7 * max(row["height"], row["width"]), 2.0, 9.0))
    place = np.array([row["x"], row["y"], 0.0]) - sample["origin"]
    near = np.abs(sample["xyz"][:, :2] - place[:2]).max(axis=1) <= reach
    xyz = (sample["xyz"][near].astype(np.float64) - place).astype(np.float32)
    return object_picture(xyz, palette[sample["label"][near]], reach=reach, bottom=float(row["z"]))


_NOT_LISTED = (*EXTENT, "scene", "method", "model_version", "footprint")
"""Columns of the inventory that the report omits."""

_LISTED_OF_LINES = ("line_id", "kind", "score", "length", "from_station", "to_station", "offset", "status")
LINE_NOTE = (
    "Lines after the decisions about them, long ones first. Kerbs and barriers have no score: they are "
    "within limits of height and width, and no probability was learned."
)
MOST_PLACES = 50
"""Most doubtful clusters that the report lists, those with most points."""
PLACES_NOTE = (
    f"Clusters whose class is unlikely where they stand, at most the {MOST_PLACES} largest. mlsroad open shows them: J "
    "lists places, these first."
)
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
    doubts: pd.DataFrame,
) -> list[html.Section]:
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
    facts |= _seen_by_cameras(bundle, counts) | _number_near(inventory.objects)
    lines = corrected_lines(inventory.lines, Path(parameters.output), inventory.trajectory)
    return [
        html.warnings_section("Warnings", list(warnings)),
        *_map_and_pictures(inventory, lines, pictures, scheme),
        *(
            []
            if inventory.sections is None
            else [html.table_section("Sections of the road", inventory.sections, SECTION_NOTE)]
        ),
        html.facts_section("Run", facts),
        *([] if doubts.empty else [html.table_section("Places to check", _first_doubts(doubts), PLACES_NOTE)]),
        html.distribution_section("Classes", class_counts(bundle, total), scheme=scheme),
        html.table_section("Confidence", confidence_table(total["confidences"], scheme.classes), CONFIDENCE_NOTE),
        _object_table(inventory.objects, pictures),
        *_line_table(lines),
        html.table_section("Quality of the survey", quality.rename(columns=HEADINGS)),
        html.table_section("Files written", pd.DataFrame({"file": written_clouds(written)})),
    ]


def _number_near(objects: pd.DataFrame) -> dict[str, str]:
    """Return how many of the objects are near the path, for surveys with one."""
    offset = objects["offset"].dropna().abs()
    if offset.empty:
        return {}
    return {f"objects within {FAR:g} m of the path": f"{(offset <= FAR).sum()} of {len(objects)}"}


def _map_and_pictures(
    inventory: RoadInventory, table: pd.DataFrame | None, pictures: ReportPictures, scheme: ClassScheme
) -> list[html.Section]:
    """Return the map, pictures of a scene with the colours of the classes, and of single objects."""
    objects, trajectory = inventory.objects, inventory.trajectory
    counts = {str(kind): int(n) for kind, n in objects["kind"].value_counts().sort_index().items()}
    path = None if trajectory is None else trajectory.xyz[:, :2]
    lines = _lines_by_kind(table)
    colours = dict(zip(scheme.classes, class_palette(scheme), strict=False))
    return [
        object_map_section("Map", shown_objects(objects), pictures.frame, counts, path, pictures.background, lines),
        html.scene_section("Pictures", pictures.scene, colours),
        html.gallery_section("Most and least certain objects", pictures.objects, OBJECT_NOTE),
    ]


def _lines_by_kind(table: pd.DataFrame | None) -> dict[str, list[NDArray[np.float64]]]:
    """Return the vertices of the lines of each kind in plan, without those that were rejected."""
    if table is None:
        return {}
    kept = table[table["status"] != "rejected"]
    return {str(kind): [xyz[:, :2] for xyz in line_vertices(lines)] for kind, lines in kept.groupby("kind")}


def _line_table(table: pd.DataFrame | None) -> list[html.Section]:
    """Return the section with all lines, the long ones first."""
    if table is None:
        return []
    fields = {**LINE_FIELDS, "status": FIELDS["status"]}
    rows = table.sort_values("length", ascending=False, kind="stable")[list(_LISTED_OF_LINES)]
    return [
        html.table_section(
            "Lines", rows.rename(columns={name: fields[name].alias for name in _LISTED_OF_LINES}), LINE_NOTE
        )
    ]


def _object_table(objects: pd.DataFrame, pictures: ReportPictures) -> html.Section:
    """Return the section with all objects."""
    shown = shown_objects(objects)
    total = objects.groupby(["kind", "class"], sort=True).size().rename("objects").reset_index()
    names = {name: field.alias for name, field in fields_with_notes(shown).items() if name not in _NOT_LISTED}
    places = pictures.frame.place(shown[["x", "y"]].to_numpy())
    return object_table_section("Inventory", shown, total, names, places, geopackage="inventory.gpkg")


def _first_doubts(doubts: pd.DataFrame) -> pd.DataFrame:
    return doubts.sort_values("points", ascending=False, kind="stable").head(MOST_PLACES).round({a: 1 for a in "xyz"})


def _seen_by_cameras(bundle: ModelBundle, counts: Mapping[str, LabelCounts]) -> dict[str, str]:
    """Return the number and share of points in an image, for methods that use images."""
    if not needs_images(bundle.slug):
        return {}
    total = sum(int(scene["counts"].sum()) for scene in counts.values())
    seen = sum(int(scene["seen"][0]) for scene in counts.values() if "seen" in scene)
    return {"seen by cameras": f"{seen} points, {100 * seen / max(total, 1):.1f} %"}
