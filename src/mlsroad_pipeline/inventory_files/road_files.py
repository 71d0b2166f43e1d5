"""Measures of a road as CSV tables and layers of a GeoPackage."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from mlsroad_pipeline.algorithms.inventory.road.places import MEASURED
from mlsroad_pipeline.algorithms.inventory.road.stations import STEP, RoadPath
from mlsroad_pipeline.algorithms.inventory.road.table import ROAD_LAYERS
from mlsroad_pipeline.formats.files import write_atomic
from mlsroad_pipeline.inventory_files.geopackage import write_shapes
from mlsroad_pipeline.inventory_files.road_inventory import Layer
from mlsroad_pipeline.inventory_files.vector_files import without_formulas

TABLE, SECTIONS, SIGNS, PLACES = "road.csv", "road_sections.csv", "road_signs.csv", "road_places.csv"
"""Tables of a road: its stations, its sections, the sight to signs, and places to look at."""
LAYERS = "road.gpkg"
"""All tables as layers."""

_TEXTS = ("left_edge", "right_edge", "clearance_class", "envelope", "intrusion_class")
_KINDS = dict(zip(ROAD_LAYERS, ("LineString Z",) * 3 + ("Point Z", "LineString Z"), strict=True))


def write_road(
    table: pd.DataFrame, sections: pd.DataFrame, sight: pd.DataFrame, places: pd.DataFrame, folder: Path,
    *, path: RoadPath, crs: str | None, facts: Mapping[str, Any],
) -> list[Path]:  # fmt: skip
    """Write the tables of stations, sections, sight and places, and the layers; return their paths."""
    for name, rows in ((TABLE, table), (SECTIONS, sections), (SIGNS, sight), (PLACES, places)):
        write_atomic(folder / name, without_formulas(rows).to_csv(index=False, lineterminator="\n").encode())
    write_shapes(_layers(table, sections, sight, places, path), folder / LAYERS, crs=crs, facts=facts)
    return [folder / name for name in (TABLE, SECTIONS, SIGNS, PLACES, LAYERS)]


def read_road(path: Path) -> dict[str, Layer]:
    """Return the layers of the GeoPackage of `write_road`."""
    frames = {name: gpd.read_file(path, layer=name) for name in ROAD_LAYERS}
    return {
        name: (pd.DataFrame(frame.drop(columns="geometry")), frame.geometry.to_numpy(), _KINDS[name])
        for name, frame in frames.items()
    }


def _layers(
    table: pd.DataFrame, sections: pd.DataFrame, sight: pd.DataFrame, places: pd.DataFrame, path: RoadPath
) -> dict[str, Layer]:
    """Return the layers: parts of the path, edge to edge, sections, intruded and low places, seen ways."""
    rows = table.assign(**{name: table[name].astype(object).where(table[name] != "", None) for name in _TEXTS})
    lines = np.asarray(shapely.linestrings(np.stack([path.xyz[:-1], path.xyz[1:]], axis=1)))
    wide = np.flatnonzero(table["width"].notna())
    height = table["z"].to_numpy()[wide]
    offsets = [table[f"{side}_offset"].to_numpy()[wide] for side in ("left", "right")]
    ends = [np.column_stack([path.across(wide, offset), height]) for offset in offsets]
    edges = ["station", "width", "left_edge", "right_edge"]
    asked = places[places["state"] != MEASURED].reset_index(drop=True)
    bounds = (sections[["from_station", "to_station"]].to_numpy() / STEP).round().astype(np.int64)
    whole = [np.clip([low, max(high, low + 1)], 0, len(path)) for low, high in bounds]
    parts = [shapely.linestrings(path.xyz[min(low, len(path) - 1) : high + 1]) for low, high in whole]
    first = np.clip((sight["station"] - sight["sight"]) / STEP, 0, len(path) - 1).to_numpy().astype(np.int64)
    last = np.clip(sight["station"] / STEP, 0, len(path) - 1).to_numpy().astype(np.int64) + 1
    ways = [shapely.linestrings(path.xyz[low : high + 1]) for low, high in zip(first, last, strict=True)]
    seen = sight.assign(hidden_by=sight["hidden_by"].astype(object).where(sight["hidden_by"] != "", None))
    layers = [
        (rows, lines),
        (rows.loc[wide, edges], np.asarray(shapely.linestrings(np.stack(ends, axis=1)))),
        (sections, np.array(parts, dtype=object)),
        (asked, np.asarray(shapely.points(asked[["x", "y", "z"]].to_numpy()))),
        (seen, np.array(ways, dtype=object)),
    ]
    return {n: (own, shapes, _KINDS[n]) for n, (own, shapes) in zip(ROAD_LAYERS, layers, strict=True)}
