"""Memory-mapped arrays of NPZ files."""

import zipfile

import numpy as np
import pytest

from mlsroad_pipeline.execution.result_files import map_arrays

ARRAYS = {
    "float": np.linspace(0, 1, 1001),
    "table": np.arange(12, dtype=np.int16).reshape(3, 4),
    "columns": np.asfortranarray(np.arange(12.0).reshape(3, 4)),
    "text": np.array(["a", "bcd"]),
    "scalar": np.array(True),
    "none": np.zeros((0, 3), np.float32),
    "with.dot/and.slash": np.array([7], dtype=np.uint64),
}


@pytest.fixture
def path(tmp_path):
    np.savez(tmp_path / "arrays.npz", **ARRAYS)
    return tmp_path / "arrays.npz"


def test_arrays_are_those_that_numpy_reads(path):
    found = map_arrays(path)
    with np.load(path) as expected:
        assert list(found) == expected.files
        for name in expected.files:
            assert found[name].dtype == expected[name].dtype and found[name].shape == expected[name].shape
            np.testing.assert_array_equal(found[name], expected[name])


def test_what_is_written_stays_here_and_a_replaced_file_stays_readable(path):
    before = path.read_bytes()
    found = map_arrays(path)
    found["float"][:] = -1
    assert path.read_bytes() == before
    path.unlink()
    np.testing.assert_array_equal(found["table"], ARRAYS["table"])


def test_what_cannot_be_mapped_is_an_error(tmp_path, path):
    np.savez_compressed(tmp_path / "small.npz", values=np.zeros(100))
    with pytest.raises(ValueError, match=r"values.npy is compressed"):
        map_arrays(tmp_path / "small.npz")
    np.savez(tmp_path / "objects.npz", values=np.array([None]))
    with pytest.raises(ValueError, match=r"values.npy holds Python objects"):
        map_arrays(tmp_path / "objects.npz")
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(zipfile.BadZipFile):
        map_arrays(path)


def test_every_flipped_bit_of_the_arrays_is_noticed(path):
    sound = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        entry = archive.infolist()[0]
        begin = entry.header_offset + 30 + len(entry.filename)
        places = range(begin + 40, begin + entry.file_size, 641)
    map_arrays(path)
    for number, place in enumerate(places):
        data = bytearray(sound)
        data[place] ^= 1 << number % 8
        path.write_bytes(data)
        with pytest.raises(ValueError, match=r"float\.npy differs from its checksum"):
            map_arrays(path)
    path.write_bytes(sound)
    np.testing.assert_array_equal(map_arrays(path)["float"], ARRAYS["float"])
