"""Formats in which `label` writes its inventory on request, besides GeoPackage and GeoParquet."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory
from mlsroad_pipeline.inventory_files.vector_files import (
    write_csv,
    write_flatgeobuf,
    write_geojson,
    write_shapefile,
)


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
    "dxf": Export(_write_dxf, ("inventory.dxf",), ("inventory.prj",)),
}
"""Name in `label.export` to its format; files of one name have the same content in every format."""
