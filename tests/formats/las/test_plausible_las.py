"""LAS files whose headers state what their points contradict: nothing is lost, and the results keep the rules of 1.4."""

import io
import struct

import laspy
import lazrs
import numpy as np
import pytest
from helpers.formats import make_labels, make_las
from helpers.las_rules import broken_rules
from laspy.vlrs.vlr import VLR

from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.las import counts
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.las.header import read_header
from mlsroad_pipeline.label.writer import write_labelled

LAS, DEFAULT = LasFormat(), ReadOptions()


def patch(path, form, at, *values):
    data = bytearray(path.read_bytes())
    struct.pack_into("<" + form, data, at, *values)
    path.write_bytes(data)


def labelled(path, tmp_path):
    target = tmp_path / "out" / "a.laz"
    write_labelled(path, target, make_labels)
    assert broken_rules(target) == []
    return laspy.read(target)


@pytest.mark.parametrize("extension", ["las", "laz"])
@pytest.mark.parametrize(
    "bounds",
    [(0,) * 6, (np.nan,) * 6, (1.7e308, -1.7e308) * 3, (1e300,) * 6, (-np.inf, np.inf) * 3, (9e9, 8e9) * 3],
)
@pytest.mark.parametrize("point_format", [1, 6])
def test_stated_bounds_change_no_coordinate(tmp_path, rng, extension, bounds, point_format):
    path = tmp_path / f"a.{extension}"
    las = make_las(path, rng, n=50, point_format=point_format, extras=False)
    patch(path, "6d", 179, *bounds)
    cloud = LAS.read(path, DEFAULT)
    np.testing.assert_allclose(cloud.world_xyz(), las.xyz, rtol=0, atol=1e-6)
    assert np.abs(cloud.xyz[:, :2]).max() < 1e4
    part = LAS.read(path, DEFAULT, start=20, stop=30)
    np.testing.assert_array_equal(part.xyz, cloud.xyz[20:30])
    np.testing.assert_array_equal(part.origin, cloud.origin)


@pytest.mark.parametrize(("version", "point_format"), [("1.2", 3), ("1.3", 4), ("1.4", 1), ("1.4", 7)])
@pytest.mark.parametrize("stated", [0, 1, 299])
def test_points_beyond_the_stated_number_are_read(tmp_path, rng, version, point_format, stated):
    path = tmp_path / "a.las"
    make_las(path, rng, version=version, point_format=point_format)
    las = laspy.read(path)
    if version == "1.4":
        patch(path, "Q", 247, stated)
    if point_format < 6:
        patch(path, "I", 107, stated)
    cloud = LAS.read(path, DEFAULT)
    np.testing.assert_allclose(cloud.world_xyz(), las.xyz, rtol=0, atol=1e-6)
    info = LAS.info(path, DEFAULT)
    assert info.n_points == 300
    assert f"its header states {stated} points, it holds 300: all are read" in info.notes
    assert len(labelled(path, tmp_path)) == 300


@pytest.mark.parametrize("stated", [0, 10, 50_000, 60_000])
def test_points_beyond_the_stated_number_of_a_laz_are_read(tmp_path, rng, stated):
    path = tmp_path / "a.laz"
    make_las(path, rng, point_format=6, n=60_001, extras=False)
    patch(path, "Q", 247, stated)
    assert len(LAS.read(path, DEFAULT)) == 60_001
    assert LAS.info(path, DEFAULT).notes == (f"its header states {stated} points, it holds 60001: all are read",)


@pytest.mark.parametrize(
    ("version", "point_format", "n", "stated"),
    [
        *(("1.2", 0, 2, 1), ("1.2", 0, 300, 0), ("1.2", 1, 300, 299), ("1.2", 2, 300, 7), ("1.2", 3, 300, 150)),
        *(("1.3", 4, 300, 298), ("1.3", 5, 300, 150), ("1.2", 1, 50_300, 5), ("1.4", 3, 50_300, 50_001)),
    ],
)
def test_the_last_chunk_of_a_laz_without_layers_is_read_to_its_end(tmp_path, rng, version, point_format, n, stated):
    path = tmp_path / "a.laz"
    las = make_las(path, rng, version=version, point_format=point_format, n=n, extras=n < 1000)
    patch(path, "I", 107, stated)
    if version == "1.4":
        patch(path, "Q", 247, stated)
    info = LAS.info(path, DEFAULT)
    assert info.notes == (f"its header states {stated} points, it holds {n}: all are read",)
    np.testing.assert_allclose(LAS.read(path, DEFAULT).world_xyz(), las.xyz, rtol=0, atol=1e-6)


def test_points_that_take_no_byte_are_told(tmp_path):
    path = tmp_path / "a.laz"
    las = laspy.create(point_format=1, file_version="1.2")
    las.x = las.y = las.z = np.full(3000, 7.0)
    las.write(path)
    assert LAS.info(path, DEFAULT).notes == ()
    patch(path, "I", 107, 1500)
    info = LAS.info(path, DEFAULT)
    (note,) = info.notes
    more = int(note.split("up to ")[1].split()[0])
    assert info.n_points < 3000 <= info.n_points + more and "points equal to the last ones" in note


def test_equal_points_take_few_compressions(tmp_path, monkeypatch):
    path, packed, calls = tmp_path / "a.laz", counts._packed, []
    las = laspy.create(point_format=1, file_version="1.2")
    las.x = las.y = las.z = np.full(49_000, 7.0)
    las.write(path)
    patch(path, "I", 107, 1)
    monkeypatch.setattr(counts, "_packed", lambda *given: calls.append(1) or packed(*given))
    assert 48_000 < LAS.info(path, DEFAULT).n_points <= 49_000
    assert 0 < len(calls) <= 32


@pytest.mark.parametrize("point_format", [3, 7])
def test_a_table_of_chunks_at_the_end_is_found(tmp_path, rng, point_format):
    path, streamed = tmp_path / "a.laz", tmp_path / "b.laz"
    version = "1.2" if point_format < 6 else "1.4"
    las = make_las(path, rng, version=version, point_format=point_format, extras=False)
    data, header = bytearray(path.read_bytes()), read_header(path)
    table = data[header.point_offset : header.point_offset + 8]
    data = data[: struct.unpack_from("<Q", data, 235)[0]] if header.evlrs else data
    struct.pack_into("<q", data, header.point_offset, -1)
    struct.pack_into("<I", data, 107, 0)
    if version == "1.4":
        struct.pack_into("<QIQ", data, 235, 0, 0, 11)
    streamed.write_bytes(data + table)
    assert len(LAS.read(streamed, DEFAULT)) == len(las) == 300


def test_bytes_after_the_points_are_no_points(tmp_path, rng):
    path = tmp_path / "a.las"
    make_las(path, rng, version="1.2", point_format=1, extras=False)
    data = path.read_bytes()
    for tail in (b"by us", bytes(28), bytes(4096)):
        path.write_bytes(data + tail)
        info = LAS.info(path, DEFAULT)
        assert info.n_points == 300 and info.notes == (
            f"{len(tail)} bytes after its 300 points are no points: not read",
        )


@pytest.mark.parametrize("where", [0, 200])
def test_extended_records_before_the_points_are_not_read(tmp_path, rng, where):
    path = tmp_path / "a.las"
    las = make_las(path, rng, extras=False)
    patch(path, "Q", 235, where)
    np.testing.assert_allclose(LAS.read(path, DEFAULT).world_xyz(), las.xyz, rtol=0, atol=1e-6)
    note = LAS.info(path, DEFAULT).notes[0]
    assert note == f"its header states 1 extended records at byte {where}, before its points: not read"
    labelled(path, tmp_path)


@pytest.mark.parametrize("encoding", [0, 4])
@pytest.mark.parametrize("start", [1, 100, 10**9])
@pytest.mark.parametrize("point_format", [1, 4])
def test_offset_of_waveforms_that_are_not_there(tmp_path, rng, point_format, start, encoding):
    path = tmp_path / "a.las"
    las = make_las(path, rng, version="1.3", point_format=point_format, extras=False)
    patch(path, "Q", 227, start)
    patch(path, "H", 6, encoding)
    if point_format == 4 and start == 10**9 and not encoding:
        return  # cut off: an error
    assert len(LAS.read(path, DEFAULT)) == len(las) == 300
    assert "waveform packets" in LAS.info(path, DEFAULT).notes[0]


@pytest.mark.parametrize("point_format", [0, 1, 3])
def test_laz_without_chunks(tmp_path, rng, point_format):
    path = tmp_path / "a.las"
    n = 60_000
    las = make_las(path, rng, version="1.2", point_format=point_format, n=n, extras=False)
    data, laz = path.read_bytes(), lazrs.LazVlr.new_for_compression(point_format, 0)
    begin, size = struct.unpack_from("<I", data, 96)[0], struct.unpack_from("<H", data, 105)[0]
    record = bytearray(laz.record_data())
    struct.pack_into("<I", record, 12, n)
    stream = io.BytesIO()
    compressor = lazrs.LasZipCompressor(stream, lazrs.LazVlr(bytes(record)))
    compressor.compress_many(np.frombuffer(data[begin : begin + n * size], np.uint8))
    compressor.done()
    packed = stream.getvalue()
    points = packed[8 : struct.unpack_from("<q", packed)[0]]
    struct.pack_into("<H", record, 0, 1)  # pointwise
    struct.pack_into("<I", record, 12, 0)
    vlr = struct.pack("<H16sHH32s", 0, b"laszip encoded", 22204, len(record), b"") + bytes(record)
    head = bytearray(data[:begin])
    head[104] |= 0x80
    struct.pack_into("<II", head, 96, begin + len(vlr), struct.unpack_from("<I", data, 100)[0] + 1)
    path = tmp_path / "b.laz"
    path.write_bytes(bytes(head) + vlr + points)
    cloud = LAS.read(path, ReadOptions(n_threads=2))
    np.testing.assert_allclose(cloud.world_xyz(), las.xyz, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(LAS.read(path, DEFAULT, start=50_000, stop=50_009).xyz, cloud.xyz[50_000:50_009])
    assert len(labelled(path, tmp_path)) == n


def descriptor(name, code, options=0):
    return struct.pack("<HBB32s4x120s32s", 0, code, options, name.encode(), b"", b"")


@pytest.mark.parametrize(
    ("spare", "records", "names"),
    [
        (7, [], ["extra_bytes"]),
        (300, [], ["extra_bytes", "extra_bytes_2"]),
        (24, [], ["extra_bytes", "extra_bytes_2", "extra_bytes_3", "extra_bytes_4"]),
        (6, [[("ring", 1), ("foo", 3)], [("bar", 3), ("u", 1)]], ["ring", "foo", "bar", "u"]),
        (2, [[("a", 1), ("a", 1)]], ["a", "a_extra"]),
        (2, [[("intensity", 3)]], ["intensity_extra"]),
        (2, [[("return_number", 3)]], ["return_number_extra"]),
        (2, [[("x", 1), ("", 1)]], ["x_extra", "unnamed"]),
        (4, [[("a", 1)]], ["a", "extra_bytes"]),
        (4, [[("a", 1), ("new", 99)]], ["a", "extra_bytes"]),
        (3, [[("a", 1), ("b", 1), ("c", 9)]], ["a", "b", "extra_bytes"]),
    ],
)
def test_extra_bytes_of_any_description_are_kept(tmp_path, spare, records, names):
    path = tmp_path / "a.las"
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales = np.full(3, 0.001)
    header.vlrs.extend([VLR("LASF_Spec", 4, "", b"".join(descriptor(*d) for d in r)) for r in records])
    las = laspy.LasData(header, laspy.ScaleAwarePointRecord.zeros(9, header=header))
    las.X = np.arange(9)
    las.write(str(path))
    data = bytearray(path.read_bytes())
    begin = struct.unpack_from("<I", data, 96)[0]
    rows = np.frombuffer(bytes(data[begin : begin + 270]), np.uint8).reshape(9, 30)
    extra = (np.arange(9 * spare) % 251).astype(np.uint8).reshape(9, spare)
    struct.pack_into("<H", data, 105, 30 + spare)
    struct.pack_into("<QI", data, 235, 0, 0)
    path.write_bytes(bytes(data[:begin]) + np.hstack([rows, extra]).tobytes())
    assert [d.name for d in read_header(path).extra_dimensions if d.name] == [
        n for n in _plain(names) if n != "unnamed"
    ]
    new = labelled(path, tmp_path)
    own = list(new.point_format.extra_dimension_names)
    assert own == [*names, "confidence", "object_id"]
    stored = np.hstack([np.ascontiguousarray(new.points.array[name]).view(np.uint8).reshape(9, -1) for name in names])
    np.testing.assert_array_equal(stored, extra)


def _plain(names):
    return [name.removesuffix("_extra") for name in names]


@pytest.mark.parametrize("dtype", ["u1", "i2", "i4", "f4", "f8"])
@pytest.mark.parametrize("scaled", [False, True])
def test_no_data_is_missing(tmp_path, dtype, scaled):
    path = tmp_path / "a.las"
    header = laspy.LasHeader(version="1.4", point_format=6)
    value = 255 if dtype == "u1" else -99
    scale = {"scales": [0.5], "offsets": [10.0]} if scaled else {}
    header.add_extra_dim(laspy.ExtraBytesParams("height", dtype, no_data=[value], **scale))
    las = laspy.LasData(header, laspy.ScaleAwarePointRecord.zeros(4, header=header))
    las.points.array["height"] = [3, value, 5, 7]
    las.write(str(path))
    cloud = LAS.read(path, DEFAULT)
    expected = np.array([3, np.nan, 5, 7]) * (0.5 if scaled else 1) + (10 if scaled else 0)
    np.testing.assert_array_equal(cloud["height"], expected)
    LAS.write(tmp_path / "b.las", cloud, WriteOptions())
    assert (tmp_path / "b.las").read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("version", "point_format"), [("1.1", 0), ("1.2", 3), ("1.3", 4), ("1.4", 6), ("1.4", 7), ("1.4", 8)]
)
@pytest.mark.parametrize("geotiff", [None, 25832, 32767])
def test_results_keep_the_rules(tmp_path, rng, version, point_format, geotiff):
    path = tmp_path / "a.laz"
    make_las(path, rng, version=version, point_format=point_format, geotiff=geotiff)
    target = tmp_path / "out" / "a.laz"
    write_labelled(path, target, make_labels)
    broken = broken_rules(target)
    allowed = ["a file with the WKT bit and GeoTIFF keys has WKT"] if geotiff == 32767 else []  # keys without meaning
    assert broken == allowed


@pytest.mark.parametrize("flag", ["withheld", "synthetic", "overlap", "key_point"])
@pytest.mark.parametrize(("point_format", "extension"), [(1, "las"), (3, "laz"), (6, "laz"), (6, "las"), (9, "laz")])
def test_withheld_points_keep_their_class(tmp_path, rng, point_format, extension, flag):
    if flag == "overlap" and point_format < 6:
        return
    path = tmp_path / f"a.{extension}"
    las = make_las(path, rng, point_format=point_format, n=400, extras=False)
    mask = np.arange(400) % 3 == 0
    las.withheld[:], las[flag][:] = False, mask
    las.classification[:] = 9
    las.write(str(path))
    was = laspy.read(path)

    def labels(start, stop):
        codes, confidence, numbers = make_labels(start, stop)
        withheld = mask[start:stop] & (flag == "withheld")
        return (
            np.where(withheld, 0, codes).astype(np.uint8),
            np.where(withheld, np.nan, confidence).astype("f4"),
            numbers,
        )

    write_labelled(path, tmp_path / "out" / "a.laz", labels)
    new = laspy.read(tmp_path / "out" / "a.laz")
    np.testing.assert_array_equal(new[flag], was[flag])
    codes, confidence, _ = make_labels(0, 400)
    kept = mask & (flag == "withheld")
    np.testing.assert_array_equal(new.classification, np.where(kept, 9, codes))
    np.testing.assert_array_equal(new["confidence"], np.where(kept, 0, confidence))
    assert broken_rules(tmp_path / "out" / "a.laz") == []


@pytest.mark.parametrize("noise", [7, 18])
@pytest.mark.parametrize(("point_format", "extension"), [(1, "las"), (3, "laz"), (6, "laz"), (9, "las")])
def test_points_with_a_class_of_noise_keep_it(tmp_path, rng, point_format, extension, noise):
    path = tmp_path / f"a.{extension}"
    las = make_las(path, rng, point_format=point_format, n=400, extras=False)
    mask = np.arange(400) % 3 == 0
    las.withheld[:], las.classification[:] = False, np.where(mask, noise, 2)
    las.write(str(path))

    def labels(start, stop):
        codes, confidence, numbers = make_labels(start, stop)
        return codes, np.where(mask[start:stop], np.nan, confidence).astype("f4"), numbers

    write_labelled(path, tmp_path / "out" / "a.laz", labels)
    new = laspy.read(tmp_path / "out" / "a.laz")
    codes, confidence, _ = make_labels(0, 400)
    np.testing.assert_array_equal(new.classification, np.where(mask, noise, codes))
    np.testing.assert_array_equal(new["confidence"], np.where(mask, 0, confidence))


def test_a_point_without_a_label_is_an_error(tmp_path, rng):
    path = tmp_path / "a.las"
    las = make_las(path, rng, extras=False)
    las.withheld[:] = False
    las.write(str(path))

    def labels(start, stop):
        codes, confidence, numbers = make_labels(start, stop)
        confidence[5] = np.nan
        return codes, confidence, numbers

    with pytest.raises(ValueError, match=r"a\.las: 1 of rows 0 to 299"):
        write_labelled(path, tmp_path / "out" / "a.laz", labels)


@pytest.mark.parametrize(
    ("name", "dtype", "missing"), [("label", "i4", 0), ("instance", "i4", -1), ("pid", "u8", 2**64 - 1)]
)
def test_whole_numbers_with_a_no_data_value_stay_whole(tmp_path, name, dtype, missing):
    path = tmp_path / "a.las"
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.add_extra_dim(laspy.ExtraBytesParams(name, dtype, no_data=[missing]))
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.arange(9.0).reshape(3, 3)
    las[name] = np.array([5, missing, 2**60 + 1 if dtype == "u8" else 7], dtype)
    las.write(path)
    cloud = LasFormat().read(path, ReadOptions())
    assert cloud[name].dtype.kind in "iu"
    assert cloud[name].tolist() == [5, missing, 2**60 + 1 if dtype == "u8" else 7]
