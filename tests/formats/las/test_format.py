"""LAS and LAZ against laspy, which reads and writes them on its own."""

import struct
from dataclasses import replace

import laspy
import numpy as np
import pyproj
import pytest
from helpers.formats import LAYOUTS, UTM, las_column, make_las, raw_vlrs

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MissingColumnError, ReadError, UnknownClassError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.las.format import LasFormat

LAS = LasFormat()
DEFAULT = ReadOptions()


@pytest.mark.parametrize(("version", "point_format"), LAYOUTS)
@pytest.mark.parametrize("extension", ["las", "laz"])
def test_every_dimension_equals_laspy(tmp_path, rng, version, point_format, extension):
    path = tmp_path / f"a.{extension}"
    reference = make_las(path, rng, version=version, point_format=point_format)
    cloud = LAS.read(path, DEFAULT)
    assert len(cloud) == len(reference)
    np.testing.assert_allclose(cloud.world_xyz(), reference.xyz, rtol=0, atol=1e-8)
    for name in reference.point_format.dimension_names:
        if name in ("X", "Y", "Z"):
            continue
        expected = las_column(reference, name)
        if name == "intensity":
            np.testing.assert_array_equal(cloud[name], (expected / 65535).astype(np.float32))
        elif name in ("red", "green", "blue"):
            axis = ["red", "green", "blue"].index(name)
            np.testing.assert_array_equal(cloud["rgb16"][:, axis], expected)
            np.testing.assert_array_equal(cloud["rgb"][:, axis], expected >> 8)
        else:
            np.testing.assert_array_equal(cloud[name], expected)


@pytest.mark.parametrize(("version", "point_format"), LAYOUTS)
def test_reading_and_writing_back_gives_the_same_bytes(tmp_path, rng, version, point_format):
    path, back = tmp_path / "a.las", tmp_path / "b.las"
    make_las(path, rng, version=version, point_format=point_format, geotiff=25832)
    LAS.write(back, LAS.read(path, DEFAULT), WriteOptions())
    old, new = path.read_bytes(), back.read_bytes()
    differing = {at for at, (a, b) in enumerate(zip(old, new, strict=True)) if a != b}
    # laspy leaves the old counts of LAS 1.4 empty where the specification asks for them (formats 0 to 5)
    assert differing <= set(range(107, 131)) if version == "1.4" and point_format < 6 else not differing


def test_laz_written_back_keeps_all_but_the_compression(tmp_path, rng):
    path, back = tmp_path / "a.laz", tmp_path / "b.laz"
    reference = make_las(path, rng, geotiff=25832, n=1000)
    LAS.write(back, LAS.read(path, DEFAULT), WriteOptions())
    written = laspy.read(back)
    np.testing.assert_array_equal(written.points.array, reference.points.array)
    np.testing.assert_array_equal(written.header.scales, reference.header.scales)
    np.testing.assert_array_equal(written.header.offsets, reference.header.offsets)
    assert written.header.creation_date == reference.header.creation_date
    assert [v.record_data for v in written.evlrs] == [v.record_data for v in reference.evlrs]
    own = [v for v in raw_vlrs(path) if b"laszip" not in v[0]]
    assert [v for v in raw_vlrs(back) if b"laszip" not in v[0]] == own


def test_las_1_0_with_its_mark_before_the_points(tmp_path, rng):
    path = tmp_path / "a.las"
    reference = make_las(path, rng, version="1.1", point_format=1, extras=False)
    data = bytearray(path.read_bytes())
    data[25] = 0
    points = int.from_bytes(data[96:100], "little")
    data[96:100] = (points + 2).to_bytes(4, "little")
    path.write_bytes(bytes(data[:points]) + b"\xdd\xcc" + bytes(data[points:]))
    cloud = LAS.read(path, DEFAULT)
    np.testing.assert_allclose(cloud.world_xyz(), reference.xyz, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(cloud["gps_time"], las_column(reference, "gps_time"))
    LAS.write(tmp_path / "b.las", cloud, WriteOptions())
    assert (tmp_path / "b.las").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("n_threads", [1, 2])
@pytest.mark.parametrize("extension", ["las", "laz"])
def test_ranges_are_slices_of_the_whole(tmp_path, rng, extension, n_threads):
    path = tmp_path / f"a.{extension}"
    make_las(path, rng, n=120_000, point_format=6)  # three chunks of LAZ
    options = ReadOptions(n_threads=n_threads)
    whole = LAS.read(path, options)
    for start, stop in [(0, 1), (49_999, 50_001), (3, 119_999), (119_999, 120_000), (70_000, None), (500, 500)]:
        part = LAS.read(path, options, start=start, stop=stop)
        expected = whole.select(np.arange(len(whole))[start:stop])
        np.testing.assert_array_equal(part.xyz, expected.xyz)
        np.testing.assert_array_equal(part.origin, whole.origin)
        assert part.columns.keys() == whole.columns.keys()
        for name in whole.columns:
            np.testing.assert_array_equal(part[name], expected[name])
            assert part[name].dtype == expected[name].dtype
    assert len(LAS.read(path, options, start=200_000)) == 0
    with pytest.raises(ValueError, match=r"0 <= start <= stop, got 5\.\.4"):
        LAS.read(path, options, start=5, stop=4)


def test_info_is_the_header(tmp_path, rng):
    path = tmp_path / "a.laz"
    reference = make_las(path, rng, geotiff=25832)
    info = LAS.info(path, DEFAULT)
    cloud = LAS.read(path, DEFAULT)
    assert (info.n_points, info.format) == (300, "LAS")
    assert {name: values.dtype for name, values in cloud.columns.items()} == dict(info.columns)
    np.testing.assert_array_equal(info.bounds, [reference.header.mins, reference.header.maxs])
    np.testing.assert_array_equal(info.origin, [481_900.0, 5_454_900.0, 0.0])
    assert pyproj.CRS(info.crs).to_epsg() == pyproj.CRS(cloud.crs).to_epsg() == 25832
    assert info.details["created"] == (2019, 64)
    assert info.details["gps_time"] == "adjusted standard"


def test_wkt_record_is_read_as_it_stands(tmp_path, rng):
    header = laspy.LasHeader(version="1.4", point_format=6)
    wkt = pyproj.CRS(28992).to_wkt()
    header.add_crs(pyproj.CRS(28992))
    laspy.LasData(header).write(str(tmp_path / "a.las"))
    assert LAS.info(tmp_path / "a.las", DEFAULT).crs == wkt
    moved = LAS.read(tmp_path / "a.las", ReadOptions(crs="EPSG:25832"))
    assert pyproj.CRS(moved.crs).to_epsg() == 25832


def test_unknown_geotiff_code_is_no_crs(tmp_path, rng):
    make_las(tmp_path / "a.las", rng, geotiff=32767)
    assert LAS.info(tmp_path / "a.las", DEFAULT).crs is None


@pytest.mark.parametrize(("factor", "bits"), [(1, 8), (257, 16), (256, 16)])
def test_colour_depth_is_seen_and_kept(tmp_path, rng, factor, bits):
    path = tmp_path / "a.las"
    las = make_las(path, rng, n=5000)
    colours = rng.integers(0, 256, (5000, 3))
    colours[:2000] = 0  # a dark beginning must not decide
    las.red, las.green, las.blue = (colours * factor).T
    las.write(str(path))
    cloud = LAS.read(path, DEFAULT)
    np.testing.assert_array_equal(cloud["rgb"], colours)
    assert ("rgb16" in cloud) == (bits == 16)
    np.testing.assert_array_equal(LAS.read(path, ReadOptions(rgb_bits=bits))["rgb"], colours)
    LAS.write(tmp_path / "b.las", cloud, WriteOptions())
    assert (tmp_path / "b.las").read_bytes() == path.read_bytes()


def test_colours_beyond_the_sampled_depth_are_refused(tmp_path, rng):
    path = tmp_path / "a.las"
    las = make_las(path, rng, n=50_000, extras=False)
    las.red[:], las.green[:], las.blue[:] = 9, 9, 9
    las.red[4000] = 300  # between two samples
    las.write(str(path))
    with pytest.raises(DataError, match=r"a\.las.* 300 .*rgb_bits: 16"):
        LAS.read(path, DEFAULT)


def test_intensity_rules(tmp_path, rng):
    path = tmp_path / "a.las"
    las = make_las(path, rng, extras=False)
    las.intensity = rng.integers(0, 2000, 300)
    las.intensity[7] = 2000
    las.write(str(path))
    values = las_column(las, "intensity")
    np.testing.assert_allclose(
        LAS.read(path, ReadOptions(intensity_scale="max"))["intensity"], values / 2000, rtol=1e-7
    )
    half = LAS.read(path, ReadOptions(intensity_scale="max"), start=8)["intensity"]
    np.testing.assert_allclose(half, values[8:] / 2000, rtol=1e-7)
    np.testing.assert_allclose(LAS.read(path, ReadOptions(intensity_scale=4000))["intensity"], values / 4000, rtol=1e-7)
    with pytest.raises(DataError, match=r"a\.las: .* 2000 .* 10 leave"):
        LAS.read(path, ReadOptions(intensity_scale=10))


def test_mapping_units_coding_and_selection(tmp_path, rng):
    path = tmp_path / "a.las"
    las = make_las(path, rng, point_format=6)
    las.add_extra_dim(laspy.ExtraBytesParams("label", "u2"))
    las.classification = rng.choice([2, 6], 300)
    las["label"] = rng.integers(0, 9, 300)
    las.write(str(path))
    options = ReadOptions(columns={"label": "classification"}, units="foot", coding={2: "road", 6: "building"})
    cloud = LAS.read(path, options)
    np.testing.assert_array_equal(cloud["label"], np.where(las_column(las, "classification") == 2, 1, 20))
    np.testing.assert_array_equal(cloud["file_label"], las_column(las, "label"))
    assert "classification" not in cloud
    np.testing.assert_allclose(cloud.world_xyz(), las.xyz * 0.3048, rtol=0, atol=1e-7)
    assert set(LAS.read(path, replace(options, only=("label", "ring"))).columns) == {"label", "ring"}
    n_six = int((las_column(las, "classification") == 6).sum())
    with pytest.raises(UnknownClassError, match=rf"a\.las.*6 \({n_six} points\)"):
        LAS.read(path, replace(options, coding={2: "road"}))
    with pytest.raises(MissingColumnError, match=r"a\.las has no column 'klass'"):
        LAS.read(path, ReadOptions(columns={"label": "klass"}))
    with pytest.raises(MissingColumnError, match=r"a\.las has no column 'rgb'"):
        LAS.read(path, ReadOptions(only=("rgb",)))


@pytest.mark.parametrize("extension", ["las", "laz"])
@pytest.mark.parametrize("n", [0, 1])
def test_no_point_and_one_point(tmp_path, rng, extension, n):
    path = tmp_path / f"a.{extension}"
    make_las(path, rng, n=n)
    cloud = LAS.read(path, DEFAULT)
    assert len(cloud) == LAS.info(path, DEFAULT).n_points == n
    LAS.write(tmp_path / f"b.{extension}", cloud, WriteOptions())
    again = laspy.read(tmp_path / f"b.{extension}")
    assert len(again) == n
    assert list(again.point_format.dimension_names) == list(laspy.read(path).point_format.dimension_names)


def test_new_file_holds_every_column(tmp_path, rng):
    origin = np.array([UTM[0], UTM[1], 0.0])
    columns = {
        "intensity": rng.random(50).astype(np.float32),
        "rgb": rng.integers(0, 256, (50, 3)).astype(np.uint8),
        "gps_time": rng.random(50),
        "classification": rng.integers(0, 256, 50).astype(np.uint8),
        "label": rng.integers(0, 90, 50).astype(np.uint8),
        "instance": rng.integers(0, 9, 50).astype(np.int32),
        "normal": rng.normal(size=(50, 3)).astype(np.float32),
        "inside": rng.random(50) < 0.5,
    }
    crs = pyproj.CRS(25832).to_wkt()
    cloud = PointCloud(rng.random((50, 3)) * 100, columns, origin, crs)
    before = {name: values.copy() for name, values in columns.items()}
    for extension in ("las", "laz"):
        path = tmp_path / f"a.{extension}"
        LAS.write(path, cloud, WriteOptions(scale=0.0005))
        back = LAS.read(path, DEFAULT)
        np.testing.assert_allclose(back.world_xyz(), cloud.world_xyz(), rtol=0, atol=0.000251)
        np.testing.assert_allclose(back["intensity"], columns["intensity"], rtol=0, atol=0.5 / 65535)
        for name in columns.keys() - {"intensity"}:
            np.testing.assert_array_equal(back[name], columns[name])
        assert back.crs == crs
        first = path.read_bytes()
        LAS.write(path, cloud, WriteOptions(scale=0.0005, n_threads=2))
        assert path.read_bytes() == first
    assert all(np.array_equal(columns[name], before[name]) for name in columns)


def test_what_does_not_fit_is_refused(tmp_path, rng):
    path = tmp_path / "a.las"
    make_las(path, rng, version="1.2", point_format=3)
    cloud = LAS.read(path, DEFAULT)
    full = cloud.with_columns(classification=np.full(300, 64, np.uint8))
    with pytest.raises(DataError, match="classification 64 .*0 to 31"):
        LAS.write(tmp_path / "b.las", full, WriteOptions())
    assert not list(tmp_path.glob("*b.las*"))
    with pytest.raises(DataError, match="X .* int32"):
        LAS.write(tmp_path / "b.las", replace(cloud, origin=cloud.origin + 1e9), WriteOptions())
    with pytest.raises(DataError, match=r"user_data .* 0\.5"):
        LAS.write(tmp_path / "b.las", cloud.with_columns(user_data=np.full(300, 0.5)), WriteOptions())
    with pytest.raises(DataError, match="column 'wide'"):
        LAS.write(tmp_path / "b.las", cloud.with_columns(wide=np.zeros((300, 5))), WriteOptions())
    with pytest.raises(DataError, match=r"is longer than the 32 bytes"):
        LAS.write(tmp_path / "b.las", cloud.with_columns(**{"n" * 33: np.zeros(300)}), WriteOptions())


@pytest.mark.real_data
@pytest.mark.parametrize("parts", [("amsterdam", "run1_sidewalk_2386_9702.laz"), ("jakarto", "test_0.02_seconde.las")])
def test_recordings_come_back_unchanged(tmp_path, real_data, parts):
    path = real_data(*parts)
    back = tmp_path / parts[1]
    LAS.write(back, LAS.read(path, DEFAULT), WriteOptions())
    old, new = laspy.read(path), laspy.read(back)
    np.testing.assert_array_equal(new.points.array, old.points.array)
    for field in ("scales", "offsets", "mins", "maxs", "number_of_points_by_return"):
        np.testing.assert_array_equal(getattr(new.header, field), getattr(old.header, field))
    for field in ("creation_date", "system_identifier", "generating_software", "version", "uuid"):
        assert getattr(new.header, field) == getattr(old.header, field)
    if path.suffix == ".las":
        assert back.read_bytes() == path.read_bytes()


def as_version_1_0(path):
    """Turn a file of version 1.1 into 1.0, which has a signature before the points and one in each record's head."""
    data = bytearray(path.read_bytes())
    data[25] = 0
    begin, count = struct.unpack_from("<I", data, 96)[0], struct.unpack_from("<I", data, 100)[0]
    at = 227
    for _ in range(count):
        struct.pack_into("<H", data, at, 0xAABB)
        at += 54 + struct.unpack_from("<H", data, at + 20)[0]
    struct.pack_into("<I", data, 96, begin + 2)
    path.write_bytes(bytes(data[:begin]) + b"\xdd\xcc" + bytes(data[begin:]))


def as_version_1_5(path):
    """Turn a file of version 1.4 into 1.5, whose header has the least and the greatest time and an offset of time."""
    data = bytearray(path.read_bytes())
    data[25] = 5
    begin, extended = struct.unpack_from("<I", data, 96)[0], struct.unpack_from("<Q", data, 235)[0]
    struct.pack_into("<HI", data, 94, 393, begin + 18)
    struct.pack_into("<Q", data, 235, extended + 18 * (extended > 0))
    path.write_bytes(bytes(data[:375]) + struct.pack("<ddh", 1.0, 2.0, 3) + bytes(data[375:]))


@pytest.mark.parametrize(
    ("version", "point_format", "turn"), [("1.1", 1, as_version_1_0), ("1.4", 7, as_version_1_5)], ids=["1.0", "1.5"]
)
def test_oldest_and_newest_version(tmp_path, rng, version, point_format, turn):
    path = tmp_path / "a.las"
    las = make_las(path, rng, version=version, point_format=point_format)
    turn(path)
    cloud = LAS.read(path, DEFAULT)
    assert LAS.info(path, DEFAULT).details["version"] == ("1.0" if version == "1.1" else "1.5")
    np.testing.assert_allclose(cloud.world_xyz(), las.xyz, rtol=0, atol=1e-6)
    for name in ("gps_time", "ring", "normal", "point_source_id"):
        np.testing.assert_array_equal(cloud[name], las_column(las, name))
    LAS.write(tmp_path / "b.las", cloud, WriteOptions())
    assert (tmp_path / "b.las").read_bytes() == path.read_bytes()
    LAS.write(tmp_path / "c.laz", cloud, WriteOptions())
    LAS.write(tmp_path / "d.las", LAS.read(tmp_path / "c.laz", DEFAULT), WriteOptions())
    assert (tmp_path / "d.las").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("scale", [0.0, 1e-300, 1e300, 1e306, np.nan])
def test_absurd_scales_are_damage(tmp_path, rng, scale):
    make_las(tmp_path / "a.las", rng)
    data = bytearray((tmp_path / "a.las").read_bytes())
    struct.pack_into("<d", data, 139, scale)
    (tmp_path / "a.las").write_bytes(data)
    with pytest.raises(ReadError, match=r"a\.las .*scale \[0\.001, .*offset"):
        LAS.info(tmp_path / "a.las", DEFAULT)
