"""Trajectories: stations and offsets against closed forms and a search over all segments."""

import numpy as np
import pytest
from references.inventory import nearest_on_polyline

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

UTM = np.array([583_000.0, 4_477_000.0, 120.0])


def bends(n=150):
    s = np.linspace(0, 6 * np.pi, n)
    return np.column_stack([8 * s, 30 * np.sin(s), 0.1 * s])


def test_station_and_offset_on_a_straight_road():
    path = Trajectory.from_positions([[0, 0, 0], [3, 0, 5], [10, 0, 0]])
    station, offset = path.locate([[2, -1.5, 7], [9, 4, -2], [3, 0, 0]])
    np.testing.assert_allclose(station, [2, 9, 3], atol=1e-12)
    np.testing.assert_allclose(offset, [1.5, -4, 0], atol=1e-12)
    assert path.length == 10.0


def test_points_beyond_the_ends_are_measured_along_the_extended_ends():
    path = Trajectory.from_positions([[0, 0, 0], [10, 0, 0], [10, 10, 0]])
    station, offset = path.locate([[-7, 2, 0], [-7, -2, 0], [12, 14, 0]])
    np.testing.assert_allclose(station, [-7, -7, 24], atol=1e-12)
    np.testing.assert_allclose(offset, [-2, 2, 2], atol=1e-12)
    distance = path.distance([[-7, 2, 0], [12, 14, 0], [4, -3, 9]])
    np.testing.assert_allclose(distance, [np.hypot(7, 2), np.hypot(2, 4), 3], atol=1e-12)


def test_outside_of_a_sharp_bend_has_the_distance_to_the_corner():
    path = Trajectory.from_positions([[0, 0, 0], [10, 0, 0], [1, 1, 0]])  # a turn to the left by 174 degrees
    station, offset = path.locate([[13, -4, 0], [13, 4, 0], [14, 0.5, 0]])
    np.testing.assert_allclose(station, 10)
    np.testing.assert_allclose(offset, [5, 5, np.hypot(4, 0.5)])


@pytest.mark.parametrize("shift", [np.zeros(3), UTM])
def test_equals_a_search_over_all_segments(rng, shift):
    vertices = bends()
    points = rng.uniform([-5, -45, -5], [160, 45, 5], (2000, 3))
    path = Trajectory.from_positions(vertices + shift)
    station, offset = path.locate(points, origin=shift)
    distance, expected = nearest_on_polyline(points[:, :2], vertices[:, :2])
    inside = (expected > 1e-6) & (expected < path.length - 1e-6)
    assert inside.sum() > 1500
    np.testing.assert_allclose(np.abs(offset[inside]), distance[inside], atol=1e-8)
    np.testing.assert_allclose(station[inside], expected[inside], atol=1e-6)


def test_order_of_points_does_not_matter(rng):
    path = Trajectory.from_positions(bends())
    points = rng.uniform([-5, -45, -5], [160, 45, 5], (500, 3))
    points[:50] = [24 * np.pi, 0, 0]  # as far from several segments: the first must win whatever came before
    station, offset = path.locate(points)
    order = rng.permutation(500)
    again, offset_again = path.locate(points[order])
    assert again.tobytes() == station[order].tobytes()
    assert offset_again.tobytes() == offset[order].tobytes()


def test_turning_the_world_changes_neither_station_nor_offset(rng):
    vertices, points = bends(), rng.uniform([0, -40, 0], [150, 40, 5], (300, 3))
    c, s = np.cos(1.1), np.sin(1.1)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    station, offset = Trajectory.from_positions(vertices).locate(points)
    turned, turned_offset = Trajectory.from_positions(vertices @ turn).locate(points @ turn)
    np.testing.assert_allclose(turned, station, atol=1e-8)
    np.testing.assert_allclose(turned_offset, offset, atol=1e-8)


def test_standing_still_and_disorder_are_cleaned(rng):
    time = np.array([3.0, 0.0, 1.0, 1.0, 2.0, 2.5])
    x = np.array(
        [9.0, 0.0, 4.0, 77.0, 4.004, 4.001]
    )  # the second position at 1 s is a repetition, 2 to 2.5 s is jitter
    path = Trajectory.from_positions(np.column_stack([x, np.zeros((6, 2))]), time)
    np.testing.assert_array_equal(path.time, [0, 1, 2, 2.5, 3])
    np.testing.assert_allclose(path.station, [0, 4, 4, 4, 9])
    np.testing.assert_array_equal(path.xyz[:, 0], [0, 4, 4.004, 4.001, 9])


def test_input_is_not_modified(rng):
    vertices, time = bends(), rng.permutation(150).astype(float)
    before = vertices.copy(), time.copy()
    Trajectory.from_positions(vertices, time).locate(vertices)
    np.testing.assert_array_equal(vertices, before[0])
    np.testing.assert_array_equal(time, before[1])


def test_float32_points_are_located_as_float64_ones(rng):
    path = Trajectory.from_positions(bends() + UTM)
    points = rng.uniform(0, 100, (100, 3)).astype(np.float32)
    np.testing.assert_array_equal(path.locate(points, origin=UTM), path.locate(points.astype(np.float64), origin=UTM))


def test_bad_positions_name_the_source():
    with pytest.raises(DataError, match=r"run\.csv: positions has 1 points with NaN"):
        Trajectory.from_positions([[0, 0, 0], [np.nan, 0, 0]], source="run.csv")
    with pytest.raises(DataError, match=r"run\.csv: time at row 1 is nan"):
        Trajectory.from_positions([[0, 0, 0], [1, 0, 0]], [0, np.nan], source="run.csv")
    with pytest.raises(DataError, match=r"run\.csv: time must have shape \(2,\)"):
        Trajectory.from_positions([[0, 0, 0], [1, 0, 0]], [0.0], source="run.csv")
    for positions in (np.zeros((0, 3)), np.zeros((1, 3)), np.ones((5, 3))):
        with pytest.raises(DataError, match=r"run\.csv: the \d positions are less than 0.01 m apart"):
            Trajectory.from_positions(positions, source="run.csv")
    with pytest.raises(DataError, match="NaN or infinite"):
        Trajectory.from_positions(bends()).locate([[0, 0, np.inf]])


def drive(n=200, seconds=0.1):
    """Return positions 1 m apart on a bent road, and their times."""
    s = np.arange(n, dtype=float)
    return np.column_stack([s, 20 * np.sin(s / 60), 0 * s]) + UTM, np.arange(n) * seconds + 4e5


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("row", [0, 1, 100, 198, 199])
@pytest.mark.parametrize("wrong", [[1e5, 0, 0], [1e300, -1e300, 0], [0, 5000, 0]])
def test_an_absurd_position_is_left_out_and_named(timed, row, wrong):
    xyz, time = drive()
    xyz[row] += wrong
    path = Trajectory.from_positions(xyz, time if timed else None, source="drive.csv")
    right = Trajectory.from_positions(*(np.delete(values, row, axis=0) for values in drive()))
    np.testing.assert_allclose(path.station, right.station)
    assert path.note.startswith(f"1 position that no vehicle can reach was left out of the trajectory: row {row} is at")


def test_a_row_of_absurd_positions_is_left_out_and_many_are_an_error():
    xyz, time = drive(1000)
    xyz[500:504, 0] += 7e4
    path = Trajectory.from_positions(xyz, time)
    assert len(path.xyz) == 996 and path.note.startswith("4 positions out of reach were left out")
    xyz[::5, 1] += 7e4
    with pytest.raises(DataError, match=r"drive\.csv: 20\d of 1000 positions cannot be reached from the others: row 0"):
        Trajectory.from_positions(xyz, time, source="drive.csv")


def test_gaps_that_a_vehicle_drove_and_passes_without_times_stay():
    xyz, time = drive()
    away = xyz + [3000, 0, 0]
    later = Trajectory.from_positions(np.concatenate([xyz, away]), np.concatenate([time, time + 120]))
    passes = Trajectory.from_positions(np.concatenate([xyz, away]))
    coarse = Trajectory.from_positions(xyz[::25], time[::25] / 3600)  # hours
    assert (len(later.xyz), len(passes.xyz), len(coarse.xyz)) == (400, 400, 8)
    assert later.note == passes.note == coarse.note == ""


@pytest.mark.parametrize("straight", [150.0, 1500.0])
def test_long_straights_of_a_line_without_times_stay(straight):
    xyz, _ = drive(60)
    ends = np.array([[straight, 0, 0], [2 * straight, 0, 0], [3 * straight, 5, 0]])
    path = Trajectory.from_positions(np.concatenate([xyz, xyz[-1] + ends]))
    assert len(path.xyz) == 63 and path.note == ""
    assert path.length > 3 * straight
