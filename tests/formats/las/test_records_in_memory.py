"""Rows inside chunks of a small LAZ file come from memory, and are those of the file."""

import laspy
import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.las import records
from mlsroad_pipeline.formats.las.header import read_header
from mlsroad_pipeline.formats.las.records import RecordReader

N = 60_000
"""Points, in two chunks."""


def write(path, seed):
    cloud = laspy.create(point_format=6)
    cloud.x, cloud.y, cloud.z = np.random.default_rng(seed).uniform(0, 50, (3, N))
    cloud.intensity = np.arange(N) % 1000
    cloud.write(path)
    return cloud.points.array


def read(path, *rows):
    with RecordReader(path, read_header(path)) as reader:
        return [reader.read(*pair) for pair in rows]


@pytest.fixture(autouse=True)
def no_records(monkeypatch):
    monkeypatch.setattr(records, "_kept", {})


def test_ranges_are_those_of_the_file_and_a_whole_read_empties_the_memory(tmp_path):
    path = tmp_path / "street.laz"
    expected = write(path, seed=1)
    ranges = [(100, 200), (55_000, 55_010), (150, 160)]
    for rows, found in zip(ranges, read(path, *ranges), strict=True):
        np.testing.assert_array_equal(found, expected[slice(*rows)])
        found[:] = 0  # a copy
    assert len(records._kept) == 1
    (whole,) = read(path, (0, N))
    np.testing.assert_array_equal(whole, expected)
    assert whole.flags.writeable and not records._kept


def test_first_rows_and_rows_in_sequence_keep_nothing(tmp_path):
    path = tmp_path / "street.laz"
    expected = write(path, seed=1)
    np.testing.assert_array_equal(np.concatenate(read(path, (0, 10), (10, 300))), expected[:300])
    assert not records._kept


def test_a_changed_file_is_read_again(tmp_path):
    path = tmp_path / "street.laz"
    for seed in (1, 2):
        expected = write(path, seed)
        np.testing.assert_array_equal(read(path, (100, 200))[0], expected[100:200])


def test_a_damaged_chunk_spoils_its_own_rows_alone(tmp_path):
    path = tmp_path / "street.laz"
    expected = write(path, seed=1)
    with RecordReader(path, read_header(path)) as reader:
        second = int(reader._begins[1])
    with path.open("r+b") as stream:
        stream.seek(second)
        stream.write(b"\xff" * 200)
    np.testing.assert_array_equal(read(path, (100, 200))[0], expected[100:200])
    with pytest.raises(
        ReadError, match=rf"street\.laz is damaged: the chunk at byte {second} states 4294967295 points"
    ):
        read(path, (55_000, 55_010))
