"""E57: files laid out by hand, poses, flags, bit-packed fields, checksums, and round trips."""

import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.crs import parse_crs
from mlsroad_pipeline.formats.e57.format import E57Format
from mlsroad_pipeline.formats.registry import get_format

E57 = E57Format()
DEFAULT = ReadOptions()
SPACE = "http://www.astm.org/COMMIT/E57/2010-e57-v1.0"


def crc32c(data):
    """Return the checksum bit by bit."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def physical(at):
    return at // 1020 * 1024 + at % 1020


def packed_bits(values, minimum, bits):
    number = sum((int(v) - minimum) << (i * bits) for i, v in enumerate(values))
    return number.to_bytes(-(-len(values) * bits // 8), "little")


def build(path, scans, *, per_packet=7, metadata=""):
    """Write scans given as (xml of the scan but its points, xml of the prototype, [bytes of each stream], count)."""
    content = bytearray(48)
    nodes = []
    for head, prototype, streams, count in scans:
        at = len(content)
        packets = b""
        pieces = [[s[i : i + per_packet] for i in range(0, len(s), per_packet)] for s in streams]
        for k in range(max(map(len, pieces), default=0)):
            parts = [p[k] if k < len(p) else b"" for p in pieces]
            body = b"".join(struct.pack("<H", len(p)) for p in parts) + b"".join(parts)
            size = -(-(6 + len(body)) // 4) * 4
            packets += struct.pack("<BBHH", 1, 0, size - 1, len(parts)) + body.ljust(size - 6, b"\0")
            packets += struct.pack("<BBH", 2, 0, 7) + bytes(4)  # a packet to be ignored
        content += struct.pack("<B7xQQQ", 1, 32 + len(packets), physical(at + 32), 0) + packets
        nodes.append(
            f'<vectorChild type="Structure">{head}<points type="CompressedVector" fileOffset="{physical(at)}" '
            f'recordCount="{count}"><prototype type="Structure">{prototype}</prototype></points></vectorChild>'
        )
    xml = (
        f'<?xml version="1.0"?><e57Root type="Structure" xmlns="{SPACE}" xmlns:nor="http://normals">'
        f'<coordinateMetadata type="String">{metadata}</coordinateMetadata>'
        f'<data3D type="Vector">{"".join(nodes)}</data3D></e57Root>'
    ).encode()
    at = len(content)
    content += xml
    n_pages = -(-len(content) // 1020)
    content[:48] = struct.pack("<8sIIQQQQ", b"ASTM-E57", 1, 0, n_pages * 1024, physical(at), len(xml), 1024)
    content = bytes(content).ljust(n_pages * 1020, b"\0")
    pages = [content[i : i + 1020] for i in range(0, len(content), 1020)]
    path.write_bytes(b"".join(page + struct.pack(">I", crc32c(page)) for page in pages))


FLOATS = "".join(f'<cartesian{axis} type="Float" precision="double"/>' for axis in "XYZ")


def test_steps_of_single_floats_are_those_of_the_valid_points(tmp_path):
    path, n = tmp_path / "a.e57", 200
    xyz = (np.random.default_rng(0).random((n, 3)) + [389_300, 5_819_700, 34]).astype("<f4")
    state = np.zeros(n, int)
    xyz[:150], state[:150] = 0, 2
    fields = FLOATS.replace("double", "single") + '<cartesianInvalidState type="Integer" minimum="0" maximum="2"/>'
    build(path, [("", fields, [*(xyz[:, i].tobytes() for i in range(3)), packed_bits(state, 0, 2)], n)])
    (note,) = E57.info(path, DEFAULT).notes
    assert "floats of 32 bits in steps of 0.5 m" in note
    assert E57.info(path, ReadOptions(units="millimetre")).notes == ()


def test_two_scans_with_poses_flags_and_packed_fields(tmp_path, rng, caplog):
    n = 60
    xyz, turn = rng.normal(size=(n, 3)) * 20, Rotation.from_euler("zyx", [50, 20, -10], degrees=True)
    x, y, z, w = turn.as_quat()
    pose = (
        f'<pose type="Structure"><rotation type="Structure"><w type="Float">{w}</w><x type="Float">{x}</x>'
        f'<y type="Float">{y}</y><z type="Float">{z}</z></rotation><translation type="Structure">'
        '<x type="Float">480000</x><y type="Float">5455000</y><z type="Float">100</z></translation></pose>'
        '<intensityLimits type="Structure"><intensityMinimum type="Integer">100</intensityMinimum>'
        '<intensityMaximum type="Integer">2147</intensityMaximum></intensityLimits>'
        '<acquisitionStart type="Structure"><dateTimeValue type="Float">1000</dateTimeValue></acquisitionStart>'
    )
    intensity, state = rng.integers(100, 2148, n), rng.integers(0, 3, n)
    colour, line = rng.integers(0, 256, n), rng.integers(-5, 8, n)
    time = rng.integers(0, 10**6, n)
    first = FLOATS + (
        '<intensity type="Integer" minimum="100" maximum="2147"/>'
        '<cartesianInvalidState type="Integer" minimum="0" maximum="2"/>'
        '<colorRed type="Integer" minimum="0" maximum="255"/><colorGreen type="Integer" minimum="0" maximum="255"/>'
        '<colorBlue type="Integer" minimum="9" maximum="9"/><rowIndex type="Integer" minimum="-5" maximum="7"/>'
        '<timeStamp type="ScaledInteger" minimum="0" maximum="1000000" scale="0.001" offset="5"/>'
    )
    streams = [*(xyz[:, i].tobytes() for i in range(3)), packed_bits(intensity, 100, 11), packed_bits(state, 0, 2)]
    streams += [packed_bits(colour, 0, 8), packed_bits(colour, 0, 8), b"", packed_bits(line, -5, 4)]
    streams += [packed_bits(time, 0, 20)]
    sphere = rng.random((5, 3)).astype("<f4")
    second = "".join(f'<spherical{a} type="Float" precision="single"/>' for a in ("Range", "Azimuth", "Elevation")) + (
        '<nor:normalX type="Float" precision="single"/>'
    )
    more = [sphere[:, i].tobytes() for i in range(3)] + [sphere[:, 0].tobytes()]
    path = tmp_path / "a.e57"
    build(path, [(pose, first, streams, n), ("", second, more, 5)], metadata="EPSG:25832")
    with caplog.at_level("INFO"):
        cloud = get_format(path).read(path, DEFAULT)
    kept = state == 0
    m = kept.sum()
    assert f"{n - m} of {n + 5} points are flagged invalid" in caplog.text
    assert "only some of its scans have" in caplog.text
    world = turn.apply(xyz[kept]) + [480000, 5455000, 100]
    np.testing.assert_allclose(cloud.world_xyz()[:m], world, rtol=0, atol=1e-8)
    r, azimuth, elevation = sphere.astype(float).T
    expected = np.stack([r * np.cos(elevation) * np.cos(azimuth), r * np.cos(elevation) * np.sin(azimuth)], axis=1)
    np.testing.assert_allclose(cloud.world_xyz()[m:, :2], expected, atol=1e-8)
    np.testing.assert_allclose(cloud.world_xyz()[m:, 2], r * np.sin(elevation), atol=1e-8)
    np.testing.assert_array_equal(cloud["scan"], np.repeat([0, 1], [m, 5]))
    np.testing.assert_allclose(cloud["intensity"][:m], (intensity[kept] - 100) / 2047, rtol=1e-6)
    assert np.isnan(cloud["intensity"][m:]).all()
    np.testing.assert_array_equal(cloud["rgb"][:m, 0], colour[kept])
    assert set(cloud["rgb"][:m, 2].tolist()) == {9}
    np.testing.assert_array_equal(cloud["rowIndex"][:m], line[kept])
    np.testing.assert_allclose(cloud["gps_time"][:m], 1005 + time[kept] * 0.001, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(cloud["normalX"][m:], sphere[:, 0])
    assert cloud.crs == parse_crs("EPSG:25832")
    assert E57.info(path, DEFAULT).n_points == m + 5
    raw = E57.read(path, ReadOptions(intensity_scale=2147.0))
    np.testing.assert_allclose(raw["intensity"][:m], intensity[kept] / 2147, rtol=1e-6)
    for start, stop in [(0, 3), (m - 2, m + 2), (m, None), (4, 4)]:
        part = E57.read(path, DEFAULT, start=start, stop=stop)
        np.testing.assert_array_equal(part.xyz, cloud.xyz[start:stop])
        np.testing.assert_array_equal(part["gps_time"], cloud["gps_time"][start:stop])


def test_written_back(tmp_path, rng):
    n = 5000  # several packets
    columns = {
        **{"rgb": rng.integers(0, 256, (n, 3), dtype=np.uint8), "intensity": rng.random(n).astype(np.float32)},
        **{"gps_time": rng.random(n) * 1e9, "label": rng.integers(-9, 90, n, dtype=np.int32)},
        "big": rng.integers(-(2**62), 2**62, n),
    }
    cloud = PointCloud(
        rng.random((n, 3)) * 100, columns, np.array([480_000.0, 5_455_000.0, 0]), parse_crs("EPSG:25832")
    )
    path = tmp_path / "a.e57"
    E57.write(path, cloud, WriteOptions())
    again = E57.read(path, DEFAULT)
    np.testing.assert_array_equal(again.world_xyz(), cloud.world_xyz())
    assert set(again.columns) == set(columns)
    for name, values in columns.items():
        np.testing.assert_array_equal(again[name], values)
        assert again[name].dtype == values.dtype
    assert again.crs == cloud.crs
    E57.write(path, cloud.select(np.arange(0)), WriteOptions())
    assert len(E57.read(path, DEFAULT)) == 0
    with pytest.raises(DataError, match="'a b'"):
        E57.write(path, cloud.with_columns(**{"a b": np.zeros(n)}), WriteOptions())


def test_damage_is_named(tmp_path, rng):
    path = tmp_path / "a.e57"
    xyz = rng.normal(size=(200, 3))
    streams = [xyz[:, i].tobytes() for i in range(3)]
    build(path, [("", FLOATS, streams, 200)], per_packet=800)
    assert len(E57.read(path, DEFAULT)) == 200
    whole = path.read_bytes()
    path.write_bytes(whole[:-1024])
    with pytest.raises(ReadError, match=r"a\.e57 .* states \d+ bytes"):
        E57.read(path, DEFAULT)
    flipped = bytearray(whole)
    flipped[1500] ^= 4
    path.write_bytes(flipped)
    with pytest.raises(ReadError, match=r"a\.e57 .*checksum.* byte 1024"):
        E57.read(path, DEFAULT)
    for prototype, count, message in [
        (FLOATS, 201, r"states 201 points, its field cartesianX holds 200"),
        (FLOATS + '<a type="Integer" minimum="5" maximum="1"/>', 200, r"field a has limits 5 to 1"),
        (FLOATS, 10**15, r"states 1000000000000000 points"),
        (FLOATS.replace("cartesianX", "other"), 200, r"scan 0 has no coordinates \(fields: other"),
        (FLOATS.replace('type="Float"', 'type="Blob"'), 200, r"is of type 'Blob'"),
    ]:
        build(path, [("", prototype, streams, count)], per_packet=800)
        with pytest.raises(ReadError, match=message):
            E57.read(path, DEFAULT)
    build(path, [], metadata="<a")
    with pytest.raises(ReadError, match=r"a\.e57 is damaged: its XML"):
        E57.read(path, DEFAULT)
    build(path, [])
    with pytest.raises(ReadError, match="has no scans"):
        E57.read(path, DEFAULT)
