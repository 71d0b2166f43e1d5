"""GeoParquet: metadata of the specification, other readers, equal bytes, atomic writes."""

import json
import os
import struct

import geopandas as gpd
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import shapely
from pyproj import CRS

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.inventory.objects.table import FIELDS, OBJECT_FIELDS, empty_table
from mlsroad_pipeline.datasets.inventory_dataset import RoadInventoryDataset
from mlsroad_pipeline.inventory_files.geoparquet import read_geoparquet, write_geoparquet
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory

SQUARE = "POLYGON ((583001.00 4477000.00, 583001.50 4477000.00, 583001.50 4477000.50, 583001.00 4477000.00))"


@pytest.fixture
def inventory():
    row = {
        name: np.nan if dtype == "float64" else 0 if dtype == "int64" else "" for name, dtype in OBJECT_FIELDS.items()
    }
    rows = [
        row | {"object_id": i, "class": "c", "kind": "pole", "x": 583_000.0 + i, "y": 4_477_000.5, "z": 12.25}
        for i in (1, 2, 3)
    ]
    rows[0] |= {"footprint": SQUARE, "tilt": 1.5, "method": "any_method"}
    return RoadInventory(pd.DataFrame(rows)[list(OBJECT_FIELDS)].astype(OBJECT_FIELDS), "EPSG:25832")


def test_metadata_of_the_file(inventory, tmp_path):
    path = tmp_path / "inventory.parquet"
    write_geoparquet(inventory, path)
    schema = pq.read_schema(path)
    geo = json.loads(schema.metadata[b"geo"])
    assert (geo["version"], geo["primary_column"]) == ("1.1.0", "geometry")
    points, hulls = geo["columns"]["geometry"], geo["columns"]["footprint"]
    assert (points["encoding"], points["geometry_types"]) == ("WKB", ["Point Z"])
    assert points["bbox"] == [583_001.0, 4_477_000.5, 12.25, 583_003.0, 4_477_000.5, 12.25]
    assert points["covering"]["bbox"]["ymax"] == ["bbox", "ymax"]
    assert (hulls["geometry_types"], hulls["bbox"]) == (["Polygon"], [583_001.0, 4_477_000.0, 583_001.5, 4_477_000.5])
    assert CRS.from_json_dict(points["crs"]) == CRS.from_epsg(25832)
    assert schema.field("tilt").metadata[b"description"].decode() == FIELDS["tilt"].description
    assert schema.names == [*(n for n in FIELDS if n != "footprint"), "geometry", "footprint", "bbox"]


def test_geometries_are_wkb_and_what_is_not_known_is_null(inventory, tmp_path):
    path = tmp_path / "inventory.parquet"
    write_geoparquet(inventory, path)
    rows = pq.read_table(path).to_pylist()
    assert rows[0]["geometry"] == struct.pack("<BI3d", 1, 1001, 583_001.0, 4_477_000.5, 12.25)
    assert rows[0]["bbox"] == {"xmin": 583_001.0, "ymin": 4_477_000.5, "xmax": 583_001.0, "ymax": 4_477_000.5}
    assert shapely.from_wkb(rows[0]["footprint"]).equals(shapely.from_wkt(SQUARE))
    assert (rows[0]["tilt"], rows[0]["method"]) == (1.5, "any_method")
    assert [rows[1][name] for name in ("footprint", "tilt", "method", "facing_from")] == [None] * 4


def test_geopandas_reads_it_also_by_place(inventory, tmp_path):
    path = tmp_path / "inventory.parquet"
    write_geoparquet(inventory, path)
    frame = gpd.read_parquet(path)
    assert frame.crs.to_epsg() == 25832
    assert frame.geometry.iloc[2].coords[0] == (583_003.0, 4_477_000.5, 12.25)
    assert len(gpd.read_parquet(path, bbox=(583_001.5, 0, 583_002.5, 5e6))) == 1


@pytest.mark.parametrize("crs", ["EPSG:25832", None])
def test_round_trip(inventory, tmp_path, crs):
    dataset = RoadInventoryDataset(filepath=str(tmp_path / "out" / "inventory.parquet"))
    assert not dataset.exists()
    dataset.save(RoadInventory(inventory.objects, crs))
    back = dataset.load()
    pd.testing.assert_frame_equal(back.objects, inventory.objects)
    assert back.crs is None if crs is None else CRS.from_user_input(back.crs).to_epsg() == 25832


def test_an_empty_inventory_is_a_file_with_typed_columns(tmp_path):
    path = tmp_path / "inventory.parquet"
    write_geoparquet(RoadInventory(empty_table(OBJECT_FIELDS)), path)
    pd.testing.assert_frame_equal(read_geoparquet(path).objects, empty_table(OBJECT_FIELDS))
    assert json.loads(pq.read_schema(path).metadata[b"geo"])["columns"]["geometry"]["crs"] is None
    assert len(gpd.read_parquet(path)) == 0


def test_same_inventory_same_bytes(inventory, tmp_path):
    for name in ("a", "b"):
        write_geoparquet(inventory, tmp_path / f"{name}.parquet")
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()


def test_a_failed_write_leaves_the_old_file_and_nothing_else(inventory, tmp_path, monkeypatch):
    path = tmp_path / "inventory.parquet"
    write_geoparquet(inventory, path)
    before = path.read_bytes()

    def fail(*_, **__):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_geoparquet(RoadInventory(inventory.objects.head(1)), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_bad_input_is_named(inventory, tmp_path):
    path = tmp_path / "x.parquet"
    with pytest.raises(DataError, match=r"x\.parquet: the inventory lacks the column 'tilt'"):
        write_geoparquet(RoadInventory(inventory.objects.drop(columns="tilt")), path)
    with pytest.raises(DataError, match=r"x\.parquet: the coordinate reference system 'nowhere' is not understood"):
        write_geoparquet(RoadInventory(inventory.objects, "nowhere"), path)
    with pytest.raises(ReadError, match="no such GeoParquet file"):
        read_geoparquet(path)
    path.write_text("not a table")
    with pytest.raises(ReadError, match=r"x\.parquet: not a Parquet file"):
        read_geoparquet(path)
    pq.write_table(pa.table({"a": [1]}), path)
    with pytest.raises(ReadError, match="without the metadata of GeoParquet"):
        read_geoparquet(path)
    gpd.GeoDataFrame({"a": [1]}, geometry=gpd.points_from_xy([0], [0]), crs=4326).to_parquet(path)
    with pytest.raises(ReadError, match="no column 'object_id'"):
        read_geoparquet(path)
