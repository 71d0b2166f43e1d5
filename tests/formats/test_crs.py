"""Coordinate reference systems beside files, kept, and turned into others on request."""

import laspy
import numpy as np
import pyproj
import pytest
from helpers.formats import make_las

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.crs import parse_crs, with_units
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.pcd.format import PcdFormat
from mlsroad_pipeline.formats.text.format import TextFormat
from mlsroad_pipeline.surveys.inspection import inspect_file
from mlsroad_pipeline.surveys.reading import find_corridor

DEFAULT = ReadOptions()
UTM32, UTM33 = parse_crs("EPSG:25832"), parse_crs("EPSG:25833")


@pytest.mark.parametrize(("form", "name"), [(TextFormat(), "a.b.xyz.gz"), (PcdFormat(), "a.b.pcd")])
def test_sidecars_are_written_and_read(tmp_path, rng, caplog, form, name):
    cloud = PointCloud(rng.random((9, 3)), {}, np.array([480_000.0, 5_455_000.0, 0.0]), UTM32)
    form.write(tmp_path / name, cloud, WriteOptions())
    assert (tmp_path / "a.b.prj").is_file()
    with caplog.at_level("INFO"):
        assert form.read(tmp_path / name, DEFAULT).crs == UTM32
    assert "a.b.prj: holds the coordinate reference system ETRS89 / UTM zone 32N" in caplog.text
    (tmp_path / "a.b.prj").write_text("EPSG:25833")
    assert form.info(tmp_path / name, DEFAULT).crs == UTM33
    assert form.read(tmp_path / name, ReadOptions(crs="EPSG:25832")).crs == UTM32  # the option comes first
    (tmp_path / "a.b.prj").write_text("somewhere")
    with caplog.at_level("INFO"):
        assert form.read(tmp_path / name, DEFAULT).crs is None  # never guessed
    assert "no coordinate reference system that PROJ can parse: 'somewhere'" in caplog.text


def test_reprojection_equals_pyproj_for_any_range(tmp_path, rng):
    make_las(tmp_path / "a.laz", rng, geotiff=25832)
    las = laspy.read(tmp_path / "a.laz")
    transformer = pyproj.Transformer.from_crs(25832, 25833, always_xy=True)
    expected = np.stack(transformer.transform(las.x, las.y, las.z), axis=1)
    options = ReadOptions(reproject="EPSG:25833")
    cloud = LasFormat().read(tmp_path / "a.laz", options)
    np.testing.assert_allclose(cloud.world_xyz(), expected, rtol=0, atol=1e-6)
    assert cloud.crs == UTM33 and np.abs(cloud.xyz[:, :2]).max() < 1000
    part = LasFormat().read(tmp_path / "a.laz", options, start=100, stop=120)
    np.testing.assert_array_equal(part.origin, cloud.origin)
    np.testing.assert_array_equal(part.xyz, cloud.xyz[100:120])
    assert LasFormat().info(tmp_path / "a.laz", options).bounds is None
    LasFormat().write(tmp_path / "b.laz", cloud, WriteOptions(like="none"))
    again = LasFormat().read(tmp_path / "b.laz", DEFAULT)
    np.testing.assert_allclose(again.world_xyz(), expected, rtol=0, atol=6e-4)
    assert again.crs == UTM33


def test_longitude_and_latitude(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("9.0001 49.0 100\n9.0002 49.0001 101\n")
    cloud = TextFormat().read(path, ReadOptions(crs="EPSG:4326", reproject="EPSG:32632"))
    expected = pyproj.Transformer.from_crs(4326, 32632, always_xy=True).transform([9.0001, 9.0002], [49.0, 49.0001])
    np.testing.assert_allclose(cloud.world_xyz()[:, :2], np.transpose(expected), rtol=0, atol=1e-6)
    assert cloud.world_xyz()[:, 2].tolist() == [100, 101]


def test_what_cannot_be_reprojected(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("1 2 3\n")
    with pytest.raises(DataError, match=r"a\.txt states no .*; set crs"):
        TextFormat().read(path, ReadOptions(reproject="EPSG:25832"))
    with pytest.raises(ParameterError, match="'EPSG:1' is not"):
        TextFormat().read(path, ReadOptions(crs="EPSG:25832", reproject="EPSG:1"))
    path.write_text("500 95 3\n")
    with pytest.raises(DataError, match=r"a\.txt .* EPSG:25832"):
        TextFormat().read(path, ReadOptions(crs="EPSG:4326", reproject="EPSG:25832"))


@pytest.mark.parametrize(("version", "point_format"), [("1.2", 3), ("1.4", 6)])
def test_another_system_is_stated_as_the_version_does(tmp_path, rng, version, point_format):
    make_las(tmp_path / "a.las", rng, version=version, point_format=point_format, geotiff=25832)
    cloud = LasFormat().read(tmp_path / "a.las", ReadOptions(crs="EPSG:25833"))
    LasFormat().write(tmp_path / "b.las", cloud, WriteOptions())
    assert LasFormat().read(tmp_path / "b.las", DEFAULT).crs == UTM33
    records = {vlr.record_id for vlr in laspy.read(tmp_path / "b.las").header.vlrs}
    assert (2112 in records) == (version == "1.4") and 34735 in records
    cloud = LasFormat().read(tmp_path / "a.las", ReadOptions(crs="+proj=tmerc +lon_0=9.3 +ellps=GRS80"))
    if version == "1.2":
        with pytest.raises(DataError, match="states another"):
            LasFormat().write(tmp_path / "b.las", cloud, WriteOptions())


def test_files_of_one_drive_share_a_system():
    clouds = [PointCloud(np.eye(3) * k, {}, crs=crs, source=f"{k}.laz") for k, crs in ((1, UTM32), (2, UTM33))]
    with pytest.raises(DataError, match=r"1\.laz and 2\.laz .*; set read"):
        find_corridor(clouds, clouds, trajectory=None, along=True)


def survey_in_feet(tmp_path, rng, *, version, heights):
    """Write a file in US survey feet on Pennsylvania's plane, and give its coordinates in feet."""
    path = tmp_path / "feet.las"
    las = make_las(path, rng, version=version, point_format=3 if version == "1.2" else 6, extras=False, scale=0.01)
    las.header.offsets = [2_600_000.0, 300_000.0, 200.0]
    codes = [3072, 0, 1, 2272, *([4096, 0, 1, 6360] if heights else [])]
    words = np.array([1, 1, 0, len(codes) // 4, *codes], "<u2")
    las.header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "keys", words.tobytes()))
    las.write(str(path))
    return path, laspy.read(path).xyz


@pytest.mark.parametrize("version", ["1.2", "1.4"])
@pytest.mark.parametrize("heights", [False, True])
def test_coordinates_in_feet_become_metres_in_the_same_place(tmp_path, rng, version, heights):
    path, feet = survey_in_feet(tmp_path, rng, version=version, heights=heights)
    foot = 1200 / 3937
    options = ReadOptions(units="us_survey_foot")
    cloud = LasFormat().read(path, options)
    np.testing.assert_allclose(cloud.world_xyz(), feet * foot, rtol=0, atol=1e-6)
    system = pyproj.CRS(cloud.crs)
    assert {axis.unit_name for axis in system.axis_info} == {"metre"} and system.is_compound == heights
    flat = system.sub_crs_list[0] if heights else system
    same = pyproj.Transformer.from_crs(2272, flat, always_xy=True).transform(feet[:, 0], feet[:, 1])
    np.testing.assert_allclose(cloud.world_xyz()[:, :2], np.transpose(same), rtol=0, atol=1e-4)
    target = "EPSG:26918+5703" if heights else "EPSG:26918"
    moved = LasFormat().read(path, ReadOptions(units="us_survey_foot", reproject=target)).world_xyz()
    expected = pyproj.Transformer.from_crs(2272, 26918, always_xy=True).transform(feet[:, 0], feet[:, 1])
    np.testing.assert_allclose(moved[:, :2], np.transpose(expected), rtol=0, atol=1e-4)
    np.testing.assert_allclose(moved[:, 2], feet[:, 2] * foot, rtol=0, atol=1e-6)
    LasFormat().write(tmp_path / "again.las", cloud, WriteOptions(units="us_survey_foot"))
    assert (tmp_path / "again.las").read_bytes() == path.read_bytes()
    plain = LasFormat().read(path, DEFAULT)
    np.testing.assert_allclose(plain.world_xyz(), feet, rtol=0, atol=1e-6)  # as the file has them, never guessed
    assert pyproj.CRS(plain.crs).axis_info[0].unit_name == "US survey foot"
    told = inspect_file(str(path), "feet.las", options=DEFAULT, max_gap=1.0).warnings
    assert any("has the unit US survey foot, but coordinates are read as metres; set units" in w for w in told)
    told = inspect_file(str(path), "feet.las", options=options, max_gap=1.0).warnings
    assert not any("set units" in w for w in told)


def test_units_that_are_not_those_of_the_system_leave_it(tmp_path):
    (tmp_path / "a.txt").write_text("482000000 5455000000 3\n")
    cloud = TextFormat().read(tmp_path / "a.txt", ReadOptions(units="millimetre", crs="EPSG:25832"))
    assert cloud.crs == UTM32 and cloud.world_xyz()[0, 0] == 482_000


@pytest.mark.parametrize(("like", "version"), [("source", "1.2"), ("source", "1.4"), ("none", "1.4")])
@pytest.mark.parametrize(("target", "precision"), [("EPSG:4258", 5.1e-8), ("EPSG:3857", 5.1e-4)])
def test_a_file_moved_far_keeps_its_precision(tmp_path, rng, like, version, target, precision):
    path = tmp_path / "a.las"
    make_las(path, rng, version=version, point_format=3 if version == "1.2" else 6, geotiff=25832)
    cloud = LasFormat().read(path, ReadOptions(reproject=target))
    LasFormat().write(tmp_path / "b.laz", cloud, WriteOptions(like=like))
    again = LasFormat().read(tmp_path / "b.laz", DEFAULT)
    np.testing.assert_allclose(again.world_xyz()[:, :2], cloud.world_xyz()[:, :2], rtol=0, atol=precision)
    assert pyproj.CRS(again.crs) == pyproj.CRS(target)
    las = laspy.read(tmp_path / "b.laz")
    np.testing.assert_allclose(las.xyz[:, :2], cloud.world_xyz()[:, :2], rtol=0, atol=precision)


def test_points_out_of_reach_of_the_old_offset_get_a_new_one(tmp_path, rng):
    las = make_las(tmp_path / "a.las", rng, version="1.4", point_format=6, scale=1e-5, geotiff=25832)
    las.header.offsets = [482_000.0, 5_455_000.0, 0.0]
    las.write(str(tmp_path / "a.las"))
    cloud = LasFormat().read(tmp_path / "a.las", ReadOptions(reproject="EPSG:3035"))  # 4 200 km east, 3 000 km north
    LasFormat().write(tmp_path / "b.las", cloud, WriteOptions())
    again = LasFormat().read(tmp_path / "b.las", DEFAULT)
    np.testing.assert_allclose(again.world_xyz()[:, :2], cloud.world_xyz()[:, :2], rtol=0, atol=5.1e-6)


def local_system(unit):
    return f'LOCAL_CS["site",UNIT[{unit}],AXIS["X",EAST],AXIS["Y",NORTH]]'


def test_units_of_a_system_that_have_no_length(tmp_path):
    path = tmp_path / "a.las"
    with pytest.raises(DataError, match=r"a\.las: .* 0 m.*set units"):
        with_units(ReadOptions(units="crs"), local_system('"unknown",0'), path)
    angles = with_units(ReadOptions(units="crs"), local_system('"gon",0.015707963267949'), path)
    assert angles.factors.tolist() == [1, 1, 1]
    feet = with_units(ReadOptions(units="crs"), local_system('"foot",0.3048'), path)
    assert feet.factors.tolist() == [0.3048] * 3
