"""Plausible faults of other formats, from the reports of their users."""

import laspy
import numpy as np
import pytest
from helpers.formats import make_las
from helpers.las_rules import broken_rules
from laspy.vlrs.vlr import VLR

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.npz import NpzFormat
from mlsroad_pipeline.formats.pcd.format import PcdFormat
from mlsroad_pipeline.formats.registry import get_format

DEFAULT = ReadOptions()


@pytest.mark.parametrize("others", [{}, {"rgb": (3, 100)}, {"i": (100,)}])
@pytest.mark.parametrize("rows", [3, 4])
def test_arrays_that_lie_are_transposed(tmp_path, rng, rows, others):
    path = tmp_path / "a.npz"
    xyz = rng.random((rows, 100))
    np.savez(path, xyz=xyz, **{name: rng.integers(0, 255, shape).astype(np.uint8) for name, shape in others.items()})
    cloud = NpzFormat().read(path, DEFAULT)
    np.testing.assert_array_equal(cloud.xyz, xyz[:3].T)
    assert ("rgb" in cloud) == ("rgb" in others)
    assert "is transposed" in NpzFormat().info(path, DEFAULT).notes[0]


def test_arrays_of_few_points_stand(tmp_path, rng):
    path = tmp_path / "a.npy"
    np.save(path, rng.random((3, 6)))
    assert len(NpzFormat().read(path, DEFAULT)) == 3 and not NpzFormat().info(path, DEFAULT).notes


def test_records_of_five_numbers_are_no_kitti(tmp_path, rng):
    path = tmp_path / "a.bin"
    n = 400
    records = np.column_stack([rng.normal(size=(n, 3)) * 20, rng.integers(0, 255, n), rng.integers(0, 32, n)])
    records.astype("<f4").tofile(path)
    with pytest.raises(ReadError, match=r"a\.bin .*ring, as in nuScenes"):
        get_format(path).read(path, DEFAULT)
    np.column_stack([rng.normal(size=(n, 3)) * 20, rng.random(n)]).astype("<f4").tofile(path)
    assert len(get_format(path).read(path, DEFAULT)) == n


@pytest.mark.parametrize(
    ("head", "name"),
    [
        (b"CCB2", "CloudCompare"),
        (b"\x89HDF\r\n\x1a\n", "HDF5"),
        (b"\xd4\xc3\xb2\xa1", "PCAP"),
        (b"SQLite format 3\0", "SQLite"),
    ],
)
@pytest.mark.parametrize("ending", ["bin", "xyz", "laz"])
def test_other_documents_are_named(tmp_path, head, name, ending):
    path = tmp_path / f"a.{ending}"
    path.write_bytes(head.ljust(16 * 50, b"\1"))
    with pytest.raises(ReadError, match=rf"is named as .*, but holds .*{name}"):
        get_format(path)


@pytest.mark.parametrize("viewpoint", ["0 0 0 1 0 0 0", "0.0 0 0 1.0 0 0 0", "5 6 1.8 1 0 0 0", "0 0 0 0.7 0 0 0.7"])
def test_viewpoint_is_told(tmp_path, viewpoint):
    path = tmp_path / "a.pcd"
    cloud = PointCloud(np.arange(6.0).reshape(2, 3), {}, np.zeros(3), None, str(path))
    PcdFormat().write(path, cloud, WriteOptions())
    path.write_bytes(path.read_bytes().replace(b"VIEWPOINT 0 0 0 1 0 0 0", b"VIEWPOINT " + viewpoint.encode()))
    np.testing.assert_array_equal(PcdFormat().read(path, DEFAULT).xyz, cloud.xyz)
    told = PcdFormat().info(path, DEFAULT).notes
    usual = [float(word) for word in viewpoint.split()] == [0, 0, 0, 1, 0, 0, 0]
    assert told == (() if usual else (f"its VIEWPOINT {viewpoint} is not applied: coordinates are those of the file",))


def test_colours_of_three_bytes_in_a_pcd(tmp_path):
    path = tmp_path / "a.pcd"
    head = "VERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 1\nTYPE F F F U\nCOUNT 1 1 1 3\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA binary\n"
    path.write_bytes(head.encode() + np.array([1, 2, 3], "<f4").tobytes() + bytes([7, 8, 9]))
    assert PcdFormat().read(path, DEFAULT)["rgb"].tolist() == [[7, 8, 9]]


@pytest.mark.parametrize(("code", "told"), [(25832, False), (25833, True), (32767, False)])
def test_two_systems_of_a_las_are_told(tmp_path, rng, code, told):
    import pyproj

    path = tmp_path / "a.las"
    las = make_las(path, rng, geotiff=code)
    wkt = pyproj.CRS.from_epsg(25832).to_wkt().encode() + b"\0"
    las.header.vlrs.append(VLR("LASF_Projection", 2112, "wkt", wkt))
    las.write(str(path))
    notes = LasFormat().info(path, DEFAULT).notes
    assert bool(notes) == told
    if told:
        assert notes == (
            "its WKT record names ETRS89 / UTM zone 32N, its GeoTIFF keys ETRS89 / UTM zone 33N: the WKT is used; "
            "crs sets another",
        )


@pytest.mark.parametrize("scale", [0.0, np.nan, np.inf])
def test_scale_of_extra_bytes_that_is_none(tmp_path, rng, scale):
    path = tmp_path / "a.las"
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.add_extra_dim(laspy.ExtraBytesParams("height", "i2", scales=[0.5], offsets=[0.0]))
    las = laspy.LasData(header, laspy.ScaleAwarePointRecord.zeros(3, header=header))
    las.points.array["height"] = [3, 4, 5]
    las.write(str(path))
    data = path.read_bytes()
    at = data.index(np.float64(0.5).tobytes())
    path.write_bytes(data[:at] + np.float64(scale).tobytes() + data[at + 8 :])
    assert LasFormat().read(path, DEFAULT)["height"].tolist() == [3, 4, 5]


def test_new_files_have_one_return_per_point(tmp_path, rng):
    path = tmp_path / "a.laz"
    cloud = PointCloud(rng.random((50, 3)) * 9, {"rgb": np.ones((50, 3), np.uint8)}, np.zeros(3), None, str(path))
    LasFormat().write(path, cloud, WriteOptions())
    las = laspy.read(path)
    assert (np.asarray(las.return_number) == 1).all() and (np.asarray(las.number_of_returns) == 1).all()
    assert las.header.number_of_points_by_return[0] == 50 and broken_rules(path) == []
