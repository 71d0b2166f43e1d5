"""Records of LAS files that other readers refuse: results of such files open in laspy and keep the rules of LAS 1.4."""

import struct

import laspy
import numpy as np
import pyproj
import pytest
from helpers.formats import make_labels, make_las
from helpers.las_rules import broken_rules

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.las.header import read_header
from mlsroad_pipeline.formats.las.records import unique_names
from mlsroad_pipeline.formats.las.upgrade import upgraded_header
from mlsroad_pipeline.label.writer import write_labelled

LAS, DEFAULT = LasFormat(), ReadOptions()
PROJECTION = b"LASF_Projection"


def described(kind, name, options=0, description=b"", scale=0.0, offset=0.0):
    head = struct.pack("<2xBB32s4x", kind, options, name)
    return head + bytes(72) + struct.pack("<3d3d32s", scale, 0, 0, offset, 0, 0, description)


def with_records(path, records, spare=0, changes=()):
    """Insert records and bytes of points into a LAS file."""
    data = bytearray(path.read_bytes())
    begin, n_records, size = *struct.unpack_from("<II", data, 96), struct.unpack_from("<H", data, 105)[0]
    points = np.frombuffer(bytes(data[begin:]), np.uint8).reshape(-1, size)
    points = np.concatenate([points, numbered(len(points), spare)], axis=1)
    inserted = b"".join(
        struct.pack("<H16sHH32s", reserved, user, number, len(text), b"caf\xe9") + text
        for reserved, user, number, text in records
    )
    struct.pack_into("<II", data, 96, begin + len(inserted), n_records + len(records))
    struct.pack_into("<H", data, 105, size + spare)
    for form, at, value in changes:
        struct.pack_into("<" + form, data, at, value)
    path.write_bytes(bytes(data[:begin]) + inserted + points.tobytes())


def numbered(rows, columns):
    return np.arange(rows * columns).astype(np.uint8).reshape(rows, columns)


def labelled(path):
    target = path.parent / "out" / "a.laz"
    write_labelled(path, target, make_labels)
    assert broken_rules(target) == []
    return laspy.read(target)


def plain(path, rng, **more):
    return make_las(path, rng, version="1.2", point_format=1, n=50, extras=False, **more)


@pytest.mark.parametrize(
    ("spare", "descriptors", "names"),
    [
        (31, [described(0, b"blob", 31)], ["blob", *(f"blob_{i}" for i in range(2, 6))]),
        (9, [described(0, b"blob", 0), described(10, b"f")], ["blob", "f"]),
        (2, [described(1, b"n" * 32), described(1, b"n" * 32)], ["n" * 32, "n" * 26 + "_extra"]),
        (2, [described(1, "ä".encode() * 16), described(1, "ä".encode() * 16)], ["ä" * 16, "ä" * 13 + "_extra"]),
        (1, [described(1, b"h\xf6he", description=b"m\xb2")], ["höhe"]),
        (4, [described(5, b"a", 24, scale=np.nan, offset=np.inf)], ["a"]),
        (1, [described(1, b"rgb")], ["rgb"]),
    ],
)
def test_descriptors_that_laspy_cannot_read(tmp_path, rng, spare, descriptors, names):
    path = tmp_path / "a.las"
    plain(path, rng)
    with_records(path, [(0, b"LASF_Spec", 4, b"".join(descriptors))], spare)
    found = labelled(path)
    own = list(found.point_format.extra_dimension_names)[: len(names)]
    assert own == names
    stored = [np.ascontiguousarray(found.points.array[name]).reshape(50, -1).view(np.uint8) for name in own]
    np.testing.assert_array_equal(np.concatenate(stored, axis=1), numbered(50, spare))


def wkt(code):
    return pyproj.CRS(code).to_wkt("WKT1_GDAL").encode() + b"\0"


@pytest.mark.parametrize(
    ("records", "changes", "note"),
    [
        ([(0xAABB, b"B\xfcro", 1, b"x")], (), ""),
        ([(0, PROJECTION, 2112, wkt(25832)), (0, PROJECTION, 2112, wkt(25833))], (), "2 WKT records that differ"),
        ([(0, b"LASF_Spec", 0, bytes(16)), (0, b"LASF_Spec", 0, bytes(16))], (), ""),
        ([], (("H", 90, 999), ("H", 6, 0xFFFF)), ""),
    ],
)
def test_records_and_fields_that_break_the_rules(tmp_path, rng, records, changes, note):
    path = tmp_path / "a.las"
    las = plain(path, rng)
    with_records(path, records, changes=changes)
    notes = LAS.info(path, DEFAULT).notes
    assert [note in text for text in notes] == [True] * bool(note)
    np.testing.assert_allclose(labelled(path).xyz, las.xyz, rtol=0, atol=1e-6)


@pytest.mark.parametrize("first", [b"\0", b"no system\0"])
def test_wkt_that_is_none_does_not_hide_another(tmp_path, rng, first):
    path = tmp_path / "a.las"
    plain(path, rng)
    with_records(path, [(0, PROJECTION, 2112, first), (0, PROJECTION, 2112, wkt(25832))])
    assert pyproj.CRS(LAS.info(path, DEFAULT).crs).to_epsg() == 25832
    assert labelled(path).header.parse_crs().to_epsg() == 25832


def test_times_of_las_1_5_stay_relative_to_an_offset(tmp_path, rng):
    path = tmp_path / "a.las"
    make_las(path, rng, version="1.4", point_format=6, n=50, extras=False)
    data = bytearray(path.read_bytes())
    struct.pack_into("<Q", data, 235, struct.unpack_from("<Q", data, 235)[0] + 18)
    struct.pack_into("<HI", data, 94, 393, struct.unpack_from("<I", data, 96)[0] + 18)
    data[25:26], data[375:375] = b"\x05", bytes(16) + struct.pack("<H", 1200)
    struct.pack_into("<H", data, 6, 0xFFF9)
    path.write_bytes(data)
    header = upgraded_header(read_header(path))
    assert (header.minor, header.integer("encoding"), *struct.unpack_from("<H", header.block, 391)) == (
        5,
        0b1011001,
        1200,
    )


def test_names_that_end_like_those_of_duplicates_become_unique():
    given = ["a", "a_extra", "a_extra_extra", "a_6", "a_6_extra", "a_6_extra_extra", "a"]
    assert unique_names(6, given) == [*given[:-1], "a_7"]


def test_points_of_a_later_format_than_the_version(tmp_path, rng):
    path = tmp_path / "a.las"
    make_las(path, rng, point_format=6, n=50, extras=False)
    data = bytearray(path.read_bytes())
    data[25] = 2
    struct.pack_into("<I", data, 107, 50)
    path.write_bytes(data)
    assert len(labelled(path)) == 50


@pytest.mark.parametrize(("point_format", "more"), [(0, 1), (1, 1), (3, 400)])
def test_more_points_stated_than_a_chunk_has(tmp_path, rng, point_format, more):
    path = tmp_path / "a.laz"
    make_las(path, rng, version="1.2", point_format=point_format, n=300, extras=False)
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, 107, 300 + more)
    path.write_bytes(data)
    with pytest.raises(ReadError, match=rf"a\.laz is truncated .* states {300 + more} points, it holds 300"):
        LAS.read(path, DEFAULT)
