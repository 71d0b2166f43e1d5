"""Road inventory as GeoParquet 1.1: one table for databases, notebooks and cloud storage."""

import json
from io import BytesIO
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import shapely

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.inventory.objects.table import FIELDS, OBJECT_FIELDS
from mlsroad_pipeline.formats.files import atomic_file
from mlsroad_pipeline.inventory_files import road_inventory

VERSION = "1.1.0"


def _corrected(metadata: bytes, points: np.ndarray) -> str:
    """Return the metadata of geopandas with the range of heights; `bbox` covers the base points, not the footprints."""
    geo = json.loads(metadata)
    del geo["columns"]["footprint"]["covering"]
    geo["columns"]["footprint"]["orientation"] = "counterclockwise"
    if len(points):
        xyz = shapely.get_coordinates(points, include_z=True)
        geo["columns"]["geometry"]["bbox"] = [*xyz.min(axis=0).tolist(), *xyz.max(axis=0).tolist()]
    return json.dumps(geo)


def _described(field: pa.Field) -> pa.Field:
    """Return a field of a schema with the heading and the definition of its column."""
    if field.name == "footprint" or not (field.name in FIELDS or road_inventory.is_note(field.name)):
        return field
    column = FIELDS.get(field.name) or road_inventory.note_field(field.name)
    return field.with_metadata({"alias": column.alias, "description": column.description})


def write_geoparquet(inventory: road_inventory.RoadInventory, path: str | Path) -> None:
    """Write an inventory as a GeoParquet file.

    `geometry` holds the base points and `footprint` the polygons, both as WKB; `bbox` covers `geometry`. Every other
    column carries its description as field metadata.
    """
    target = Path(path)
    table, crs = road_inventory.checked(inventory, target)
    points = road_inventory.base_points(table)
    columns = road_inventory.attributes(table).astype(
        dict.fromkeys((*road_inventory.MAY_LACK, *road_inventory.note_columns(table)), "str")
    )
    frame = gpd.GeoDataFrame(columns, geometry=gpd.GeoSeries(points, crs=crs))
    frame["footprint"] = gpd.GeoSeries(road_inventory.hulls(table), crs=crs)
    written = BytesIO()
    frame.to_parquet(written, index=False, schema_version=VERSION, write_covering_bbox=True)
    plain = pq.read_table(written)
    metadata = plain.schema.metadata | {b"geo": _corrected(plain.schema.metadata[b"geo"], points)}
    schema = pa.schema([_described(field) for field in plain.schema], metadata=metadata)
    with atomic_file(target) as stream:
        pq.write_table(plain.cast(schema), stream, compression="zstd")


def read_geoparquet(path: str | Path) -> road_inventory.RoadInventory:
    """Read an inventory from a GeoParquet file of `write_geoparquet`."""
    source = Path(path)
    if not source.is_file():
        raise ReadError(f"{source}: no such GeoParquet file")
    try:
        table = gpd.read_parquet(source)
    except pa.ArrowInvalid as error:
        raise ReadError(f"{source}: not a Parquet file") from error
    except ValueError as error:
        raise ReadError(f"{source}: Parquet without the metadata of GeoParquet") from error
    missing = [name for name in OBJECT_FIELDS if name not in table and name not in road_inventory.DECIDED]
    if missing:
        raise ReadError(f"{source}: no column {missing[0]!r}")
    objects = pd.DataFrame(
        table[[name for name in (*OBJECT_FIELDS, *road_inventory.note_columns(table)) if name in table]]
    )
    objects["footprint"] = road_inventory.footprint_text(table["footprint"].to_numpy())
    crs = None if table.crs is None else table.crs.to_wkt()
    return road_inventory.RoadInventory(road_inventory.with_empty_text(objects), crs)
