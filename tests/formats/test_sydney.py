"""Sydney Urban Objects against `struct`, the two forms against each other, and what looks like them."""

import struct
from datetime import UTC, datetime

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MissingColumnError, ReadError
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.formats.sydney import NAMES, SydneyFormat, object_class

SYDNEY = SydneyFormat()
DEFAULT = ReadOptions()
RECORD = "<qBBfffffi"


def make_records(rng, n):
    """Return rows of t, intensity, id, x, y, z, azimuth, range and pid as the dataset has them."""
    xyz = rng.normal(size=(n, 3)).astype("f4") * 10
    azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
    t = 1_320_000_000_123_456 + np.cumsum(rng.integers(0, 50, n))
    other = rng.integers(0, 256, n), rng.integers(0, 64, n), np.linalg.norm(xyz, axis=1), rng.integers(0, 90_000, n)
    return [
        (
            int(t[i]),
            int(other[0][i]),
            int(other[1][i]),
            *map(float, (*xyz[i], azimuth[i], other[2][i])),
            int(other[3][i]),
        )
        for i in range(n)
    ]


def write_both(folder, rows):
    binary, text = folder / "tree.3.270.bin", folder / "tree.3.270.csv"
    binary.write_bytes(b"".join(struct.pack(RECORD, *row) for row in rows))
    lines = []
    for t, *values in rows:
        day = datetime.fromtimestamp(t // 1_000_000, UTC).strftime("%Y%m%dT%H%M%S")
        fraction = f".{t % 1_000_000:06d}" if t % 1_000_000 else ""
        lines.append(",".join([day + fraction, *(f"{v:.9g}" for v in values)]))
    text.write_text("\n".join(lines) + "\n")
    return binary, text


def test_both_forms_against_struct(tmp_path, rng):
    rows = make_records(rng, 50)
    rows[3] = (1_320_000_001_000_000, *rows[3][1:])  # a whole second has no fraction in text
    for path in write_both(tmp_path, rows):
        assert get_format(path).name == "Sydney"
        cloud = SYDNEY.read(path, DEFAULT)
        expected = dict(zip(("t", *NAMES[1:]), zip(*rows, strict=True), strict=True))
        np.testing.assert_array_equal(np.rint(cloud["gps_time"] * 1e6), expected["t"])
        np.testing.assert_array_equal(cloud["intensity"], np.float32(np.array(expected["intensity"]) / 255))
        np.testing.assert_array_equal(cloud.world_xyz(), np.stack([expected[a] for a in "xyz"], axis=1))
        for name in ("id", "azimuth", "range", "pid"):
            np.testing.assert_array_equal(cloud[name], np.array(expected[name], cloud[name].dtype))
        info = SYDNEY.info(path, DEFAULT)
        assert info.n_points == 50
        assert dict(info.columns) == {name: values.dtype for name, values in cloud.columns.items()}
        part = SYDNEY.read(path, DEFAULT, start=7, stop=9)
        np.testing.assert_array_equal(part["pid"], expected["pid"][7:9])
        assert object_class(path) == "tree"


def test_written_back_bit_for_bit(tmp_path, rng):
    binary, _ = write_both(tmp_path, make_records(rng, 200))
    cloud = SYDNEY.read(binary, DEFAULT)
    SYDNEY.write(tmp_path / "again.bin", cloud, WriteOptions())
    assert (tmp_path / "again.bin").read_bytes() == binary.read_bytes()
    with pytest.raises(MissingColumnError, match="Sydney records need range"):
        SYDNEY.write(tmp_path / "x.bin", cloud.without_columns(["range"]), WriteOptions())
    with pytest.raises(DataError, match="cannot hold label"):
        SYDNEY.write(tmp_path / "x.bin", cloud.with_columns(label=cloud["pid"]), WriteOptions())
    with pytest.raises(DataError, match="pid 3000000000 to 3000000000"):
        SYDNEY.write(tmp_path / "x.bin", cloud.with_columns(pid=np.full(200, 3_000_000_000)), WriteOptions())


def test_kitti_scans_and_tables_are_told_apart(tmp_path, rng):
    for n in (1, 17, 34, 272):
        path = tmp_path / f"{n}.bin"
        (rng.normal(size=(n, 4)) * 30).astype("<f4").tofile(path)
        assert get_format(path).name == "KITTI"
    np.zeros((34, 4), "<f4").tofile(path)
    assert get_format(path).name == "KITTI"
    table = tmp_path / "a.csv"
    table.write_text("20111104,1,56,6.2,2.7,1.1,0.4,6.8,1841\n")
    assert get_format(table).name == "text"


def test_damage_is_named(tmp_path, rng):
    binary, text = write_both(tmp_path, make_records(rng, 40))
    whole = binary.read_bytes()
    binary.write_bytes(whole[: 16 * 34 + 16])
    with pytest.raises(ReadError, match=r"270\.bin .* 560 bytes.* 34 "):
        get_format(binary).read(binary, DEFAULT)
    text.write_text(text.read_text()[:-30])
    with pytest.raises(ReadError, match=r"270\.csv .*Expected 9"):
        get_format(text).read(text, DEFAULT)
    with pytest.raises(ReadError, match="is not named .*class"):
        object_class("street.bin")


@pytest.mark.real_data
def test_recordings(real_data):
    folder = real_data("sydney", "objects")
    paths = sorted(folder.iterdir())
    assert {get_format(path).name for path in paths} == {"Sydney"}
    assert sum(path.suffix == ".bin" for path in paths) == 433
    assert len({object_class(path) for path in paths if path.suffix == ".bin"}) >= 14
    texts = [path for path in paths if path.suffix == ".csv"]
    assert len(texts) == 20
    for path in texts:
        text, binary = SYDNEY.read(path, DEFAULT), SYDNEY.read(path.with_suffix(".bin"), DEFAULT)
        np.testing.assert_array_equal(np.rint(text["gps_time"] * 1e6), np.rint(binary["gps_time"] * 1e6))
        np.testing.assert_allclose(text.xyz, binary.xyz, rtol=1e-5)  # six digits in the text
        for name in ("intensity", "id", "pid"):
            np.testing.assert_array_equal(text[name], binary[name])
