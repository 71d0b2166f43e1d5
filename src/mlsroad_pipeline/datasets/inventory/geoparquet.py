"""Road inventory as GeoParquet 1.1: one table for databases, notebooks and cloud storage."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import shapely
from pyproj import CRS

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.inventory.table import FIELDS, OBJECT_FIELDS
from mlsroad_pipeline.datasets.inventory.road_inventory import (
    RoadInventory,
    attributes,
    base_points,
    checked,
    footprint_text,
    hulls,
    with_empty_text,
)
from mlsroad_pipeline.formats.files import atomic_file

VERSION = "1.1.0"
_CORNERS = ("xmin", "ymin", "xmax", "ymax")
_TYPES = {"int64": pa.int64(), "float64": pa.float64(), "str": pa.string()}


def _geo_metadata(points: np.ndarray, footprints: np.ndarray, crs: CRS | None) -> dict[str, Any]:
    """Return the file metadata that GeoParquet 1.1 requires."""
    system = None if crs is None else crs.to_json_dict()
    columns: dict[str, dict[str, Any]] = {
        "geometry": {"encoding": "WKB", "geometry_types": ["Point Z"], "crs": system},
        "footprint": {
            "encoding": "WKB",
            "geometry_types": ["Polygon"],
            "crs": system,
            "orientation": "counterclockwise",
            "edges": "planar",
        },
    }
    columns["geometry"]["covering"] = {"bbox": {corner: ["bbox", corner] for corner in _CORNERS}}
    if len(points):
        xyz = shapely.get_coordinates(points, include_z=True)
        columns["geometry"]["bbox"] = [*xyz.min(axis=0).tolist(), *xyz.max(axis=0).tolist()]
        if not shapely.is_missing(footprints).all():
            columns["footprint"]["bbox"] = shapely.total_bounds(footprints).tolist()
    return {"version": VERSION, "primary_column": "geometry", "columns": columns}


def _boxes(points: np.ndarray) -> pa.StructArray:
    xy = shapely.get_coordinates(points)
    arrays = [pa.array(xy[:, axis], pa.float64()) for axis in (0, 1, 0, 1)]
    return pa.StructArray.from_arrays(arrays, fields=[pa.field(corner, pa.float64()) for corner in _CORNERS])


def write_geoparquet(inventory: RoadInventory, path: str | Path) -> None:
    """Write an inventory as a GeoParquet file.

    `geometry` holds the base points and `footprint` the polygons, both as WKB; `bbox` covers `geometry`. Every other
    column carries its description as field metadata. The file is written atomically, and equal inventories give equal
    bytes. The trajectory is not written.

    Parameters
    ----------
    inventory : RoadInventory
        The objects and their coordinate reference system.
    path : str or Path
        The file, replaced if it exists.

    Raises
    ------
    DataError
        If a column of `OBJECT_FIELDS` is missing or the CRS is not understood; the message names the file.
    """
    target = Path(path)
    table, crs = checked(inventory, target)
    points, footprints = base_points(table), hulls(table)
    columns, fields = [], []
    for name, values in attributes(table).items():
        field = FIELDS[str(name)]
        columns.append(pa.array(values, _TYPES[field.dtype], from_pandas=True))
        metadata = {"alias": field.alias, "description": field.description}
        fields.append(pa.field(str(name), _TYPES[field.dtype], metadata=metadata))
    columns += [pa.array(shapely.to_wkb(shapes), pa.binary()) for shapes in (points, footprints)]
    fields += [pa.field(name, pa.binary()) for name in ("geometry", "footprint")]
    boxes = _boxes(points)
    schema = pa.schema([*fields, pa.field("bbox", boxes.type)])
    schema = schema.with_metadata({"geo": json.dumps(_geo_metadata(points, footprints, crs))})
    with atomic_file(target) as stream:
        pq.write_table(pa.Table.from_arrays([*columns, boxes], schema=schema), stream, compression="zstd")


def read_geoparquet(path: str | Path) -> RoadInventory:
    """Read an inventory from a GeoParquet file of `write_geoparquet`.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    RoadInventory
        Objects and CRS as WKT, without the trajectory.

    Raises
    ------
    ReadError
        If the file is missing, is not GeoParquet, or lacks a column of the inventory.
    """
    source = Path(path)
    if not source.is_file():
        raise ReadError(f"{source}: no such GeoParquet file")
    try:
        table = pq.read_table(source)
    except pa.ArrowInvalid as error:
        raise ReadError(f"{source}: not a Parquet file") from error
    metadata = table.schema.metadata or {}
    if b"geo" not in metadata:
        raise ReadError(f"{source}: Parquet without the metadata of GeoParquet")
    missing = [name for name in OBJECT_FIELDS if name not in table.column_names]
    if missing:
        raise ReadError(f"{source}: no column {missing[0]!r}")
    objects = table.select(list(OBJECT_FIELDS)).to_pandas()
    objects["footprint"] = footprint_text(shapely.from_wkb(objects["footprint"].to_numpy(dtype=object)))
    system = json.loads(metadata[b"geo"])["columns"]["geometry"]["crs"]
    crs = None if system is None else CRS.from_json_dict(system).to_wkt()
    return RoadInventory(with_empty_text(objects).astype(OBJECT_FIELDS), crs)
