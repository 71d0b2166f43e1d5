"""Headers that lack or repeat something, and columns that are none of coordinates: an error, or a sentence."""

import struct

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.formats.base import NEW_SURVEY, ReadOptions
from mlsroad_pipeline.formats.registry import get_format

DEFAULT = ReadOptions()
XYZ = np.random.default_rng(0).random((200, 3)) + [389_300, 5_819_700, 34]


def notes(path):
    return get_format(path).info(path, DEFAULT).notes


def ply(path, properties, records):
    lines = [*("ply", "format binary_little_endian 1.0", f"element vertex {len(records)}"), *properties, "end_header"]
    path.write_bytes(("\n".join(lines) + "\n").encode() + records.tobytes())


def pcd(path, records, **entries):
    fields = {"FIELDS": "x y z q", "SIZE": "8 8 8 4", "TYPE": "F F F F", "COUNT": "1 1 1 1"} | entries
    head = {"VERSION": "0.7", **fields, "WIDTH": len(records), "HEIGHT": 1, "POINTS": len(records), "DATA": "binary"}
    path.write_bytes("".join(f"{key} {value}\n" for key, value in head.items()).encode() + records.tobytes())


def records_of(dtype="f8"):
    records = np.zeros(len(XYZ), [(name, dtype) for name in "xyz"] + [("q", "f4")])
    for name, values in zip("xyz", XYZ.T, strict=True):
        records[name] = values
    return records


def test_a_property_that_the_header_lacks(tmp_path):
    ply(tmp_path / "a.ply", [f"property double {name}" for name in "xyz"], records_of())
    with pytest.raises(ReadError, match=r"a\.ply.* 24 .* 28 .* 200.*property"):
        notes(tmp_path / "a.ply")
    pcd(tmp_path / "a.pcd", records_of(), FIELDS="x y z", SIZE="8 8 8", TYPE="F F F", COUNT="1 1 1")
    with pytest.raises(ReadError, match=r"a\.pcd.* 28 .* 200.*field"):
        notes(tmp_path / "a.pcd")


def test_half_of_the_points_stated_is_no_missing_property(tmp_path):
    path = tmp_path / "a.ply"
    ply(path, [*(f"property double {name}" for name in "xyz"), "property float q"], records_of())
    path.write_bytes(path.read_bytes().replace(b"vertex 200", b"vertex 100"))
    assert notes(path) == ("its header states 100 points, 2800 more bytes follow: they are not read",)


def test_whole_points_behind_the_stated_ones_are_no_missing_property(tmp_path):
    path, lines = tmp_path / "a.ply", [f"property double {name}" for name in "xyzq"]
    records = records_of().astype([(name, "f8") for name in "xyzq"])
    records["q"] = XYZ[:, 0] / 7
    records = np.concatenate([records, records[:100]])
    ply(path, lines[:3], records)
    with pytest.raises(ReadError, match=" 32 .* 300 .*lacks a property"):
        notes(path)
    ply(path, lines, records)
    path.write_bytes(path.read_bytes().replace(b"vertex 300", b"vertex 200"))
    assert notes(path) == ("its header states 200 points, 3200 more bytes follow: they are not read",)
    pcd(tmp_path / "a.pcd", records, SIZE="8 8 8 8")
    data = (tmp_path / "a.pcd").read_bytes()
    (tmp_path / "a.pcd").write_bytes(data.replace(b"WIDTH 300", b"WIDTH 200").replace(b"POINTS 300", b"POINTS 200"))
    assert notes(tmp_path / "a.pcd") == ("its header states 200 points, 3200 more bytes follow: they are not read",)


@pytest.mark.parametrize("comment", ["#.PCD v.7", "#comment", "# made by us"])
def test_comments_at_the_head_of_a_pcd(tmp_path, comment):
    path = tmp_path / "a.pcd"
    pcd(path, records_of())
    path.write_bytes(comment.encode() + b"\n" + path.read_bytes())
    np.testing.assert_array_equal(get_format(path).read(path, DEFAULT).world_xyz(), XYZ)


def test_lines_of_a_pcd(tmp_path):
    path = tmp_path / "a.pcd"
    pcd(path, records_of())
    data = path.read_bytes()
    path.write_bytes(data.replace(b"SIZE", b"FIELDS z y x q\nSIZE"))
    with pytest.raises(ReadError, match=r"a\.pcd, line 3: .*'FIELDS z"):
        notes(path)
    head, _, tail = data.partition(b"DATA binary\n")
    path.write_bytes(head.replace(b"VERSION 0.7\n", b"").replace(b" ", b"\t") + b"DATA binary\n" + tail)
    np.testing.assert_array_equal(get_format(path).read(path, DEFAULT).world_xyz(), XYZ)


@pytest.mark.parametrize("form", ["ply", "pcd", "npz", "local.npz"])
def test_coordinates_that_are_too_coarse(tmp_path, form):
    path, records = tmp_path / f"a.{form}", records_of("f4")
    if form == "ply":
        ply(path, [f"property float {name}" for name in "xyzq"], records)
    elif form == "pcd":
        pcd(path, records, SIZE="4 4 4 4")
    else:
        np.savez(path, xyz=(XYZ - (XYZ[0] if form == "local.npz" else 0)).astype(np.float32))
    found = [note for note in notes(path) if "floats of 32 bits in steps of 0.5 m" in note]
    assert len(found) == (form != "local.npz")


def test_steps_of_floats_are_compared_in_metres_and_at_many_points(tmp_path):
    path, lines = tmp_path / "a.ply", [f"property float {name}" for name in "xyzq"]
    records = records_of("f4")
    for name, values in zip("xyz", (XYZ - XYZ[0] + 300).T * 1000, strict=True):
        records[name] = values
    ply(path, lines, records)
    assert get_format(path).info(path, ReadOptions(units="millimetre")).notes == ()
    far = records_of("f4")
    far[0] = 0
    ply(path, lines, far)
    assert any("in steps of 0.5 m" in note for note in notes(path))


@pytest.mark.parametrize("first", [0, 1, 500_000])
def test_rows_that_count_themselves(tmp_path, first):
    path = tmp_path / "a.txt"
    np.savetxt(path, np.column_stack([np.arange(200) + first, XYZ]), fmt="%d %.3f %.3f %.3f")
    with pytest.raises(
        ReadError, match=rf"a\.txt, line 1: its first column, {first:g}, counts the rows.*columns by index"
    ):
        notes(path)
    placed = ReadOptions(columns={"x": 1, "y": 2, "z": 3})
    np.testing.assert_allclose(get_format(path).read(path, placed).world_xyz(), XYZ, rtol=0, atol=6e-4)


@pytest.mark.parametrize(
    "columns",
    [
        (np.arange(1, 4), np.arange(2, 5), np.arange(3, 6)),
        (np.arange(200), np.zeros(200), XYZ[:, 2]),
        (np.sort(XYZ[:, 0]), XYZ[:, 1], XYZ[:, 2]),
        (np.sort(XYZ[:, 0] - XYZ[0, 0]) * 999, XYZ[:, 1] - XYZ[0, 1], XYZ[:, 2]),
    ],
    ids=["three points", "a line of a grid", "sorted eastings", "sorted local x"],
)
def test_growing_x_is_x(tmp_path, columns):
    path = tmp_path / "a.txt"
    np.savetxt(path, np.column_stack([*columns, np.arange(len(columns[0])) % 7]), fmt="%.4f")
    assert notes(path) == ()
    np.testing.assert_allclose(get_format(path).read(path, DEFAULT).world_xyz()[:, 0], columns[0], rtol=0, atol=6e-5)


def test_times_in_front_are_told(tmp_path):
    path = tmp_path / "a.txt"
    np.savetxt(path, np.column_stack([1e5 + np.arange(200) ** 1.01, XYZ]), fmt="%.4f")
    assert any("first column is read as x, but grows" in note for note in notes(path))
    np.savetxt(path, np.column_stack([XYZ, np.arange(200)]), fmt="%.4f")
    assert notes(path) == ()


@pytest.mark.parametrize(
    ("head", "between"),
    [("Easting (m)\tNorthing (m)\tHeight (m)", "\t"), ("X [m],Y [m],Z [m]", ","), ("Point X\tPoint Y\tPoint Z", "\t")],
)
def test_names_with_units(tmp_path, head, between):
    path = tmp_path / "a.txt"
    np.savetxt(path, XYZ, fmt="%.3f", delimiter=between, header=head, comments="")
    np.testing.assert_allclose(get_format(path).read(path, DEFAULT).world_xyz(), XYZ, rtol=0, atol=6e-4)


def table(path, names, *columns):
    np.savetxt(path, np.column_stack([XYZ, *columns]), fmt="%.3f", delimiter=",", header=names, comments="")


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("x (local),y (local),z (local)", "x,y,z"),
        ("x (sensor),y (sensor),z (sensor)", "Easting,Northing,Height (m)"),
        ("x [m],y [m],z [m]", "X,Y,Z"),
        ("r [mm],i (raw),label (auto)", "x,y,z [m]"),
    ],
)
def test_names_in_brackets_do_not_replace_others(tmp_path, first, second):
    np.savetxt(
        tmp_path / "a.csv", np.column_stack([XYZ - 9, XYZ]), "%.3f", ",", header=f"{first},{second}", comments=""
    )
    cloud = get_format(tmp_path / "a.csv").read(tmp_path / "a.csv", DEFAULT)
    np.testing.assert_allclose(cloud.world_xyz(), XYZ, rtol=0, atol=6e-4)
    assert set(cloud.columns) == set(first.split(","))


@pytest.mark.parametrize(
    ("names", "option", "more"),
    [
        ("Easting (ft),Northing (ft),Height (ft),t", "units: foot", {"units": "foot"}),
        ("X [mm],Y [mm],Z [mm],t", "units: millimetre", {"units": "millimetre"}),
        ("X [m],Y [m],Z [ft],t", "height_units: foot", {"height_units": "foot"}),
        ("X [m],Y [m],Z [m],GPS Time [ms]", "time_scale: 0.001", {"time_scale": 0.001}),
    ],
)
def test_other_units_in_names_need_an_option(tmp_path, names, option, more):
    path = tmp_path / "a.csv"
    table(path, names, np.arange(200))
    with pytest.raises(DataError, match=rf"a\.csv: column '[^']+' states another unit .*set {option}, or map"):
        get_format(path).info(path, ReadOptions(**NEW_SURVEY))
    options = ReadOptions(**more)
    cloud = get_format(path).read(path, options)
    np.testing.assert_allclose(cloud.world_xyz(), XYZ * options.factors, rtol=0, atol=6e-4)
    if "time_scale" in more:
        np.testing.assert_allclose(cloud["gps_time"], np.arange(200) / 1000)


def test_two_columns_with_units_for_one_coordinate(tmp_path):
    path = tmp_path / "a.csv"
    table(path, "Easting (m),Northing (m),Height (m),Easting (ft)", XYZ[:, 0] / 0.3048)
    with pytest.raises(DataError, match=r"'Easting \(m\)' and .*set columns"):
        notes(path)
    placed = ReadOptions(columns={"x": "Easting (m)"})
    np.testing.assert_allclose(get_format(path).read(path, placed).world_xyz(), XYZ, rtol=0, atol=6e-4)


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_times_as_dates(tmp_path, unit):
    times = np.datetime64("2024-05-01T10:00:00", unit) + np.arange(len(XYZ)) * np.timedelta64(1, "s").astype(
        f"m8[{unit}]"
    )
    if unit == "ns":
        times = times + np.timedelta64(1, "ns")
    pq.write_table(pa.table({**dict(zip("xyz", XYZ.T, strict=True)), "gps_time": times}), tmp_path / "a.parquet")
    np.savez(tmp_path / "a.npz", xyz=XYZ, gps_time=times)
    for name in ("a.parquet", "a.npz"):
        found = get_format(tmp_path / name).read(tmp_path / name, DEFAULT)["gps_time"]
        np.testing.assert_allclose(found, 1714557600.0 + np.arange(len(XYZ)), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "values", "seconds"),
    [
        (pa.duration("ms"), [1500, None], [1.5, np.nan]),
        (pa.date32(), [1, 2], [86400, 172800]),
        (pa.date64(), [86_400_000, None], [86400, np.nan]),
        (pa.time32("s"), [10, 11], [10, 11]),
        (pa.time64("us"), [10, 2_000_000], [1e-5, 2]),
    ],
    ids=str,
)
def test_durations_dates_and_times_of_day(tmp_path, kind, values, seconds):
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({**{axis: [1.0, 2.0] for axis in "xyz"}, "time": pa.array(values, kind)}), path)
    np.testing.assert_array_equal(get_format(path).read(path, DEFAULT)["time"], seconds)


def test_bytes_behind_few_points_are_told(tmp_path):
    path = tmp_path / "a.ply"
    ply(path, [*(f"property double {name}" for name in "xyz"), "property float q"], records_of()[:50])
    path.write_bytes(path.read_bytes() + struct.pack("<50I", *range(50)))
    assert notes(path) == ("its header states 50 points, 200 more bytes follow: they are not read",)
