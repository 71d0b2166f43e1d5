"""Layers of LAZ chunks that are copied: the bytes are those of compressing everything anew."""

import io

import laspy
import lazrs
import numpy as np
import pytest
from helpers.formats import make_labels, make_las

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.files import LAZ_CHUNK, spread_starts
from mlsroad_pipeline.formats.las import records
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.las.header import LASZIP, read_header
from mlsroad_pipeline.formats.las.layers import has_layers
from mlsroad_pipeline.formats.las.records import RecordReader
from mlsroad_pipeline.label import writer as labelled_writer
from mlsroad_pipeline.label.writer import write_labelled


def written(source, target, **options):
    write_labelled(source, target, make_labels, **options)
    return target.read_bytes()


@pytest.mark.parametrize("point_format", [6, 7, 8])
@pytest.mark.parametrize("classes", [True, False])
def test_copied_layers_give_the_bytes_of_compressing_anew(tmp_path, rng, monkeypatch, point_format, classes):
    source = tmp_path / "a.laz"
    las = make_las(source, rng, point_format=point_format, n=LAZ_CHUNK + 700, extras=classes, channels=True)
    if not classes:
        las.classification[:] = 0
        las.write(str(source))
    assert has_layers(read_header(source))
    copied = [written(source, tmp_path / f"{n}.laz", n_threads=n) for n in (1, 2)]
    monkeypatch.setattr(labelled_writer, "has_layers", lambda header: False)
    assert copied == [written(source, tmp_path / "c.laz")] * 2


def test_layers_that_are_not_looked_at_are_not_decompressed(tmp_path, rng, monkeypatch):
    source = tmp_path / "a.laz"
    make_las(source, rng, point_format=7)
    asked = []
    whole = RecordReader.__init__

    def watch(self, path, header, *, n_threads=1, select=-1):
        asked.append(select)
        whole(self, path, header, n_threads=n_threads, select=select)

    monkeypatch.setattr(RecordReader, "__init__", watch)
    write_labelled(source, tmp_path / "b.laz", make_labels, had_classes=False)
    position = int(lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL | lazrs.SELECTIVE_DECOMPRESS_Z)
    assert asked == [position]
    np.testing.assert_array_equal(laspy.read(tmp_path / "b.laz").red, laspy.read(source).red)


@pytest.mark.parametrize("point_format", [0, 3, 9, 10])
def test_other_point_formats_are_compressed_anew(tmp_path, rng, point_format):
    make_las(tmp_path / "a.laz", rng, point_format=point_format)
    assert not has_layers(read_header(tmp_path / "a.laz"))


def test_uncompressed_and_empty_files_have_no_layers(tmp_path, rng):
    make_las(tmp_path / "a.las", rng)
    make_las(tmp_path / "b.laz", rng, n=0)
    assert not has_layers(read_header(tmp_path / "a.las"))
    assert not has_layers(read_header(tmp_path / "b.laz"))


@pytest.mark.parametrize(("at", "value"), [(0, 2), (2, 1), (12, 0x51), (38, 4)])
def test_other_compressors_chunks_and_versions_of_items_are_not_copied(tmp_path, rng, at, value):
    source = tmp_path / "a.laz"
    make_las(source, rng, point_format=7)
    data = bytearray(source.read_bytes())
    record = read_header(source).find(LASZIP).data
    data[data.index(record) + at] = value
    source.write_bytes(data)
    assert not has_layers(read_header(source))


def test_a_damaged_chunk_is_an_error(tmp_path, rng):
    source = tmp_path / "a.laz"
    make_las(source, rng, point_format=7, n=2000)
    header = read_header(source)
    data = bytearray(source.read_bytes())
    sizes = header.point_offset + 8 + header.record_size + 4
    data[sizes : sizes + 4] = b"\xff\xff\xff\x7f"
    source.write_bytes(data)
    with pytest.raises(ReadError, match=r"a\.laz .*the chunk at byte"):
        write_labelled(source, tmp_path / "b.laz", make_labels, had_classes=False)
    assert [p.name for p in tmp_path.iterdir()] == ["a.laz"]


def test_what_lazrs_streams_is_read_back(tmp_path, rng):
    source, target = tmp_path / "a.laz", tmp_path / "b.laz"
    make_las(source, rng, point_format=6, n=2 * LAZ_CHUNK + 1)  # the last chunk has one point
    write_labelled(source, target, make_labels, n_threads=2, chunk_size=LAZ_CHUNK)
    new = laspy.read(io.BytesIO(target.read_bytes()))
    codes, confidence, _ = make_labels(0, len(new))
    np.testing.assert_array_equal(new.classification, codes)
    np.testing.assert_array_equal(new["confidence"], confidence)
    np.testing.assert_array_equal(new.xyz, laspy.read(source).xyz)


def test_samples_are_spread_evenly_and_begin_with_chunks_in_large_files():
    assert spread_starts(100, 16, 256) == [0]
    assert spread_starts(1000, 4, 100) == [0, 300, 600, 900]
    large = spread_starts(5_000_000, 16, 256)
    assert len(large) == 16 and large[0] == 0 and large[-1] == 4_950_000
    assert all(start % LAZ_CHUNK == 0 for start in large)
    assert max(np.diff(large)) <= 5_000_000 / 15 + LAZ_CHUNK
    assert spread_starts(0, 8, 10) == [0]


@pytest.mark.parametrize("point_format", [3, 6, 7, 8])
def test_columns_read_alone_are_those_of_all(tmp_path, rng, monkeypatch, point_format):
    monkeypatch.setattr(records, "KEPT_POINTS", 10)
    source = tmp_path / "a.laz"
    make_las(source, rng, point_format=point_format, n=2000, extras=True, channels=point_format >= 6)
    whole = LasFormat().read(source, ReadOptions())
    for name in whole.columns:
        own = LasFormat().read(source, ReadOptions(only=(name,)), start=100)
        assert name in own and len(own.columns) <= 2
        np.testing.assert_array_equal(own[name], whole[name][100:], err_msg=name)
        np.testing.assert_array_equal(own.xyz, whole.xyz[100:])
