"""Virtual point clouds and items of STAC: equal to the files that they name, and read by QGIS, PDAL wrench and pystac."""

import json
import re
import shutil
from pathlib import Path

import laspy
import numpy as np
import pyproj
import pystac
import pytest
import shapely
from helpers.page_output import FILES, write_output
from pystac.extensions.pointcloud import PointcloudExtension
from pystac.extensions.projection import ProjectionExtension
from pystac.validation.local_validator import VERSION, get_local_schema_cache
from typer.testing import CliRunner

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.execution.run_folder import entries_of
from mlsroad_pipeline.formats.las.copc import write_copc
from mlsroad_pipeline.review.corrections import Correction, open_corrections
from mlsroad_pipeline.review.delivery import catalogue
from mlsroad_pipeline.review.delivery.page_order import deliver_order
from mlsroad_pipeline.review.page_server.output_folder import OutputFolder

UTM = pyproj.CRS("EPSG:25833")
CORNER = np.array([389_000.0, 5_819_000.0, 30.0])
FIRST = 412_345_678.25  # adjusted standard GPS time of 7 October 2024
SAMPLE = {
    "feature": {"type", "stac_version", "stac_extensions", "id", "geometry", "bbox", "properties", "links", "assets"},
    "properties": {
        "datetime", "pc:count", "pc:encoding", "pc:schemas", "pc:type", "proj:bbox", "proj:geometry", "proj:wkt2",
    },
    "schema": {"name", "size", "type"},
}  # fmt: skip
"""Keys of the virtual point cloud of PDAL wrench's tests, stadium.vpc, in a feature and below it."""
MORE = {"proj:code", "start_datetime", "end_datetime", "mlsroad:datetime_from"}


def mlsroad(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def place(path, *, crs=UTM, times=True, kept=None, created=None):
    """Put the points of a file on the earth; `kept` is the number of points that stay."""
    old = laspy.read(path)
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales, header.offsets = [0.001] * 3, CORNER
    header.creation_date = created
    for dimension in old.point_format.extra_dimensions:
        header.add_extra_dim(laspy.ExtraBytesParams(dimension.name, dimension.dtype))
    if crs is not None:
        header.add_crs(crs)
    new = laspy.LasData(header, laspy.ScaleAwarePointRecord.zeros(len(old), header=header))
    new.xyz = old.xyz % 1000 + CORNER
    for name in ("classification", "object_id", "confidence", "original_classification", "red", "green", "blue"):
        new[name] = old[name]
    new.gps_time = (FIRST if times else 1000.0) + np.roll(np.arange(len(old)) * 0.001, 77)
    new.points = new.points[:kept]
    new.write(str(path))


def record(folder, names):
    """Set the results of the record of a folder."""
    path = folder / ".mlsroad/0123456789ab/run.json"
    run = json.loads(path.read_text())
    run["outputs"] = [{**entry, "path": name} for name in names for entry in entries_of([str(folder / name)])]
    run["summary"] |= {"method": "pool", "model": {"name": "pool", "version": "0.1.0", "source": "shipped"}}
    path.write_text(json.dumps(run))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("catalogue") / "out"
    write_output(folder)
    for name in FILES:
        place(folder / name)
    record(folder, (*FILES, "inventory.gpkg", "inventory.parquet", "report.html"))
    return folder


@pytest.fixture
def folder(written, tmp_path):
    return Path(shutil.copytree(written, tmp_path / "out"))


def vpc_of(path):
    """Read a virtual point cloud as PDAL wrench does: it fails where a key is missing or of another type."""
    content = json.loads(path.read_text(encoding="utf-8"))
    assert set(content) == {"type", "features"} and content["type"] == "FeatureCollection"
    files = {}
    for feature in content["features"]:
        assert feature["type"] == "Feature" and feature["stac_version"] == "1.0.0"
        properties, first = feature["properties"], next(iter(feature["assets"].values()))
        assert isinstance(properties["proj:wkt2"], str) and len(properties["proj:bbox"]) == 6
        assert properties["proj:geometry"]["type"] == feature["geometry"]["type"] == "Polygon"
        assert "pc:statistics" not in properties and first["href"].startswith("./")
        files[(path.parent / first["href"]).resolve()] = feature
    assert len(files) == len(content["features"]) == len({f["id"] for f in content["features"]})
    return files


def valid(content):
    """Return the errors of an item by the schema of STAC that pystac has; extensions have none of theirs offline."""
    from jsonschema import Draft7Validator
    from referencing import Registry, Resource

    cache = get_local_schema_cache()
    registry = Registry().with_resources([(k, Resource.from_contents(v)) for k, v in cache.items()])
    schema = cache[f"https://schemas.stacspec.org/v{VERSION}/item-spec/json-schema/item.json"]
    return [
        e.message for e in Draft7Validator(schema, registry=registry).iter_errors({**content, "stac_version": VERSION})
    ]


def test_a_virtual_point_cloud_says_of_each_file_what_laspy_and_pyproj_say(folder, tmp_path):
    done = mlsroad("export", folder, "-o", tmp_path / "survey.vpc")
    assert done.exit_code == 0, done.output
    found = vpc_of(tmp_path / "survey.vpc")
    assert set(found) == {(folder / name).resolve() for name in FILES}
    for path, feature in found.items():
        las, properties = laspy.read(path), feature["properties"]
        assert valid(feature) == []
        assert properties["pc:count"] == len(las) == 68_000
        np.testing.assert_array_equal(properties["proj:bbox"], [*las.xyz.min(axis=0), *las.xyz.max(axis=0)])
        degrees = pyproj.Transformer.from_crs(UTM, 4326, always_xy=True)
        low, high = las.xyz.min(axis=0), las.xyz.max(axis=0)
        box = degrees.transform_bounds(*low[:2], *high[:2])
        assert np.abs(np.array(feature["bbox"])[[0, 1, 3, 4]] - box).max() < 1e-7
        assert feature["bbox"][2::3] == [low[2], high[2]]
        corners = np.array(feature["properties"]["proj:geometry"]["coordinates"][0])
        assert np.ptp(corners[:, 0]) == high[0] - low[0] and np.ptp(corners[:, 1]) == high[1] - low[1]
        ring = np.array(feature["geometry"]["coordinates"][0])
        assert np.abs(ring - np.transpose(degrees.transform(*corners.T))).max() < 1e-7
        assert properties["proj:code"] == "EPSG:25833" and pyproj.CRS(properties["proj:wkt2"]) == UTM
        assert properties["start_datetime"] == properties["datetime"] == "2024-10-07T14:14:20.250000Z"
        assert properties["end_datetime"] == "2024-10-07T14:15:28.249000Z"  # 68 s later
        assert set(feature) == SAMPLE["feature"] and set(properties) == SAMPLE["properties"] | MORE
        schemas = {entry["name"]: (entry["size"], entry["type"]) for entry in properties["pc:schemas"]}
        assert all(set(entry) == SAMPLE["schema"] for entry in properties["pc:schemas"])
        assert len(schemas) == len(list(las.point_format.dimension_names))
        expected = {"X": (8, "floating"), "Classification": (1, "unsigned"), "GpsTime": (8, "floating")}
        expected |= {"ReturnNumber": (1, "unsigned"), "PointSourceId": (2, "unsigned"), "Red": (2, "unsigned")}
        expected |= {"ScanAngleRank": (4, "floating"), "confidence": (4, "floating"), "object_id": (4, "unsigned")}
        assert expected.items() <= schemas.items()


def test_an_item_names_all_results_with_their_types(folder):
    done = mlsroad("export", folder, "-o", folder / "survey.stac.json")
    assert done.exit_code == 0, done.output
    content = json.loads((folder / "survey.stac.json").read_text(encoding="utf-8"))
    assert valid(content) == []
    item = pystac.Item.from_file(str(folder / "survey.stac.json"))
    assert PointcloudExtension.ext(item).count == 136_000 and ProjectionExtension.ext(item).code == "EPSG:25833"
    all_xyz = np.concatenate([laspy.read(folder / name).xyz for name in FILES])
    np.testing.assert_array_equal(ProjectionExtension.ext(item).bbox, [*all_xyz.min(axis=0), *all_xyz.max(axis=0)])
    assert {key: (asset.media_type, asset.roles) for key, asset in item.assets.items()} == {
        FILES[0]: ("application/vnd.laszip", ["data"]),
        "sub_two.laz": ("application/vnd.laszip", ["data"]),
        "inventory.gpkg": ("application/geopackage+sqlite3", ["data"]),
        "inventory.parquet": ("application/vnd.apache.parquet", ["data"]),
        "report.html": ("text/html", ["metadata"]),
    }
    assert all((folder / asset.href).is_file() for asset in item.assets.values())
    assert item.id == "<i>survey" and item.properties["mlsroad:model"]["name"] == "pool"
    assert item.properties["processing:software"].keys() == {"mlsroad"}


def test_a_copy_for_the_web_is_named_in_place_of_its_file(folder, tmp_path):
    copy = folder / "sub/two.copc.laz"
    write_copc(str(folder / FILES[1]), str(copy), n_threads=1)
    record(folder, (*FILES, "sub/two.copc.laz"))
    done = mlsroad("export", folder, "-o", tmp_path / "a.vpc", tmp_path / "a.stac.json")
    assert done.exit_code == 0, done.output
    assert set(vpc_of(tmp_path / "a.vpc")) == {(folder / FILES[0]).resolve(), copy.resolve()}
    item = json.loads((tmp_path / "a.stac.json").read_text())
    assert item["properties"]["pc:count"] == 136_000
    assert item["assets"]["out_sub_two.copc.laz"]["type"] == "application/vnd.laszip+copc"


def test_points_and_inventories_of_the_same_delivery_are_named(folder, tmp_path):
    with open_corrections(folder) as store:
        store.add(Correction("reject", 2), who="bob")
    done = mlsroad("export", folder, "-o", tmp_path / "a.vpc")
    assert "a.vpc names the points as labelled" in " ".join(done.output.split())
    new = tmp_path / "new"
    new.mkdir()
    done = mlsroad("export", folder, "-o", new / "b.vpc", f"{new}/laz/", new / "b.gpkg", new / "b.stac.json")
    assert done.exit_code == 0 and "as labelled" not in done.output, done.output
    found = vpc_of(new / "b.vpc")
    assert set(found) == {(new / "laz" / name).resolve() for name in FILES}
    assert all(feature["properties"]["pc:count"] == len(laspy.read(path)) for path, feature in found.items())
    item = json.loads((new / "b.stac.json").read_text())
    assert {"b.gpkg", "laz_sub_two.laz", "out_report.html", "out_inventory.parquet"} < item["assets"].keys()
    assert "out_inventory.gpkg" not in item["assets"]
    shutil.move(new, tmp_path / "moved")
    assert all(path.is_file() for path in vpc_of(tmp_path / "moved/b.vpc"))


def test_an_order_of_the_page_names_the_delivered_points(folder):
    order = deliver_order(OutputFolder.find(folder), {"formats": [".vpc", ".laz", ".stac.json"]})
    made = Path(order["folder"])
    (clouds,), (item,) = made.glob("*.vpc"), made.glob("*.stac.json")
    assert set(vpc_of(clouds)) == {(made / name).resolve() for name in FILES}
    assert json.loads(item.read_text(encoding="utf-8"))["assets"].keys() >= {FILES[0], "sub_two.laz"}
    assert {clouds.name, item.name} < set(order["files"])


@pytest.mark.parametrize("ending", [".vpc", ".stac.json"])
def test_a_survey_without_a_system_gets_none(folder, tmp_path, ending):
    place(folder / FILES[1], crs=None)
    done = mlsroad("export", folder, "-o", tmp_path / f"a{ending}", tmp_path / "b.csv")
    text = " ".join(done.output.split())
    assert done.exit_code and re.search(r"a\S+: STAC needs longitudes .*two\.laz has no coordinate reference", text)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_system_without_a_code_is_written_out(folder, tmp_path):
    own = pyproj.CRS("+proj=tmerc +lat_0=52.5 +lon_0=13.4 +x_0=389000 +y_0=5819000 +ellps=GRS80 +units=m +no_defs")
    place(folder / FILES[1], crs=own)
    done = mlsroad("export", folder, "-o", tmp_path / "a.vpc")
    assert done.exit_code == 0, done.output
    feature = vpc_of(tmp_path / "a.vpc")[(folder / FILES[1]).resolve()]
    assert feature["properties"]["proj:code"] is None
    assert pyproj.CRS(feature["properties"]["proj:wkt2"]).equals(own, ignore_axis_order=True)
    done = mlsroad("export", folder, "-o", tmp_path / "a.stac.json")  # of two systems
    assert done.exit_code and "an item has one coordinate reference system" in " ".join(done.output.split())


def test_dates_without_times_say_where_they_are_from(folder, tmp_path):
    import datetime
    import os

    place(folder / FILES[0], times=False, created=datetime.date(2023, 3, 1))
    place(folder / FILES[1], times=False, created=datetime.date(1970, 1, 1))
    os.utime(folder / FILES[1], (1_700_000_000, 1_700_000_000))
    assert mlsroad("export", folder, "-o", tmp_path / "a.vpc").exit_code == 0
    found = [vpc_of(tmp_path / "a.vpc")[(folder / name).resolve()]["properties"] for name in FILES]
    assert [(one["datetime"], one["mlsroad:datetime_from"]) for one in found] == [
        ("2023-03-01T00:00:00Z", "creation date in the file"),
        ("2023-11-14T22:13:20Z", "last change of the file"),
    ]
    assert all("start_datetime" not in one for one in found)


def test_files_without_points_are_left_out(folder, tmp_path):
    place(folder / FILES[0], kept=0)
    assert mlsroad("export", folder, "-o", tmp_path / "a.vpc").exit_code == 0
    assert set(vpc_of(tmp_path / "a.vpc")) == {(folder / FILES[1]).resolve()}
    place(folder / FILES[1], kept=0)
    done = mlsroad("export", folder, "-o", tmp_path / "b.vpc")
    assert done.exit_code and "the labelled files have no points" in " ".join(done.output.split())


def test_a_missing_file_and_a_missing_library_are_named(folder, tmp_path, monkeypatch):
    (folder / FILES[1]).rename(tmp_path / "away.laz")
    done = mlsroad("export", folder, "-o", tmp_path / "a.vpc")
    assert done.exit_code and "two.laz is missing" in " ".join(done.output.split())

    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(catalogue, "import_module", missing)
    done = mlsroad("export", folder, "-o", tmp_path / "a.vpc", tmp_path / "b.csv")
    assert done.exit_code and "by pystac, which is not installed" in " ".join(done.output.split())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["away.laz", "out"]


@pytest.mark.parametrize("code", ["EPSG:2154", "EPSG:2263", "EPSG:7415", "EPSG:25833+5783", "EPSG:4326", "EPSG:27700"])
def test_boxes_in_degrees_are_those_of_a_dense_outline(code):
    crs = pyproj.CRS(code)
    area = crs.to_2d().area_of_use
    middle = (area.west + area.east) / 2, (area.south + area.north) / 2
    own = pyproj.Transformer.from_crs(4326, crs.to_2d(), always_xy=True).transform(*middle)
    size = 0.002 if crs.is_geographic else 200.0
    box = shapely.box(*own, own[0] + size, own[1] + size)
    bounds, outline = catalogue._in_degrees(crs, box, Path("a.laz"))
    dense = np.array(shapely.segmentize(box, size / 500).exterior.coords)
    x, y = pyproj.Transformer.from_crs(crs.to_2d(), 4326, always_xy=True).transform(*dense.T)
    assert np.abs(np.array(bounds) - [x.min(), y.min(), x.max(), y.max()]).max() < 1e-7
    assert np.abs(np.array(outline.bounds) - bounds).max() < 1e-5


def test_a_place_outside_of_a_system_is_named():
    with pytest.raises(DataError, match=r"a\.laz cannot be placed in longitudes and latitudes \(ETRS89 .*33N\)"):
        catalogue._in_degrees(UTM, shapely.box(1e15, 1e15, 2e15, 2e15), Path("a.laz"))
