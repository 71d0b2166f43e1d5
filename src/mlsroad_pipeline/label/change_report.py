"""Files of a comparison: table, layers, raster, and the page with its map and pairs of pictures."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.palette import class_palette
from mlsroad_pipeline.algorithms.inventory.changes.objects import CHANGED, GONE, MOVED, NEW, OTHER_KIND
from mlsroad_pipeline.algorithms.inventory.changes.surfaces import (
    SURFACES,
    SurfaceDistances,
    changed_areas,
    distance_raster,
)
from mlsroad_pipeline.formats.files import write_atomic
from mlsroad_pipeline.inventory_files.geopackage import check_closed, points_of, write_shapes
from mlsroad_pipeline.inventory_files.geotiff import write_geotiff
from mlsroad_pipeline.inventory_files.vector_files import without_formulas
from mlsroad_pipeline.label.compared_lines import length_table
from mlsroad_pipeline.label.compared_surveys import TABLE, ComparedSurveys
from mlsroad_pipeline.label.labelled_clouds import LabelledCloud, Recorded
from mlsroad_pipeline.reporting.changes_page import ChangesMap, changes_page
from mlsroad_pipeline.reporting.clouds.pictures import map_frame, object_picture, overview_picture
from mlsroad_pipeline.reporting.html.report import Picture, table_section
from mlsroad_pipeline.review.corrections.checked_states import with_checked

LAYERS, PAGE, RASTER = "changes.gpkg", "changes.html", "surface_change.tif"
"""Files of a comparison of surveys beside its table."""
LINES = "changed_lines.csv"
"""Table of the parts of lines."""
FILES = (TABLE, LINES, LAYERS, PAGE, RASTER)
MOST_PICTURES = 12
"""Largest number of pairs of pictures of each state."""
_SHOWN = (CHANGED, MOVED, OTHER_KIND, GONE, NEW)
_SHARES = {"empty_share": 2, "standing_share": 2}
_HEADINGS = {
    "changes": "Changes", "first_id": "Number before", "second_id": "Number after", "distance": "Moved by [m]",
    "tilt_change": "Axis turned by [deg]", "height_change": "Height [m]", "panel_bottom_change": "Panel [m]",
    "reason": "Reason", "checked": "Checked", "x": "Easting [m]", "y": "Northing [m]", "key": "Key",
}  # fmt: skip
LINES_NOTE = f"Length in metres. Layer lines of {LAYERS} has the parts."
SURFACE_NOTE = (
    "Connected cells of 0.5 m whose M3C2 distances exceed their level of detection (95 %). Positive is upwards, of "
    "facades towards the path."
)


def write_changes(compared: ComparedSurveys, folder: Path, warnings: Sequence[str]) -> list[Path]:
    """Write table, layers, raster and page of a comparison of surveys, each whole or not at all; return their paths."""
    check_closed(folder / LAYERS)
    folder.mkdir(parents=True, exist_ok=True)
    crs = compared.second.inventory.crs
    table = with_checked(compared.objects.round(3).round(_SHARES), "changes", compared.second.output.path)
    lines = compared.lines
    layers = {"objects": points_of(table), "lines": (lines.table, lines.shapes, "LineString")}
    areas = pd.DataFrame()
    if compared.surfaces is not None:
        areas, shapes = changed_areas(compared.surfaces)
        areas = areas.round(3)
        layers["surfaces"] = (areas, shapes, "MultiPolygon")
    raster = None if compared.surfaces is None else distance_raster(compared.surfaces)
    # The table is first: it shows that the other files are of a comparison.
    write_atomic(folder / TABLE, without_formulas(table).to_csv(index=False, lineterminator="\n").encode())
    write_atomic(folder / LINES, without_formulas(lines.table).to_csv(index=False, lineterminator="\n").encode())
    if raster is not None:
        write_geotiff(raster.values, folder / RASTER, corner=(raster.west, raster.north), edge=raster.edge, crs=crs)
    else:
        (folder / RASTER).unlink(missing_ok=True)  # of an earlier comparison
    write_shapes(layers, folder / LAYERS, crs=crs)
    further = [table_section("Lines", length_table(lines.table), LINES_NOTE)]
    if compared.surfaces is not None:
        further += [
            table_section("Surfaces", surface_table(compared.surfaces)),
            table_section("Areas of significant change", areas, SURFACE_NOTE),
        ]
    first, second = compared.first.output.path, compared.second.output.path
    page = changes_page(
        table, _HEADINGS, map_of(compared.second, table), title=f"Changes from {first.name} to {second.name}",
        subtitle=str(folder), facts=facts_of(compared), layers=LAYERS, pictures=pairs_of_pictures(compared),
        further=further, warnings=warnings,
    )  # fmt: skip
    write_atomic(folder / PAGE, page.encode())
    return [folder / name for name in FILES if (folder / name).exists()]


def offset_text(compared: ComparedSurveys) -> str:
    """Return the offset of the later survey with its standard errors, and whether it was removed."""
    offset = compared.offset
    if offset is None:
        return "not measured: too few unchanged surfaces in common"
    parts = [
        f"{shift:+.3f} m in {axis} (standard error {error:.3f} m)"
        for axis, shift, error in zip("xyz", offset.shift, offset.error, strict=True)
        if np.isfinite(shift)
    ]
    turn = f", turned by {np.degrees(offset.heading):+.3f}°" if offset.heading else ""
    end = "; the earlier survey was moved by it" if compared.aligned else "; nothing was moved"
    return f"{', '.join(parts)}{turn}, from {offset.n_surfaces:,} surfaces{end}"


def facts_of(compared: ComparedSurveys) -> dict[str, Any]:
    """Return what was compared."""
    return {
        "earlier survey": str(compared.first.output.path),
        "later survey": str(compared.second.output.path),
        "offset of the later survey": offset_text(compared),
        "registration error of surfaces [m]": compared.registration_error,
    }


def surface_table(found: SurfaceDistances) -> pd.DataFrame:
    """Return numbers of core points and of significant changes of each surface."""
    rows = []
    for number, name in enumerate(SURFACES):
        own = (found.surface == number) & np.isfinite(found.distance)
        distance, significant = found.distance[own], found.significant[own]
        rows.append(
            {
                "surface": name,
                "core points": int((found.surface == number).sum()),
                "measured": int(own.sum()),
                "median distance [m]": float(np.median(distance)) if own.any() else np.nan,
                "median level of detection [m]": float(np.nanmedian(found.detection[own])) if own.any() else np.nan,
                "significant": int(significant.sum()),
            }
        )
    return pd.DataFrame(rows)


def map_of(survey: Recorded, table: pd.DataFrame) -> ChangesMap:
    """Return the frame of all points with a state, the classes of a survey below them, and its path."""
    path = None if survey.path is None else survey.path[:, :2]
    places = table[["x", "y"]].to_numpy(dtype=np.float64)
    frame = map_frame(np.zeros((0, 2)), places if path is None else np.concatenate([places, path]))
    palette = class_palette(survey.clouds[0].scheme)
    return ChangesMap(frame, overview_picture(survey.class_chunks(), palette, frame), path)


def pairs_of_pictures(compared: ComparedSurveys) -> dict[str, list[Picture]]:
    """Return pictures of changed objects in both surveys, side by side, by state."""
    table = compared.objects
    rows = table[table["state"].isin(_SHOWN)].groupby("state", sort=False).head(MOST_PICTURES).reset_index(drop=True)
    if rows.empty:
        return {}
    reach = np.clip(rows["distance"].fillna(0.0).to_numpy() + 2.0, 3.0, 7.0)
    height = np.fmax(rows["first_height"].to_numpy(), rows["second_height"].to_numpy())
    reach = np.clip(np.fmax(reach, 0.6 * np.nan_to_num(height)), 3.0, 9.0)
    near = [_near(survey.clouds, rows, reach) for survey in (compared.first, compared.second)]
    shown: dict[str, list[Picture]] = {}
    for k, row in enumerate(rows.to_dict("records")):
        views = [
            object_picture(xyz, colour, reach=float(reach[k]), bottom=float(row["z"]), listed=bool(row[f"{end}_id"]))
            for end, (xyz, colour) in (("first", near[0][k]), ("second", near[1][k]))
        ]
        text = f"{row['kind']} {row['first_id'] or '–'} → {row['second_id'] or '–'}"
        text += f": {row['changes']}" if row["changes"] else ""
        text += f", moved by {row['distance']:.2f} m" if row["state"] == MOVED else ""
        gap = np.full((views[0].shape[0], 12, 3), 255, np.uint8)
        shown.setdefault(str(row["state"]), []).append(Picture(np.concatenate([views[0], gap, views[1]], 1), text))
    return shown


def _near(
    clouds: Sequence[LabelledCloud], rows: pd.DataFrame, reach: NDArray[np.float64]
) -> list[tuple[NDArray[np.float32], NDArray[np.uint8]]]:
    """Return the points around each row, relative to it in plan, with the colours of their classes."""
    places = rows[["x", "y"]].to_numpy(dtype=np.float64)
    found: list[list[tuple[NDArray[np.float32], NDArray[np.uint8]]]] = [[] for _ in places]
    for cloud in clouds:
        palette = class_palette(cloud.scheme)
        for xyz, code, _ in cloud.chunks():
            for k, own in _inside(xyz, places, reach):
                label = cloud.label[code[own]]
                relative = (xyz[own] - [*places[k], 0.0]).astype(np.float32)
                found[k].append((relative, palette[label]))
    nothing = (np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8))
    joined = [[nothing, *parts] for parts in found]
    return [
        (np.concatenate([xyz for xyz, _ in parts]), np.concatenate([colour for _, colour in parts])) for parts in joined
    ]


def _inside(
    xyz: NDArray[np.float64], places: NDArray[np.float64], reach: NDArray[np.float64]
) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Yield each place with the rows of the points within its reach in both directions."""
    tree = cKDTree(places)
    distance, _ = tree.query(xyz[:, :2], distance_upper_bound=float(reach.max()) * np.sqrt(2))
    some = np.flatnonzero(np.isfinite(distance))
    for k, place in enumerate(places):
        own = some[(np.abs(xyz[some, :2] - place) <= reach[k]).all(axis=1)]
        if len(own):
            yield k, own
