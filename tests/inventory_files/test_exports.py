"""Exports of the inventory, opened again by GDAL and ezdxf: counts, coordinates, attributes, reference system."""

import shutil
import subprocess

import ezdxf
import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely
from ezdxf.filemanagement import readfile
from helpers.inventories import UTM, planted, planted_inventory
from pyproj import CRS, Transformer

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.lines.extraction import LINE_FIELDS
from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_KINDS
from mlsroad_pipeline.algorithms.inventory.objects.table import FIELDS, OBJECT_FIELDS, empty_table
from mlsroad_pipeline.inventory_files import vector_files
from mlsroad_pipeline.inventory_files.drawing import APPLICATION, ATTRIBUTES
from mlsroad_pipeline.inventory_files.exports import EXPORTS
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory, hulls, line_vertices, vehicle_boxes
from mlsroad_pipeline.inventory_files.vector_files import TEXT_BYTES, short_name
from mlsroad_pipeline.surveys.parameters import EXPORT_FORMATS

WRITTEN = [name for name in FIELDS if name != "footprint"]


@pytest.fixture(scope="module")
def inventory():
    return planted_inventory()


@pytest.fixture(scope="module")
def folder(inventory, tmp_path_factory):
    """Every format, twice."""
    first, second = (tmp_path_factory.mktemp(name) for name in ("first", "second"))
    for form in EXPORTS.values():
        for target in (first, second):
            form.write(inventory, target)
    for path in first.rglob("*.*"):
        assert path.read_bytes() == (second / path.relative_to(first)).read_bytes(), path
    return first


def check_attributes(found, expected, names=WRITTEN):
    """Compare the attributes of a file with those of the inventory, by object; NULL stands for NaN and no text."""
    found, expected = (table.sort_values("object_id").reset_index(drop=True) for table in (found, expected))
    assert found["object_id"].tolist() == expected["object_id"].tolist()
    for name in names:
        if FIELDS[name].dtype == "str":
            assert found[name].astype(object).fillna("").tolist() == expected[name].tolist(), name
        else:
            np.testing.assert_array_equal(found[name].astype(float), expected[name].astype(float), err_msg=name)


def points(frame):
    return shapely.get_coordinates(frame.sort_values("object_id").geometry.array, include_z=True)


def test_formats_are_those_of_the_parameter_and_their_files_are_all_that_is_written(folder):
    assert tuple(EXPORTS) == EXPORT_FORMATS
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*.*")}
    assert files == {name for form in EXPORTS.values() for name in (*form.files, *form.others)}


def test_csv(inventory, folder):
    table = inventory.objects
    pd.testing.assert_frame_equal(pd.read_csv(folder / "sections.csv"), inventory.sections)
    found = pd.read_csv(folder / "inventory.csv")
    check_attributes(found, table, list(FIELDS))
    options = {"X_POSSIBLE_NAMES": "x", "Y_POSSIBLE_NAMES": "y", "Z_POSSIBLE_NAMES": "z", "KEEP_GEOM_COLUMNS": "YES"}
    read = gpd.GeoDataFrame(pyogrio.read_dataframe(folder / "inventory.csv", **options))
    np.testing.assert_array_equal(points(read), table[["x", "y", "z"]])
    assert {name: str(read[name].dtype) for name in ("object_id", "score")} == {
        "object_id": "int64",
        "score": "float64",
    }
    assert CRS((folder / "inventory.prj").read_text()).to_epsg(min_confidence=60) == 25833


def test_geojson_is_in_longitudes_and_latitudes(inventory, folder):
    table = inventory.objects
    found = gpd.read_file(folder / "inventory.geojson")
    assert found.crs.to_epsg() == 4979  # WGS 84 with heights
    check_attributes(found, table)
    assert set(found["crs"]) == {UTM}
    back = Transformer.from_crs("OGC:CRS84", UTM, always_xy=True).transform(*points(found).T[:2])
    np.testing.assert_allclose(np.column_stack([*back, points(found)[:, 2]]), table[["x", "y", "z"]], atol=1e-3)
    assert points(found)[0, 0] == pytest.approx(13.4, abs=0.1)


def test_lines_are_the_same_in_every_format(inventory, folder):
    table = inventory.lines
    vertices = np.array(line_vertices(table))
    assert vertices.shape == (len(LINE_KINDS), 2, 3) and vertices[0, 1].tolist() == [391_004.25, 5_820_004.5, 34.5]
    pd.testing.assert_frame_equal(pd.read_csv(folder / "lines.csv"), table)
    columns = [name for name in LINE_FIELDS if name != "line"]
    for path in (
        folder / "lines.fgb",
        folder / "lines.geojson",
        folder / "inventory_lines.gml",
        folder / "inventory_shp" / "lines.shp",
    ):
        found = gpd.read_file(path).sort_values("line_id")
        found = found.rename(columns={short_name(name): name for name in columns}).to_crs(UTM)
        pd.testing.assert_frame_equal(
            pd.DataFrame(found[columns]).reset_index(drop=True), table[columns], check_dtype=False
        )
        read = np.array([shapely.get_coordinates(line, include_z=True) for line in found.geometry])
        np.testing.assert_allclose(read, vertices, atol=1e-3)
    drawn = readfile(folder / "inventory.dxf").modelspace().query('POLYLINE[layer!="trajectory"]')
    assert [line.dxf.layer for line in drawn] == list(LINE_KINDS)
    assert [list(map(tuple, line.points())) for line in drawn] == [list(map(tuple, line)) for line in vertices]
    assert [line.get_xdata(APPLICATION)[0].value for line in drawn] == list(range(1, len(LINE_KINDS) + 1))


def test_flatgeobuf(inventory, folder):
    found = gpd.read_file(folder / "inventory.fgb")
    assert found.crs.to_epsg() == 25833
    check_attributes(found, inventory.objects)
    np.testing.assert_array_equal(points(found), inventory.objects[["x", "y", "z"]])


def test_gml(inventory, folder):
    found = gpd.read_file(folder / "inventory.gml")
    assert found.crs.to_epsg() == 25833 and len(found) == len(inventory.objects)
    check_attributes(found, inventory.objects)
    np.testing.assert_array_equal(points(found), inventory.objects[["x", "y", "z"]])
    assert 'schemaLocation="http://ogr.maptools.org/ inventory.xsd"' in (folder / "inventory.gml").read_text("utf-8")


def test_a_system_without_a_code_is_missing_in_gml_and_said_so(inventory, tmp_path, caplog):
    own = "+proj=tmerc +lon_0=13.1 +x_0=7000 +ellps=bessel +units=m"
    vector_files.write_gml(RoadInventory(inventory.objects, own), tmp_path / "x.gml")
    assert gpd.read_file(tmp_path / "x.gml").crs is None and "x.gml has no reference system" in caplog.text


def test_shapefile(inventory, folder, tmp_path, caplog):
    table, shapes = inventory.objects, folder / "inventory_shp"
    names = pd.read_csv(shapes / "fields.csv")
    further = [name for name in LINE_FIELDS if name not in (*WRITTEN, "line")]
    assert names["field"].tolist() == [*WRITTEN, *further] and names["shapefile_field"].str.len().max() <= 10
    assert names["shapefile_field"].is_unique
    read = gpd.read_file(shapes / "objects.shp")
    assert read.crs.to_epsg(min_confidence=60) == 25833
    read = read.rename(columns=dict(zip(names["shapefile_field"], names["field"], strict=True)))
    cut = table.assign(reasons=[text.encode()[:TEXT_BYTES].decode(errors="ignore") for text in table["reasons"]])
    assert (cut["reasons"] != table["reasons"]).sum() == 1
    check_attributes(read, cut)
    np.testing.assert_array_equal(points(read), table[["x", "y", "z"]])
    cars = gpd.read_file(shapes / "vehicles.shp")
    expected = vehicle_boxes(table[table["kind"] == "vehicle"])
    assert shapely.equals_exact(shapely.normalize(cars.geometry.array), shapely.normalize(expected), 1e-9).all()
    outlines = gpd.read_file(shapes / "footprints.shp")
    assert outlines["object_id"].tolist() == [1, 3, 4, 5, 6]
    kept = [shape for shape in hulls(table) if shape is not None]
    assert shapely.equals(outlines.geometry.array, kept).all()
    line = gpd.read_file(shapes / "trajectory.shp")
    np.testing.assert_array_equal(
        shapely.get_coordinates(line.geometry.array, include_z=True), inventory.trajectory.xyz
    )
    vector_files.write_shapefile(inventory, tmp_path)
    assert "1 texts are cut to 254 bytes" in caplog.text


def test_no_two_fields_share_a_short_name():
    assert len({short_name(name) for name in FIELDS}) == len(FIELDS)
    assert all(len(short_name(name)) <= 10 for name in WRITTEN)


def test_dxf_by_ezdxf(inventory, folder):
    table = inventory.objects
    doc = readfile(folder / "inventory.dxf")
    assert not doc.audit().errors and doc.units == ezdxf.units.M
    assert doc.header.custom_vars.properties == [("CRS", UTM)]
    placed = list(doc.modelspace().query("INSERT"))
    np.testing.assert_array_equal([tuple(block.dxf.insert) for block in placed], table[["x", "y", "z"]])
    assert [b.dxf.name for b in placed] == ["POLE", "SIGN", "SIGN_BOTH", "SIGN_PLAIN", "VEHICLE", "TREE"]
    assert [b.dxf.layer for b in placed] == ["pole", "sign", "sign", "sign", "vehicle_car_van", "tree"]
    assert (placed[1].dxf.rotation, placed[4].dxf.rotation, placed[5].dxf.xscale) == (-90.0, -30.0, 6.5)
    for block, row in zip(placed, table.to_dict("records"), strict=True):
        held = {attribute.dxf.tag.lower(): attribute.dxf.text for attribute in block.attribs}
        assert held == {name: str(row[name]) for name in ATTRIBUTES if row[name] != "" and row[name] == row[name]}
        assert all(attribute.is_invisible for attribute in block.attribs)
    outlines = list(doc.modelspace().query("LWPOLYLINE"))
    assert [line.get_xdata(APPLICATION)[0].value for line in outlines] == [1, 3, 4, 5, 6]
    kept = [shape for shape in hulls(table) if shape is not None]
    for line, shape in zip(outlines, kept, strict=True):
        assert line.closed and line.dxf.elevation == 34.25
        np.testing.assert_array_equal(line.get_points("xy"), shapely.get_coordinates(shape)[:-1])
    (path,) = doc.modelspace().query('POLYLINE[layer=="trajectory"]')
    np.testing.assert_array_equal([tuple(vertex.dxf.location) for vertex in path.vertices], inventory.trajectory.xyz)
    assert CRS((folder / "inventory.prj").read_text()).to_epsg(min_confidence=60) == 25833


def test_dxf_by_gdal(inventory, folder):
    pyogrio.set_gdal_config_options({"DXF_INLINE_BLOCKS": "FALSE"})
    try:
        read = pyogrio.read_dataframe(folder / "inventory.dxf", layer="entities")
    finally:
        pyogrio.set_gdal_config_options({"DXF_INLINE_BLOCKS": None})
    blocks = read[read["BlockName"].notna()]
    np.testing.assert_array_equal(
        shapely.get_coordinates(blocks.geometry.array, include_z=True), inventory.objects[["x", "y", "z"]]
    )
    assert [held[0] for held in blocks["BlockAttributes"]] == [f"OBJECT_ID {i}" for i in range(1, 7)]
    assert (read["Layer"].str.endswith("_footprint")).sum() == 5


@pytest.mark.skipif(shutil.which("ogrinfo") is None, reason="GDAL's own programs are not installed (gdal-bin)")
@pytest.mark.parametrize("name", ["inventory.geojson", "inventory.fgb", "inventory_shp/objects.shp"])
def test_ogrinfo_counts_the_objects(folder, name):
    done = subprocess.run(
        ["ogrinfo", "-ro", "-so", "-al", str(folder / name)], capture_output=True, text=True, check=True
    )
    assert "Feature Count: 6" in done.stdout


# Of an empty Shapefile with heights GDAL cannot tell that it has no measures along lines.
@pytest.mark.filterwarnings("ignore:Measured .M. geometry types:UserWarning")
@pytest.mark.parametrize("name", ["csv", "flatgeobuf", "shapefile", "gml", "dxf"])
def test_without_system_objects_and_path(name, tmp_path):
    written = EXPORTS[name].write(RoadInventory(empty_table(OBJECT_FIELDS)), tmp_path)
    assert sorted(written) == sorted(tmp_path / file for file in EXPORTS[name].files)
    if name in ("flatgeobuf", "shapefile", "gml"):
        found = gpd.read_file(written[0])
        assert len(found) == 0 and {short_name(field) if name == "shapefile" else field for field in WRITTEN} <= {
            *found
        }


@pytest.mark.parametrize(
    ("crs", "message"),
    [
        (None, "GeoJSON needs longitudes and latitudes, and the survey has no coordinate reference system"),
        ('LOCAL_CS["plant",UNIT["metre",1]]', "'plant' cannot be transformed to longitude and latitude"),
    ],
)
def test_geojson_of_a_survey_without_a_place_on_the_earth_is_refused(inventory, crs, message, tmp_path):
    with pytest.raises(DataError, match=message):
        EXPORTS["geojson"].write(RoadInventory(inventory.objects, crs), tmp_path)
    assert not list(tmp_path.iterdir())


def test_no_text_of_a_csv_is_a_formula(tmp_path):
    objects = pd.DataFrame([planted(1, "pole", **{"class": '=HYPERLINK("http://x")'})])
    sections = pd.DataFrame(
        {"section": ["@SUM(A1)", "+1", "B"], "from_station": [-1.0, 0, 1], "to_station": [0.0, 1, 2]}
    )
    vector_files.write_csv(RoadInventory(objects, CRS(UTM), None, sections), tmp_path)
    table, given = pd.read_csv(tmp_path / "inventory.csv"), pd.read_csv(tmp_path / "sections.csv")
    assert table["class"].tolist() == ["""'=HYPERLINK("http://x")"""]
    assert given["section"].tolist() == ["'@SUM(A1)", "'+1", "B"]
    assert given["from_station"].tolist() == [-1, 0, 1]
