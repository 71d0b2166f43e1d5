"""Trajectory files: separators, names, positions, and errors."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.surveys.trajectory_files import read_trajectory

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


def test_named_columns_replace_what_the_file_says(tmp_path):
    path = tmp_path / "run.txt"
    path.write_text("a b c d\n583000.5 4477000.25 7 120\n583010.5 4477000.25 7 121\n583010.5 4477020.25 7 122\n")
    trajectory = read_trajectory(path, columns=["x", "y", "roll", "z"])
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
        ("lat,lon,z\n1,2,3\n", "a trajectory needs the column x .has lat, lon, z."),
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
