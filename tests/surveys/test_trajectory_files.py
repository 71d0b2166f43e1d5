"""Trajectory files: separators, names, positions, errors; SBET against pyproj, GPS weeks, recognition."""

import numpy as np
import pyproj
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.inventory.road.table import ROAD_FIELDS
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.formats.crs import parse_crs
from mlsroad_pipeline.surveys.reading import find_corridor
from mlsroad_pipeline.surveys.trajectory_files import (
    coverage_note,
    distance_note,
    in_weeks_of,
    is_sbet,
    read_trajectory,
)

XYZ = [[583000.5, 4477000.25, 120.0], [583010.5, 4477000.25, 121.0], [583010.5, 4477020.25, 122.0]]


@pytest.mark.parametrize(
    "text",
    [
        "time,x,y,z\n1,583000.5,4477000.25,120\n2,583010.5,4477000.25,121\n3,583010.5,4477020.25,122\n",
        "GPS_Time[s];Northing[m];Easting (m);Altitude_m;Roll\n"
        "1;4477000.25;583000.5;120;0\n2;4477000.25;583010.5;121;0\n3;4477020.25;583010.5;122;9\n",
        "# made by hand\n1 583000.5 4477000.25 120 0 0 0\n\n3\t583010.5\t4477020.25\t122\t0\n"
        "2 583010.5 4477000.25 121 0\n",
        "\ufefftime,x,y,z\r\n1,583000.5,4477000.25,120\r\n2,583010.5,4477000.25,121\r\n3,583010.5,4477020.25,122\r\n",
    ],
)
def test_separators_names_and_order(tmp_path, text):
    path = tmp_path / "run.csv"
    path.write_text(text, encoding="utf-8")
    trajectory = read_trajectory(path)
    np.testing.assert_array_equal(trajectory.xyz, XYZ)
    np.testing.assert_array_equal(trajectory.time, [1, 2, 3])
    np.testing.assert_allclose(trajectory.station, [0, 10, 30])
    assert trajectory.source == str(path)


def test_a_trajectory_may_have_no_times(tmp_path):
    path = tmp_path / "run.txt"
    path.write_text("x y roll z\n583000.5 4477000.25 7 120\n583010.5 4477000.25 7 121\n583010.5 4477020.25 7 122\n")
    trajectory = read_trajectory(path)
    np.testing.assert_array_equal(trajectory.xyz, XYZ)
    assert trajectory.time is None


def test_times_keep_a_tenth_of_a_microsecond(tmp_path):
    path = tmp_path / "run.csv"
    times = ["315964800.1234567", "315964801.0", "315964802.0"]
    rows = [",".join([time, *map(str, xyz)]) for time, xyz in zip(times, XYZ, strict=True)]
    path.write_text("\n".join(["time,x,y,z", *rows]), encoding="utf-8")
    back = read_trajectory(path)
    np.testing.assert_array_equal(back.xyz, XYZ)
    np.testing.assert_allclose(back.time, [315964800.1234567, 315964801.0, 315964802.0], rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no positions in the file"),
        ("# nothing\n", "no positions in the file"),
        ("time,x,y,z\n", "no positions in the file"),
        ("lat,lon,z\n1,2,3\n", "a trajectory needs the column x .its first line: lat, lon, z."),
        ("object_id,kind,x,y,z\n1,pole,2,3,4\n", r"a table of results \(column object_id\), not a trajectory"),
        (f"{','.join(ROAD_FIELDS)}\n0.5,1,2,3\n", r"a table of results \(column clearance, crossfall, station\)"),
        ("time,x,y,z\n1,2,3,4\n1,2,three,4\n", "line 3: y is 'three', not a number"),
        ("1 2 3 4\n2 3 4\n", "line 2 has 3 values, 4 are needed"),
    ],
)
def test_unreadable_files_say_where(tmp_path, text, message):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(ReadError, match=rf"bad\.csv: .*{message}"):
        read_trajectory(path)


def test_unusable_values_and_missing_files(tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text("1 0 0 0\nnan 1 0 0\n")
    with pytest.raises(DataError, match=r"bad\.csv: time at row 1 is nan"):
        read_trajectory(path)
    path.write_text("1 5 5 0\n2 5 5 0\n")
    with pytest.raises(DataError, match=r"bad\.csv: the 2 positions are less than"):
        read_trajectory(path)
    with pytest.raises(ReadError, match=r"none\.csv: no such trajectory file"):
        read_trajectory(tmp_path / "none.csv")


@pytest.mark.parametrize("separator", [";", "\t"])
def test_decimal_commas_of_spreadsheets(tmp_path, separator):
    rows = [
        ["gps_time", "x", "y", "z"],
        ["216000,5", "389301,93", "-5,25", "36"],
        ["216001", "389311,93", "-5,25", "1,5e1"],
    ]
    path = tmp_path / "trajectory.csv"
    path.write_text("\n".join(separator.join(row) for row in rows))
    found = read_trajectory(path)
    assert found.xyz.tolist() == [[389301.93, -5.25, 36.0], [389311.93, -5.25, 15.0]]
    assert found.time is not None and found.time.tolist() == [216000.5, 216001.0]


UTM32 = parse_crs("EPSG:32632")


def write_sbet(path, n=200):
    records = np.zeros((n, 17))
    records[:, 0] = 300_000 + np.arange(n) * 0.1
    records[:, 1], records[:, 2] = np.radians(49 + np.arange(n) * 1e-6), np.radians(9 + np.arange(n) * 2e-6)
    records[:, 3] = 150 + np.sin(np.arange(n))
    records[:, 4:] = np.random.default_rng(1).normal(size=(n, 13))
    records.astype("<f8").tofile(path)
    return records


def test_positions_in_the_system_of_the_survey(tmp_path):
    path = tmp_path / "sbet.out"
    records = write_sbet(path)
    assert is_sbet(path)
    trajectory = read_trajectory(path, crs=UTM32)
    degrees = np.degrees(records[:, 2]), np.degrees(records[:, 1])
    expected = pyproj.Transformer.from_crs(4326, 32632, always_xy=True).transform(*degrees)
    np.testing.assert_allclose(trajectory.xyz[:, :2], np.transpose(expected), rtol=0, atol=1e-6)
    np.testing.assert_allclose(trajectory.xyz[:, 2], records[:, 3])
    np.testing.assert_array_equal(trajectory.time, records[:, 0])
    with pytest.raises(ReadError, match=r"sbet\.out has longitudes and latitudes, .* set read\.crs"):
        read_trajectory(path)
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(ReadError, match=r"sbet\.out is truncated: 27195 bytes is not a multiple of the 136"):
        read_trajectory(path, crs=UTM32)


def test_text_is_no_sbet(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time,x,y,z\n" + "".join(f"{i},{583_000.5 + i},4477000.25,120\n" for i in range(500)))
    assert not is_sbet(path)
    path.write_text("x")
    assert not is_sbet(path)


def test_weeks_and_coverage(tmp_path):
    write_sbet(tmp_path / "sbet.out")
    trajectory = read_trajectory(tmp_path / "sbet.out", crs=UTM32)
    week = 2200 * 604_800 - 1e9
    moved = in_weeks_of(trajectory, week + 300_005, week + 300_010)
    np.testing.assert_allclose(moved.time - trajectory.time, week)
    assert coverage_note(moved, week + 300_005, week + 300_010) == ""
    assert "covers 300000.000 to 300019.900 s" in coverage_note(trajectory, 299_990, 300_010)
    assert in_weeks_of(trajectory, 300_001, 300_002) is trajectory
    assert in_weeks_of(trajectory, week + 400_000, week + 400_010) is trajectory  # another day of that week
    assert coverage_note(trajectory, np.nan, np.nan) == ""
    cloud = PointCloud(trajectory.xyz[:3], {"gps_time": np.array([1.0, 2, 3])}, crs=UTM32)
    corridor = find_corridor([cloud], [], trajectory=str(tmp_path / "sbet.out"), along=True)
    assert "the points have 1.000 to 3.000 s" in str(corridor["note"])


def test_a_trajectory_far_from_the_points_is_noted():
    path = Trajectory.from_positions([[0.0, 0, 0], [1000, 0, 0]], source="drive/path.csv")
    assert distance_note(path, [400, 20, 0], [500, 90, 5]) == ""
    assert distance_note(path, [-50, 90, 0], [-20, 99, 5]) == ""  # before the start
    assert distance_note(path, [500, 350, -40], [600, 360, 5]).startswith(
        "the trajectory path.csv is 350 m from the points"
    )
    assert distance_note(path, [np.nan] * 3, [np.nan] * 3) == ""


@pytest.mark.parametrize("line", ["# x y z time", "#x, y, z, gps_time [s]", "% easting;northing;height;t"])
def test_names_in_a_comment_order_the_columns(tmp_path, line):
    path = tmp_path / "run.txt"
    mark = ";" if ";" in line else "," if "," in line else " "
    rows = [mark.join(str(value) for value in (*xyz, time)) for time, xyz in enumerate(XYZ, start=1)]
    path.write_text("\n".join(["# exported", line, *rows]), encoding="utf-8")
    trajectory = read_trajectory(path)
    np.testing.assert_array_equal(trajectory.xyz, XYZ)
    np.testing.assert_array_equal(trajectory.time, [1, 2, 3])


def test_rows_go_on_after_the_end_of_a_week(tmp_path):
    path = tmp_path / "run.csv"
    times = (604_798.0, 604_799.5, 1.0)
    path.write_text(
        "\n".join(",".join(map(str, (t, *xyz))) for t, xyz in zip(times, XYZ, strict=True)), encoding="utf-8"
    )
    trajectory = read_trajectory(path)
    np.testing.assert_array_equal(trajectory.xyz, XYZ)
    np.testing.assert_array_equal(trajectory.time, [604_798.0, 604_799.5, 604_801.0])


@pytest.mark.parametrize(("lead", "clock"), [(18.0, "UTC and theirs GPS"), (-18.0, "GPS and theirs UTC")])
def test_leap_seconds_between_clocks_are_named(lead, clock):
    path = Trajectory.from_positions(np.arange(120.0)[:, None] * [1, 0, 0], np.arange(120.0))
    assert clock in coverage_note(path, lead + 0.5, lead + 118.5)
    assert "18 s" in coverage_note(path, lead + 0.5, lead + 118.5)
    assert "clock" not in coverage_note(path, 60.0, 300.0) and "UTC" not in coverage_note(path, 60.0, 300.0)


def test_one_system_in_two_spellings_is_one_and_a_missing_one_is_named():
    wkt = [pyproj.CRS.from_epsg(25832).to_wkt(version) for version in ("WKT1_GDAL", "WKT2_2019")]
    rng = np.random.default_rng(1)
    samples = [PointCloud(rng.random((50, 3)) * [60, 8, 3], crs=text, source=f"{k}.laz") for k, text in enumerate(wkt)]
    assert "kind" in find_corridor(samples, [], trajectory=None, along=False) or len(samples) == 2
    bare = PointCloud(samples[0].xyz, source="bare.laz")
    with pytest.raises(DataError, match=r"0\.laz and bare\.laz .* \(ETRS89.*none\); set read\.crs \(label\.crs\)"):
        find_corridor([samples[0], bare], [], trajectory=None, along=False)


def test_points_over_the_end_of_a_week_have_a_covering_trajectory(tmp_path):
    path = tmp_path / "trajectory.csv"
    rows = [f"{t % 604800:.1f},{t - 604780:.1f},0,0" for t in np.arange(604_780.0, 604_821.0)]
    path.write_text("time,x,y,z\n" + "\n".join(rows), encoding="utf-8")
    time = np.concatenate([np.linspace(604_785, 604_799, 100), np.linspace(0, 15, 100)])
    cloud = PointCloud(np.column_stack([np.linspace(5, 35, 200), np.zeros(200), np.zeros(200)]), {"gps_time": time})
    corridor = find_corridor([cloud], [], trajectory=str(path), along=True)
    assert "note" not in corridor
