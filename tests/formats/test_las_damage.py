"""Damaged LAS and LAZ files: a clear error that names the file, at every point of truncation."""

import numpy as np
import pytest
from helpers.formats import make_las

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.registry import get_format

LAS = LasFormat()


@pytest.fixture(scope="module")
def laz(tmp_path_factory):
    path = tmp_path_factory.mktemp("laz") / "a.laz"
    make_las(path, np.random.default_rng(1), n=60_000, point_format=6, extras=False)
    return path.read_bytes()


def read(path, n_threads=1):
    options = ReadOptions(n_threads=n_threads)
    get_format(path).info(path, options)
    return LAS.read(path, options)


@pytest.mark.parametrize("n_threads", [1, 2])
def test_truncated_laz_at_every_part(tmp_path, laz, n_threads):
    path = tmp_path / "cut.laz"
    points = int.from_bytes(laz[96:100], "little")
    table = int.from_bytes(laz[points : points + 8], "little")
    evlrs = int.from_bytes(laz[235:243], "little")
    in_table, in_evlrs = range(table - 3, evlrs), range(evlrs, len(laz), 9001)
    places = [*range(1, points + 12, 23), *range(points + 12, table, 200_000), *in_table, *in_evlrs, len(laz) - 1]
    for size in places:
        path.write_bytes(laz[:size])
        with pytest.raises(ReadError, match=r"cut\.laz (is (truncated|damaged)|is named as LAS, but holds)"):
            read(path, n_threads)


def test_truncated_las(tmp_path, rng):
    path = tmp_path / "cut.las"
    make_las(path, rng, version="1.2", point_format=3, n=5)
    data = path.read_bytes()
    for size in range(4, len(data), 3):
        path.write_bytes(data[:size])
        with pytest.raises(ReadError, match=r"cut\.las is truncated"):
            read(path)


def test_truncated_las_says_how_many_points_are_left(tmp_path, rng):
    path = tmp_path / "cut.las"
    make_las(path, rng, version="1.2", point_format=3, n=20, extras=False)
    path.write_bytes(path.read_bytes()[: -34 * 3 - 1])
    with pytest.raises(ReadError, match=r"cut\.las .* 20 points.* 16$"):
        read(path)


@pytest.mark.parametrize(
    ("at", "value", "message"),
    [
        (24, b"\x02", r"is LAS 2\.4; versions 1\.0 to 1\.5"),
        (94, b"\x10\x01", r"a LAS 1\.4 header of 272 bytes, not 375"),
        (104, b"\x8b", r"points of format 11"),
        (105, b"\x10\x00", r"points of format 6 with 16 bytes, not 30"),
        (105, b"\x40\x00", r"LASzip record describes points of 30 bytes, its header of 64"),
        (100, b"\xff\x00\x00\x00", r"variable length record"),
        (131, b"\x00" * 8, r"scale \[0\.0, "),
        (247, (10**15).to_bytes(8, "little"), r"its \d+ bytes would become 30000000000000000 or more"),
    ],
)
def test_impossible_headers(tmp_path, laz, at, value, message):
    path = tmp_path / "bad.laz"
    path.write_bytes(laz[:at] + value + laz[at + len(value) :])
    with pytest.raises(ReadError, match=r"bad\.laz " + f".*{message}"):
        read(path)


@pytest.mark.parametrize("n_threads", [1, 2])
def test_damaged_chunk_table_is_not_believed(tmp_path, laz, n_threads):
    path = tmp_path / "bad.laz"
    points = int.from_bytes(laz[96:100], "little")
    table = int.from_bytes(laz[points : points + 8], "little")
    path.write_bytes(laz[: table + 4] + b"\xff\xff\xff\x7f" + laz[table + 8 :])
    with pytest.raises(ReadError, match=r"bad\.laz .*2147483647 chunks"):
        read(path, n_threads)


def test_laz_without_its_record(tmp_path, laz):
    path = tmp_path / "bad.laz"
    path.write_bytes(laz.replace(b"laszip encoded", b"laszip decoded"))
    with pytest.raises(ReadError, match=r"bad\.laz .*no LASzip record"):
        read(path)


def test_flipped_bytes_never_end_in_anything_but_a_read_error(tmp_path, laz):
    path, small, rng = tmp_path / "bad.laz", tmp_path / "small.laz", np.random.default_rng(5)
    make_las(small, rng, n=500, point_format=6, extras=False)
    refused = 0
    for whole, n_header, n_points in ((small.read_bytes(), 400, 40), (laz, 4, 4)):  # one chunk, and two
        points = int.from_bytes(whole[96:100], "little")
        for at in [*rng.integers(0, points, n_header), *rng.integers(points, len(whole), n_points)]:
            data = bytearray(whole)
            data[at] ^= int(rng.integers(1, 256))
            path.write_bytes(data)
            try:
                cloud = read(path)
            except DataError as error:
                assert "bad.laz" in str(error)
                refused += 1
            else:
                assert np.isfinite(cloud.xyz).all()
    assert refused >= 10
