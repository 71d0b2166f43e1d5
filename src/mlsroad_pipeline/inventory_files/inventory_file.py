"""Inventory in a GeoPackage or a GeoParquet file, by its extension."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from mlsroad_pipeline.formats.files import atomic_file
from mlsroad_pipeline.inventory_files.geopackage import read_geopackage, write_geopackage
from mlsroad_pipeline.inventory_files.geoparquet import read_geoparquet, write_geoparquet
from mlsroad_pipeline.inventory_files.qgis_styles import qml
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory


class InventoryFormat(NamedTuple):
    """Functions that read and write an inventory in a format."""

    read: Callable[[Path], RoadInventory]
    write: Callable[[RoadInventory, Path], list[Path]]  # returns the paths of the written files


def _write_styled_geopackage(inventory: RoadInventory, path: Path) -> list[Path]:
    style = path.with_suffix(".qml")
    write_geopackage(inventory, path)
    with atomic_file(style) as stream:
        stream.write(qml("objects").encode())
    return [style, path]


def _write_geoparquet(inventory: RoadInventory, path: Path) -> list[Path]:
    write_geoparquet(inventory, path)
    return [path]


INVENTORY_FORMATS = {
    ".gpkg": InventoryFormat(read_geopackage, _write_styled_geopackage),
    ".parquet": InventoryFormat(read_geoparquet, _write_geoparquet),
}


def read_inventory(path: Path) -> RoadInventory:
    """Return the inventory of a file with the extension of a known format."""
    return INVENTORY_FORMATS[path.suffix.lower()].read(path)
