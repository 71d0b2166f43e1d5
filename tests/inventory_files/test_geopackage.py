"""GeoPackages: typed layers with aliases and styles, equal bytes, atomic writes."""

import json
import sqlite3
from contextlib import closing
from dataclasses import replace
from xml.etree import ElementTree

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.inventory.lines.extraction import LINE_FIELDS
from mlsroad_pipeline.algorithms.inventory.objects.sections import section_table
from mlsroad_pipeline.algorithms.inventory.objects.table import FIELDS, FIELDS_OF_KINDS, OBJECT_FIELDS, empty_table
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.datasets.inventory_dataset import RoadInventoryDataset
from mlsroad_pipeline.inventory_files import geopackage
from mlsroad_pipeline.inventory_files.geopackage import read_geopackage, write_geopackage
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory, vehicle_boxes
from mlsroad_pipeline.label.inventory import as_of_files

WRITTEN = [name for name in OBJECT_FIELDS if name != "footprint"]
SQUARE = "POLYGON ((583001.00 4477000.00, 583001.50 4477000.00, 583001.50 4477000.50, 583001.00 4477000.00))"


@pytest.fixture
def inventory():
    rows = []
    for number, kind in enumerate(["pole", "sign", "vehicle", "tree"], start=1):
        unknown = {"float64": np.nan, "int64": 0, "str": ""}
        row = {name: unknown[dtype] for name, dtype in OBJECT_FIELDS.items()}
        row |= {
            "object_id": number,
            "class": f"{kind}s",
            "kind": kind,
            "scene": "scene_00000",
            "point_count": 9,
            "facing_from": "post" if kind == "sign" else "",
            "method": "any_method",
            "footprint": "" if kind == "sign" else SQUARE,
        }
        row |= {"x": 583_000.0 + number, "y": 4_477_000.0, "z": 120.0, "height": 3.0, "width": 2.0}
        rows.append(row | ({"length": 4.0, "heading": 30.0} if kind == "vehicle" else {}))
    objects = pd.DataFrame(rows)[list(OBJECT_FIELDS)].astype(OBJECT_FIELDS)
    path = Trajectory.from_positions([[583_000.0, 4_477_000, 120], [583_010.0, 4_477_000, 121]])
    return RoadInventory(objects, "EPSG:25832", path, section_table(objects, path.length))


def layers(path):
    return {str(name): str(kind) for name, kind in pyogrio.list_layers(path) if kind is not None}


def query(path, statement):
    with closing(sqlite3.connect(path)) as base:
        return base.execute(statement).fetchall()


def test_lines_are_a_layer_of_each_kind_and_read_again(inventory, tmp_path):
    path = tmp_path / "inventory.gpkg"
    row = {name: 1.5 for name in LINE_FIELDS} | {"line_id": 1, "kind": "kerb", "offset": np.nan, "pattern": ""}
    row |= dict.fromkeys(("score", "sag", "clearance", "width", "contrast"), np.nan)
    row["line"] = "LINESTRING Z (583000.000 4477000.000 120.000, 583003.000 4477004.000 120.250)"
    no_kerb = {"score": 0.5, "sag": 1.5} | dict.fromkeys(("height", "least_height", "most_height"), np.nan)
    lines = pd.DataFrame([row, row | {"line_id": 2, "kind": "wire"} | no_kerb]).astype(
        {name: field.dtype for name, field in LINE_FIELDS.items()}
    )
    write_geopackage(replace(inventory, lines=lines), path)
    assert layers(path)["kerbs"] == layers(path)["wires"] == "LineString Z"
    pd.testing.assert_frame_equal(read_geopackage(path).lines, lines)
    names = query(path, "SELECT name FROM gpkg_data_columns WHERE table_name = 'kerbs'")
    assert ("From station [m]",) in names and ("Sag [m]",) not in names
    assert query(path, "SELECT count(*) FROM layer_styles WHERE f_table_name = 'kerbs'") == [(1,)]
    write_geopackage(replace(inventory, lines=lines[:0]), path)
    assert len(read_geopackage(path).lines) == 0
    write_geopackage(inventory, path)
    assert read_geopackage(path).lines is None


def test_layers_fields_and_crs(inventory, tmp_path):
    path = tmp_path / "inventory.gpkg"
    write_geopackage(inventory, path)
    assert layers(path) == {
        "objects": "Point Z",
        "poles": "Point Z",
        "signs": "Point Z",
        "trees": "Point Z",
        "vehicles": "Polygon Z",
        "footprints": "Polygon",
        "trajectory": "LineString Z",
        "sections": "LineString Z",
    }
    of_kinds = {"panel_width": "signs", "crown_diameter": "trees", "length": "vehicles", "pole_id": "signs"}
    for layer in ("objects", "poles", "signs", "trees", "vehicles"):
        info = pyogrio.read_info(path, layer=layer)
        own = list(info["fields"])
        assert own == [name for name in WRITTEN if name in own] and {*WRITTEN} - {*own} <= {*FIELDS_OF_KINDS}
        assert {name for name in of_kinds if name in own} == {
            name for name, where in of_kinds.items() if layer in (where, "objects")
        }
        assert dict(zip(info["fields"], info["dtypes"], strict=True))["height"] == "float64"
        assert dict(zip(info["fields"], info["dtypes"], strict=True))["point_count"] == "int64"
        assert info["crs"] == "EPSG:25832"
    poles = gpd.read_file(path, layer="poles")
    assert poles.geometry.iloc[0].coords[0] == (583_001.0, 4_477_000.0, 120.0)
    assert gpd.read_file(path, layer="trajectory")["length"].tolist() == [10.0]


def test_footprints_are_polygons_with_their_area(inventory, tmp_path):
    path = tmp_path / "inventory.gpkg"
    write_geopackage(inventory, path)
    found = gpd.read_file(path, layer="footprints")
    assert found["object_id"].tolist() == [1, 3, 4]  # the sign's points have no area
    np.testing.assert_allclose(found["area"], 0.125, atol=0.005)
    assert shapely.is_valid(found.geometry).all()


def test_missing_values_are_null(inventory, tmp_path):
    path = tmp_path / "inventory.gpkg"
    write_geopackage(inventory, path)
    assert query(path, "SELECT tilt, model_version, method FROM poles") == [(None, None, "any_method")]
    assert query(path, "SELECT facing_from FROM signs") == [("post",)]


def test_fields_have_names_with_units(inventory, tmp_path):
    path = tmp_path / "inventory.gpkg"
    write_geopackage(inventory, path)
    rows = query(path, "SELECT column_name, name, description FROM gpkg_data_columns WHERE table_name = 'poles'")
    assert {name: (alias, text) for name, alias, text in rows} == {
        n: FIELDS[n][1:3] for n in WRITTEN if "pole" in FIELDS_OF_KINDS.get(n, ("pole",))
    }
    extensions = query(path, "SELECT table_name FROM gpkg_extensions WHERE extension_name = 'gpkg_schema'")
    assert {name for (name,) in extensions} == {"gpkg_data_columns", "gpkg_data_column_constraints"}


def test_every_layer_has_a_style_under_the_names_that_qgis_looks_for(inventory, tmp_path):
    path = tmp_path / "inventory.gpkg"
    write_geopackage(inventory, path)
    rows = query(path, "SELECT f_table_name, f_geometry_column, useAsDefault, styleQML FROM layer_styles")
    geometry = dict(query(path, "SELECT table_name, column_name FROM gpkg_geometry_columns"))
    assert {layer: column for layer, column, *_ in rows} == geometry
    for _, _, default, style in rows:
        assert default == 1
        assert ElementTree.fromstring(style).tag == "qgis"
    assert query(path, "SELECT data_type FROM gpkg_contents WHERE table_name = 'layer_styles'") == [("attributes",)]


def test_the_data_base_is_sound(inventory, tmp_path):
    path = tmp_path / "inventory.gpkg"
    write_geopackage(inventory, path)
    assert query(path, "PRAGMA integrity_check") == [("ok",)]
    assert query(path, "PRAGMA foreign_key_check") == []
    assert query(path, "PRAGMA application_id") == [(0x47504B47,)]  # "GPKG"
    assert query(path, "PRAGMA user_version") == [(10200,)]
    views = {name for (name,) in query(path, "SELECT name FROM sqlite_master WHERE type = 'view'")}
    assert views == {"poles", "signs", "trees", "vehicles"}  # they have the index of `objects`
    for layer in {*layers(path)} - views:
        (count,) = query(path, f"SELECT COUNT(*) FROM {layer}")[0]
        assert query(path, f"SELECT COUNT(*) FROM rtree_{layer}_geom") == [(count,)]
    contents = {name for (name,) in query(path, "SELECT table_name FROM gpkg_contents")}
    assert contents == {*layers(path), "layer_styles"}


def test_vehicle_footprint_is_its_oriented_box(inventory):
    vehicle = inventory.objects[inventory.objects["kind"] == "vehicle"]
    shape = vehicle_boxes(vehicle)[0]
    assert shape.area == pytest.approx(8.0)
    assert shape.exterior.is_ccw
    corners = np.array(shape.exterior.coords)[:-1, :2] - [583_003.0, 4_477_000.0]
    ahead = np.array([np.sin(np.radians(30)), np.cos(np.radians(30))])
    np.testing.assert_allclose(np.sort(corners @ ahead), [-2, -2, 2, 2], atol=1e-8)


def test_round_trip(inventory, tmp_path):
    dataset = RoadInventoryDataset(filepath=str(tmp_path / "out" / "inventory.gpkg"))
    assert not dataset.exists()
    dataset.save(inventory)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["inventory.gpkg", "inventory.qml"]
    back = dataset.load()
    pd.testing.assert_frame_equal(back.objects, inventory.objects)
    assert "25832" in back.crs
    np.testing.assert_allclose(back.trajectory.xyz, inventory.trajectory.xyz)
    pd.testing.assert_frame_equal(back.sections, inventory.sections, check_dtype=False)
    line = gpd.read_file(dataset.filepath, layer="sections").geometry
    assert line.length.tolist() == pytest.approx(inventory.sections["length"].tolist())


def test_same_inventory_same_bytes(inventory, tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_geopackage(inventory, tmp_path / name / "inventory.gpkg")
    assert (tmp_path / "a" / "inventory.gpkg").read_bytes() == (tmp_path / "b" / "inventory.gpkg").read_bytes()


@pytest.mark.parametrize("crs", [None, "EPSG:25832"])
def test_empty_inventory_has_typed_empty_layers(tmp_path, crs):
    path = tmp_path / "empty.gpkg"
    write_geopackage(RoadInventory(empty_table(OBJECT_FIELDS), crs), path)
    assert set(layers(path)) == {"objects", "poles", "signs", "trees", "vehicles", "footprints"}
    assert pyogrio.read_info(path, layer="vehicles")["geometry_type"] == "Polygon Z"
    back = read_geopackage(path)
    pd.testing.assert_frame_equal(back.objects, empty_table(OBJECT_FIELDS))
    assert (back.crs is None) == (crs is None)
    assert back.trajectory is None


def test_unknown_crs_keeps_the_coordinates(inventory, tmp_path):
    path = tmp_path / "local.gpkg"
    write_geopackage(RoadInventory(inventory.objects), path)
    back = read_geopackage(path)
    assert back.crs is None
    pd.testing.assert_frame_equal(back.objects, inventory.objects)


@pytest.mark.parametrize("crs", ["EPSG:32633", None])
def test_labels_are_seen_without_a_system_too(inventory, tmp_path, crs):
    path = tmp_path / "inventory.gpkg"
    write_geopackage(replace(inventory, crs=crs), path)
    ((style,),) = query(path, "SELECT styleQML FROM layer_styles WHERE f_table_name = 'poles'")
    rendering = ElementTree.fromstring(style).find("labeling/settings/rendering")
    assert rendering.get("scaleVisibility") == ("0" if crs is None else "1")


def test_a_failed_write_leaves_the_old_file_and_nothing_else(inventory, tmp_path, monkeypatch):
    path = tmp_path / "inventory.gpkg"
    write_geopackage(inventory, path)
    before = path.read_bytes()

    def fail(objects):
        raise OSError("disk full")

    monkeypatch.setattr(geopackage.road_inventory, "vehicle_boxes", fail)
    with pytest.raises(OSError, match="disk full"):
        write_geopackage(RoadInventory(inventory.objects.head(2)), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_bad_input_is_named(inventory, tmp_path):
    path = tmp_path / "x.gpkg"
    with pytest.raises(DataError, match=r"x\.gpkg: the inventory lacks the column 'tilt'"):
        write_geopackage(RoadInventory(inventory.objects.drop(columns="tilt")), path)
    with pytest.raises(DataError, match=r"x\.gpkg: the coordinate reference system 'nowhere' is not understood"):
        write_geopackage(RoadInventory(inventory.objects, "nowhere"), path)
    with pytest.raises(ReadError, match="no such GeoPackage"):
        read_geopackage(path)
    path.write_text("not a database")
    with pytest.raises(ReadError, match=r"x\.gpkg: not a GeoPackage"):
        read_geopackage(path)
    path.unlink()
    gpd.GeoDataFrame({"a": [1]}, geometry=gpd.points_from_xy([0], [0]), crs=4326).to_file(path, layer="other")
    with pytest.raises(ReadError, match=r"no layer 'objects' among \['other'\]"):
        read_geopackage(path)
    gpd.GeoDataFrame({"a": [1]}, geometry=gpd.points_from_xy([0], [0]), crs=4326).to_file(path, layer="objects")
    gpd.GeoDataFrame({"a": [1]}, geometry=gpd.points_from_xy([0], [0]), crs=4326).to_file(path, layer="footprints")
    with pytest.raises(ReadError, match="layer 'objects' has no field 'object_id'"):
        read_geopackage(path)


def test_value_lists_descriptions_and_metadata_are_there_for_a_gis(tmp_path, inventory):
    path = tmp_path / "inventory.gpkg"
    write_geopackage(inventory, path)
    lists = "SELECT value FROM gpkg_data_columns JOIN gpkg_data_column_constraints USING (constraint_name)"
    values = query(path, f"{lists} WHERE table_name = 'signs' AND column_name = 'facing_from'")
    assert sorted(values) == [("pole",), ("post",), ("unknown",)]
    assert query(path, "SELECT description FROM gpkg_contents WHERE table_name = 'trees'") == [
        ("Objects of kind tree.",)
    ]
    ((facts,),) = query(path, "SELECT metadata FROM gpkg_metadata JOIN gpkg_metadata_reference ON id = md_file_id")
    facts = json.loads(facts)
    assert facts["models"] == ["any_method"] and facts["trajectoryMetres"] == pytest.approx(10.0, abs=0.1)
    assert read_geopackage(path).objects["facing_from"].tolist() == ["", "post", "", ""]


def test_a_part_that_the_disk_has_lost_is_an_error(tmp_path, monkeypatch):
    """GDAL goes on when a write to the journal of SQLite fails; an index or a trigger is missing then."""
    import sqlite3

    from mlsroad_pipeline.algorithms.inventory.objects.table import OBJECT_FIELDS, empty_table
    from mlsroad_pipeline.inventory_files import geopackage
    from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory

    whole = geopackage.add_tables

    def lossy(path, *arguments, **options):
        whole(path, *arguments, **options)
        with sqlite3.connect(path) as database:
            (trigger,) = database.execute(
                "SELECT name FROM sqlite_master WHERE type = 'trigger' AND name LIKE 'rtree_objects_%'"
            ).fetchone()
            database.execute(f"DROP TRIGGER {trigger}")
        database.close()

    geopackage.write_geopackage(RoadInventory(empty_table(OBJECT_FIELDS), None), tmp_path / "a.gpkg")
    monkeypatch.setattr(geopackage, "add_tables", lossy)
    with pytest.raises(OSError, match="a part of the GeoPackage was not written"):
        geopackage.write_geopackage(RoadInventory(empty_table(OBJECT_FIELDS), None), tmp_path / "b.gpkg")
    assert [path.name for path in tmp_path.iterdir()] == ["a.gpkg"]


def test_report_and_exports_get_from_memory_what_the_file_gives_back(inventory, tmp_path):
    objects = inventory.objects.assign(heading=[-0.0, 0.0, 30.0, np.nan], z=-0.0)
    objects["note"], objects["attr_owner"] = ["leans", "", "", ""], ["", "", "city", ""]
    row = {name: -0.0 for name in LINE_FIELDS} | {"line_id": 1, "kind": "kerb", "pattern": "", "key": "", "status": ""}
    row["line"] = "LINESTRING Z (583000.000 4477000.000 120.000, 583003.000 4477004.000 120.250)"
    dtypes = {name: field.dtype for name, field in LINE_FIELDS.items()}
    lines = pd.DataFrame([{name: row[name] for name in dtypes}]).astype(dtypes)
    given = replace(inventory, objects=objects, lines=lines)
    write_geopackage(given, tmp_path / "inventory.gpkg")
    read, kept = read_geopackage(tmp_path / "inventory.gpkg"), as_of_files(given)
    for name in ("objects", "sections"):
        one, other = getattr(read, name), getattr(kept, name)
        pd.testing.assert_frame_equal(one, other, check_exact=True)
        assert one.to_csv() == other.to_csv()  # which shows negative zeros
    assert np.array_equal(read.trajectory.xyz, kept.trajectory.xyz)
    numbers = [name for name in dtypes if dtypes[name] == "float64" and name in read.lines]
    assert not np.signbit(kept.lines[numbers].to_numpy()).any()
