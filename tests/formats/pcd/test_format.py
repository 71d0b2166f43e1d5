"""PCD in its three encodings against Open3D, `struct` and a file's own numbers."""

import struct

import numpy as np
import open3d as o3d
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.pcd.format import PcdFormat
from mlsroad_pipeline.formats.registry import get_format

PCD = PcdFormat()
DEFAULT = ReadOptions()
HEAD = "# .PCD v0.7\nVERSION 0.7\nFIELDS {}\nSIZE {}\nTYPE {}\nCOUNT {}\nWIDTH {}\nHEIGHT {}\nPOINTS {}\nDATA {}\n"


def head(fields, sizes, types, counts, n, encoding, shape=None):
    width, height = shape or (n, 1)
    return HEAD.format(fields, sizes, types, counts, width, height, n, encoding).encode()


@pytest.mark.parametrize(("ascii_", "compressed"), [(True, False), (False, False), (False, True)])
def test_what_open3d_writes(tmp_path, rng, ascii_, compressed):
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(rng.integers(0, 50, (500, 3)).astype(np.float32) / 4))
    intensity = np.repeat(rng.random(50).astype(np.float32), 10)
    cloud.point["intensity"] = o3d.core.Tensor(intensity.reshape(-1, 1))
    cloud.point["ring"] = o3d.core.Tensor(rng.integers(0, 40, (500, 1)).astype(np.uint8))
    path = tmp_path / "a.pcd"
    o3d.t.io.write_point_cloud(str(path), cloud, write_ascii=ascii_, compressed=compressed)
    found = get_format(path).read(path, DEFAULT)
    np.testing.assert_allclose(found.xyz, cloud.point.positions.numpy(), rtol=1e-6)
    np.testing.assert_allclose(found["intensity"], intensity, rtol=1e-6)
    np.testing.assert_array_equal(found["ring"], cloud.point["ring"].numpy()[:, 0])
    info = PCD.info(path, DEFAULT)
    assert info.n_points == 500
    assert dict(info.columns) == {name: values.dtype for name, values in found.columns.items()}
    part = PCD.read(path, DEFAULT, start=123, stop=129)
    np.testing.assert_array_equal(part.xyz, found.xyz[123:129])


def pack_lzf(data):
    """Compress slowly and plainly: literals, and runs of the previous byte as overlapping references."""
    out, i = bytearray(), 0
    while i < len(data):
        run = 1
        while i + run < len(data) and run < 200 and data[i + run] == data[i]:
            run += 1
        if run >= 4:
            out += bytes([0, data[i]])
            length = run - 1 - 2
            out += bytes([(length << 5), 0]) if length < 7 else bytes([7 << 5, length - 7, 0])
            i += run
        else:
            part = data[i : i + 3]
            out += bytes([len(part) - 1]) + part
            i += len(part)
    return bytes(out)


def compressed(path, data, n, size=None):
    """Write one field of bytes as compressed data."""
    size = n if size is None else size
    fields = head("x y z v", "4 4 4 1", "F F F U", "1 1 1 1", n, "binary_compressed")
    path.write_bytes(fields + struct.pack("<II", len(data), size) + data)
    return path


def test_compressed_data_of_a_plain_packer(tmp_path, rng):
    for n in (1, 31, 1000, 20_000):
        values = rng.integers(0, 3, n, dtype=np.uint8).repeat(rng.integers(1, 300))[:n]
        data = pack_lzf(bytes(12 * n) + values.tobytes())
        cloud = PCD.read(compressed(tmp_path / f"{n}.pcd", data, n, 13 * n), DEFAULT)
        np.testing.assert_array_equal(cloud["v"], values)
        assert not cloud.xyz.any()
    with pytest.raises(ReadError, match="3 bytes .* 1300"):
        PCD.read(compressed(tmp_path / "a.pcd", b"abc", 100, 1300), DEFAULT)
    with pytest.raises(ReadError, match=r"b\.pcd is damaged: .*: they decompress to more than 13 bytes"):
        PCD.read(compressed(tmp_path / "b.pcd", pack_lzf(bytes(14)), 1, 13), DEFAULT)
    for i, damaged in enumerate((b"\x05ab", b"\x20\x05", b"\xe0", b"\x00a\x40", b"\x01ab\x20\x02")):
        with pytest.raises(ReadError, match=rf"{i}\.pcd is damaged: its compressed data"):
            PCD.read(compressed(tmp_path / f"{i}.pcd", damaged, 1, 13), DEFAULT)


def test_several_values_padding_and_types(tmp_path):
    record = struct.Struct("<fff4xhI3d2xB")
    rows = [(1.0, 2.0, 3.0, -7, 9, 0.1, 0.2, 0.3, 255), (4.0, 5.0, 6.0, 300, 2**32 - 1, 1.0, 2.0, 3.0, 0)]
    fields = ("x y z _ line count fpfh _ flag", "4 4 4 1 2 4 8 1 1", "F F F U I U F U U", "1 1 1 4 1 1 3 2 1")
    path = tmp_path / "a.pcd"
    path.write_bytes(head(*fields, 2, "binary") + b"".join(record.pack(*row) for row in rows))
    cloud = PCD.read(path, DEFAULT)
    assert cloud.xyz.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert cloud["line"].tolist() == [-7, 300]
    assert cloud["count"].tolist() == [9, 2**32 - 1]
    assert [cloud[f"fpfh_{i}"].tolist() for i in range(3)] == [[0.1, 1.0], [0.2, 2.0], [0.3, 3.0]]
    assert cloud["flag"].tolist() == [255, 0]
    text = "1 2 3 0 0 0 0 -7 9 0.1 0.2 0.3 0 0 255\n4 5 6 0 0 0 0 300 4294967295 1 2 3 0 0 0\n"
    path.write_bytes(head(*fields, 2, "ascii") + text.encode())
    again = PCD.read(path, DEFAULT)
    for name, values in cloud.columns.items():
        np.testing.assert_array_equal(again[name], values)
        assert again[name].dtype == values.dtype


def test_packed_colours(tmp_path):
    red, green, blue, alpha = 200, 100, 50, 7
    bits = struct.pack("<I", alpha << 24 | red << 16 | green << 8 | blue)
    for name, kind in (("rgb", "F"), ("rgba", "U")):
        path = tmp_path / f"{name}.pcd"
        path.write_bytes(
            head(f"x y z {name}", "4 4 4 4", f"F F F {kind}", "1 1 1 1", 1, "binary")
            + struct.pack("<3f", 1, 2, 3)
            + bits
        )
        cloud = PCD.read(path, DEFAULT)
        assert cloud["rgb"].tolist() == [[red, green, blue]]
        assert ("alpha" in cloud) == (name == "rgba")


def test_beams_without_return_are_left_out(tmp_path, rng, caplog):
    points = rng.random((40, 4)).astype("<f4")
    points[[0, 7, 8, 39], :3] = np.nan
    path = tmp_path / "a.pcd"
    path.write_bytes(head("x y z a", "4 4 4 4", "F F F F", "1 1 1 1", 40, "binary", (10, 4)) + points.tobytes())
    kept = points[~np.isnan(points[:, 0])]
    with caplog.at_level("INFO"):
        cloud = PCD.read(path, DEFAULT)
    assert "4 of 40 points are NaN, beams without return" in caplog.text
    np.testing.assert_array_equal(cloud.xyz, kept[:, :3].astype(np.float64))
    assert PCD.info(path, DEFAULT).n_points == 36
    np.testing.assert_array_equal(PCD.read(path, DEFAULT, start=5, stop=8)["a"], kept[5:8, 3])
    points[3, 1] = np.inf
    path.write_bytes(head("x y z a", "4 4 4 4", "F F F F", "1 1 1 1", 40, "binary") + points.tobytes())
    with pytest.raises(DataError, match="1 points with NaN"):
        PCD.read(path, DEFAULT)
    points[:, :3] = np.nan
    path.write_bytes(head("x y z a", "4 4 4 4", "F F F F", "1 1 1 1", 40, "binary") + points.tobytes())
    assert len(PCD.read(path, DEFAULT)) == 0


@pytest.mark.parametrize("far", [False, True])
def test_written_back(tmp_path, rng, far):
    columns = {
        **{"rgb": rng.integers(0, 256, (300, 3), dtype=np.uint8), "intensity": rng.random(300).astype(np.float32)},
        **{"gps_time": rng.random(300) * 1e9, "label": rng.integers(-5, 90, 300, dtype=np.int32)},
        "big": rng.integers(2**60, 2**62, 300),
    }
    origin = np.array([480_000.0, 5_455_000.0, 0.0]) if far else np.zeros(3)
    xyz = rng.random((300, 3)).astype(np.float32).astype(np.float64)
    cloud = PointCloud(xyz, columns, origin)
    path = tmp_path / "a.pcd"
    PCD.write(path, cloud, WriteOptions())
    again = PCD.read(path, DEFAULT)
    np.testing.assert_allclose(again.world_xyz(), cloud.world_xyz(), rtol=0, atol=1e-9)
    assert set(again.columns) == set(columns)
    for name, values in columns.items():
        np.testing.assert_array_equal(again[name], values)
        assert again[name].dtype == values.dtype
    if not far:
        seen = o3d.t.io.read_point_cloud(str(path))
        np.testing.assert_array_equal(seen.point.positions.numpy(), xyz.astype(np.float32))
    with pytest.raises(DataError, match="'a b'"):
        PCD.write(path, cloud.with_columns(**{"a b": np.zeros(300)}), WriteOptions())


GOOD = ("x y z", "4 4 4", "F F F", "1 1 1")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"# .PCD v0.7\nFIELDS x y z\n", r"truncated or no PCD file: its header has no line DATA"),
        (head(*GOOD, 5, "zipped"), r"line 10: DATA 'zipped'"),
        (head(*GOOD, 5, "binary") + bytes(59), r"truncated: its header states 5 points of 12 bytes .* it holds 4"),
        (head(*GOOD, 3, "ascii") + b"1 2 3\n4 5 6\n", r"truncated: its header states 3 points, it holds 2"),
        (head(*GOOD, 2, "ascii") + b"1 2 3\n4 a 6\n", r"line 12: 'a' is not a number"),
        (head(*GOOD, 5, "binary", (2, 2)) + bytes(60), r"POINTS 5 in its header, but WIDTH x HEIGHT is 2 x 2"),
        (head("x y z", "4 3 4", "F F F", "1 1 1", 1, "binary"), r"field 'y' is of TYPE F and SIZE 3"),
        (head("x y z", "4 4", "F F F", "1 1 1", 1, "binary"), r"SIZE '4 4' in its header is not 3 whole numbers"),
        (head("x y z", "4 4 4", "F F F", "1 -1 1", 1, "binary"), r"COUNT '1 -1 1'"),
        (head("x y z", "4 4 4", "F F F", "1 1 999999999", 1, "binary"), r"records of over 1048576 bytes"),
        (head("x y x", "4 4 4", "F F F", "1 1 1", 1, "binary"), r"'x' is duplicated"),
        (head(*GOOD, 4_000_000_000, "binary_compressed") + struct.pack("<II", 9, 9), r"9 bytes of data for 4000000000"),
        (head(*GOOD, 1, "binary_compressed") + struct.pack("<II", 9, 12), r"truncated: 0 of 9 compressed bytes"),
        (
            head(*GOOD, 1, "binary_compressed") + struct.pack("<II", 3, 12) + b"\x20\x05a",
            r"damaged: its compressed data",
        ),
    ],
)
def test_damage_is_named(tmp_path, content, message):
    path = tmp_path / "a.pcd"
    path.write_bytes(content)
    with pytest.raises(ReadError, match=rf"a\.pcd.*{message}"):
        PCD.read(path, DEFAULT)


@pytest.mark.real_data
def test_wrong_offsets_in_the_header(real_data, caplog):
    path = real_data("sustech", "000965.pcd")
    with caplog.at_level("INFO"):
        cloud = get_format(path).read(path, DEFAULT)
    assert len(cloud) == 66_781
    assert np.unique(cloud["ring"]).tolist() == list(range(40))  # a scanner of 40 lines
    turn = cloud["gps_time"].max() - cloud["gps_time"].min()
    assert 0.09 < turn < 0.11  # at 10 turns a second
    assert np.isfinite(cloud["gps_time"]).all()
    assert np.abs(cloud.xyz).max() < 250
    elevation = np.degrees(np.arctan2(cloud.xyz[:, 2], np.hypot(cloud.xyz[:, 0], cloud.xyz[:, 1])))
    spread = [elevation[cloud["ring"] == ring].std() for ring in range(40)]
    assert np.median(spread) < 0.2  # each line keeps its elevation
