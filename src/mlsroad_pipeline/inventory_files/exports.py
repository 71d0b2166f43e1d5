"""Formats of an inventory: GeoPackage and GeoParquet by extension, and those that `label` writes on request."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from mlsroad_pipeline.formats.files import write_atomic
from mlsroad_pipeline.inventory_files.geopackage import read_geopackage, write_geopackage
from mlsroad_pipeline.inventory_files.geoparquet import read_geoparquet, write_geoparquet
from mlsroad_pipeline.inventory_files.qgis_styles import qml
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory
from mlsroad_pipeline.inventory_files.vector_files import (
    write_csv,
    write_flatgeobuf,
    write_geojson,
    write_gml,
    write_shapefile,
)


class InventoryFormat(NamedTuple):
    """Functions that read and write an inventory in a format."""

    read: Callable[[Path], RoadInventory]
    write: Callable[[RoadInventory, Path], list[Path]]  # returns the paths of the written files


def _write_styled_geopackage(inventory: RoadInventory, path: Path) -> list[Path]:
    style = path.with_suffix(".qml")
    write_geopackage(inventory, path)
    write_atomic(style, qml("objects").encode())
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


class Export(NamedTuple):
    """Format of an inventory."""

    # Function that writes the files of an inventory into a folder and returns their paths
    write: Callable[[RoadInventory, Path], list[Path]]
    files: tuple[str, ...]  # Paths in the folder of the files that are always written
    # Paths of the files that are written only with a coordinate reference system or a trajectory
    others: tuple[str, ...] = ()


def _write_dxf(inventory: RoadInventory, folder: Path) -> list[Path]:
    from mlsroad_pipeline.inventory_files.drawing import write_dxf  # noqa: PLC0415  few runs need ezdxf

    return write_dxf(inventory, folder)


def _write_gml(inventory: RoadInventory, folder: Path) -> list[Path]:
    return write_gml(inventory, folder / "inventory.gml")


_PARTS = ("shp", "shx", "dbf", "cpg")
_SHAPEFILE = tuple(
    f"inventory_shp/{layer}.{part}" for layer in ("objects", "vehicles", "footprints") for part in _PARTS
)
_LINE = tuple(f"inventory_shp/{layer}.{part}" for layer in ("lines", "trajectory") for part in _PARTS)
_LAYERS = ("objects", "vehicles", "footprints", "lines", "trajectory")
_SYSTEMS = tuple(f"inventory_shp/{layer}.prj" for layer in _LAYERS)

EXPORTS: dict[str, Export] = {
    "csv": Export(write_csv, ("inventory.csv", "inventory.csvt"), ("inventory.prj", "sections.csv", "lines.csv")),
    "geojson": Export(write_geojson, ("inventory.geojson",), ("lines.geojson",)),
    "flatgeobuf": Export(write_flatgeobuf, ("inventory.fgb",), ("lines.fgb",)),
    "shapefile": Export(write_shapefile, (*_SHAPEFILE, "inventory_shp/fields.csv"), (*_LINE, *_SYSTEMS)),
    "gml": Export(_write_gml, ("inventory.gml", "inventory.xsd"), ("inventory_lines.gml", "inventory_lines.xsd")),
    "dxf": Export(_write_dxf, ("inventory.dxf",), ("inventory.prj",)),
}
"""Name in `label.export` to its format; files of one name have the same content in every format."""
