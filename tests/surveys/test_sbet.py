"""SBET trajectories: positions against pyproj, GPS weeks, recognition by content."""

import numpy as np
import pyproj
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
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
