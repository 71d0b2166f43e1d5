"""Measures of a road as CSV tables and layers of a GeoPackage."""

from pathlib import Path

import numpy as np
import pandas as pd
import shapely

from mlsroad_pipeline.algorithms.inventory.road.stations import STEP, RoadPath
from mlsroad_pipeline.algorithms.inventory.road.table import INTRUDED, ROAD_LAYERS
from mlsroad_pipeline.formats.files import write_atomic
from mlsroad_pipeline.inventory_files.geopackage import write_shapes
from mlsroad_pipeline.inventory_files.vector_files import without_formulas

TABLE, SECTIONS, SIGNS, LAYERS = "road.csv", "road_sections.csv", "road_signs.csv", "road.gpkg"
"""Files of a road: its stations, its sections, the sight to signs, and all as layers."""

_TEXTS = ("left_edge", "right_edge", "clearance_class", "envelope", "intrusion_class")


def write_road(
    table: pd.DataFrame, sections: pd.DataFrame, sight: pd.DataFrame, path: RoadPath, crs: str | None, folder: Path
) -> list[Path]:
    """Write the tables of stations, sections and sight, and the layers; return their paths."""
    for name, rows in ((TABLE, table), (SECTIONS, sections), (SIGNS, sight)):
        write_atomic(folder / name, without_formulas(rows).to_csv(index=False, lineterminator="\n").encode())
    write_shapes(_layers(table, sections, sight, path), folder / LAYERS, crs=crs, described=True)
    return [folder / name for name in (TABLE, SECTIONS, SIGNS, LAYERS)]


def _layers(
    table: pd.DataFrame, sections: pd.DataFrame, sight: pd.DataFrame, path: RoadPath
) -> dict[str, tuple[pd.DataFrame, np.ndarray, str]]:
    """Return the layers: parts of the path, edge to edge, sections, and places inside the envelope, seen ways."""
    rows = table.assign(**{name: table[name].astype(object).where(table[name] != "", None) for name in _TEXTS})
    lines = np.asarray(shapely.linestrings(np.stack([path.xyz[:-1], path.xyz[1:]], axis=1)))
    wide = np.flatnonzero(table["width"].notna())
    ends = [path.across(wide, table[f"{side}_offset"].to_numpy()[wide]) for side in ("left", "right")]
    edges = ["station", "width", "left_edge", "right_edge"]
    inside = np.flatnonzero(table["envelope"] == INTRUDED)
    places = path.across(inside, table["intrusion_offset"].to_numpy()[inside])
    bounds = (sections[["from_station", "to_station"]].to_numpy() / STEP).round().astype(np.int64)
    whole = [np.clip([low, max(high, low + 1)], 0, len(path)) for low, high in bounds]
    parts = [shapely.linestrings(path.xyz[min(low, len(path) - 1) : high + 1]) for low, high in whole]
    first = np.clip((sight["station"] - sight["sight"]) / STEP, 0, len(path) - 1).to_numpy().astype(np.int64)
    last = np.clip(sight["station"] / STEP, 0, len(path) - 1).to_numpy().astype(np.int64) + 1
    ways = [shapely.linestrings(path.xyz[low : high + 1]) for low, high in zip(first, last, strict=True)]
    seen = sight.assign(hidden_by=sight["hidden_by"].astype(object).where(sight["hidden_by"] != "", None))
    layers = [
        (rows, lines, "LineString Z"),
        (rows.loc[wide, edges], np.asarray(shapely.linestrings(np.stack(ends, axis=1))), "LineString"),
        (sections, np.array(parts, dtype=object), "LineString Z"),
        (rows.iloc[inside], np.asarray(shapely.points(places)), "Point"),
        (seen, np.array(ways, dtype=object), "LineString Z"),
    ]
    return dict(zip(ROAD_LAYERS, layers, strict=True))
