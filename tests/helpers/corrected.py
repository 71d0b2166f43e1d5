"""Small output folders with an inventory, for tests of corrections."""

from pathlib import Path

import numpy as np
import pandas as pd
import pyogrio

from mlsroad_pipeline.algorithms.inventory.objects.table import OBJECT_FIELDS
from mlsroad_pipeline.inventory_files.geopackage import write_geopackage
from mlsroad_pipeline.inventory_files.geoparquet import write_geoparquet
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory

PLACES = [("pole", 0.0, 0.0), ("pole", 10.0, 0.0), ("sign", 10.3, 0.0), ("tree", 20.0, 5.0), ("vehicle", 30.0, -3.0)]


def object_rows(places=PLACES, scores=(0.9, 0.6, 0.5, 0.95, 0.2)) -> pd.DataFrame:
    blank = {n: np.nan if dtype == "float64" else 0 if dtype == "int64" else "" for n, dtype in OBJECT_FIELDS.items()}
    rows = [
        blank | {"object_id": i, "class": kind, "kind": kind, "score": score, "point_count": 100 * i, "height": 3.0}
        | {"x": 500.0 + x, "y": 900.0 + y, "z": 12.0, "width": 1.0, "length": 2.0, "heading": 10.0}
        for i, ((kind, x, y), score) in enumerate(zip(places, scores, strict=False), start=1)
    ]  # fmt: skip
    return pd.DataFrame(rows)[list(OBJECT_FIELDS)].astype(OBJECT_FIELDS)


def save_as_tables(source: Path, target: Path) -> None:
    """Save a GeoPackage under another name with its layers as tables, as QGIS does, in place of views."""
    for layer in pyogrio.list_layers(source)[:, 0]:
        frame = pyogrio.read_dataframe(source, layer=layer)
        if "geometry" in frame:
            kind = pyogrio.read_info(source, layer=layer)["geometry_type"]
            pyogrio.write_dataframe(frame, target, layer=layer, driver="GPKG", geometry_type=kind)


def write_inventory(folder: Path, table: pd.DataFrame) -> None:
    inventory = RoadInventory(table, "EPSG:25832")
    write_geopackage(inventory, folder / "inventory.gpkg")
    write_geoparquet(inventory, folder / "inventory.parquet")
