import numpy as np
import pytest

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.cameras.poses import PoseTrack
from mlsroad_pipeline.algorithms.cameras.projection import project_points
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.simulation.model.meshes import rotation_matrix


def track(**options):
    time = np.array([10.0, 10.5, 11.0])
    xyz = np.array([[500_000.0, 5_800_000, 40], [500_005.0, 5_800_000, 40], [500_010.0, 5_800_001, 41]])
    return PoseTrack.from_angles(time, xyz, [[0, 0, 3.0], [0, 0, -3.0], [0.1, 0.2, -2.8]], **options)


def test_axes_are_those_of_the_simulated_drive():
    rotation, _ = track().at([11.0])
    np.testing.assert_allclose(rotation[0], rotation_matrix(-2.8, 0.2, 0.1), atol=1e-12)


def test_headings_turn_the_short_way_round_and_places_move_straight():
    rotation, xyz = track().at([10.25])
    np.testing.assert_allclose(rotation[0], rotation_matrix(np.pi, 0, 0), atol=1e-12)
    np.testing.assert_allclose(xyz[0], [500_002.5, 5_800_000, 40])


def test_a_turn_between_two_poses_has_a_constant_rate():
    """Slerp: after a fraction f of the time, the angle turned is f of the whole, about one axis."""
    turns = track()
    whole = (turns.rotation[1].inv() * turns.rotation[2]).as_rotvec()
    for fraction in (0.2, 0.7):
        rotation, _ = turns.at([10.5 + 0.5 * fraction])
        step = turns.rotation[1].as_matrix().T @ rotation[0]
        angle = np.arccos((np.trace(step) - 1) / 2)
        assert angle == pytest.approx(fraction * np.linalg.norm(whole), rel=1e-9)
        np.testing.assert_allclose(step @ whole, whole, atol=1e-12)  # the axis stays where it is


def test_quaternions_and_angles_say_the_same_in_any_order_of_rows():
    turns = track()
    quaternions = turns.rotation.as_quat(scalar_first=True) * 3.0
    order = [2, 0, 1]
    other = PoseTrack.from_quaternions(turns.time[order], turns.xyz[order], quaternions[order])
    for one, two in zip(turns.at([10.3, 10.9]), other.at([10.3, 10.9]), strict=True):
        np.testing.assert_allclose(one, two, atol=1e-9)


def test_a_camera_is_carried_by_its_vehicle():
    mount = Camera([[300, 0, 320], [0, 300, 240], [0, 0, 1]], None, [[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0.1, 2.0, -0.5], 640, 480)  # fmt: skip
    rotation, place = (part[0] for part in track().at([11.0]))
    on_vehicle = np.array([[8.0, 1.0, 0.5], [12.0, -2.0, 1.0]])
    expected = project_points(on_vehicle, mount)
    found = project_points(on_vehicle @ rotation.T + place, mount.carried(rotation, place))
    np.testing.assert_allclose(found[0], expected[0], atol=1e-5)
    np.testing.assert_allclose(found[1], expected[1], atol=1e-7)


@pytest.mark.parametrize("time", [9.99, 11.01, np.nan])
def test_times_that_the_poses_do_not_cover_are_named(time):
    with pytest.raises(DataError, match=r"poses: 1 of 2 times lie outside the poses, which cover 10.000 to 11.000 s"):
        track().at([10.5, time])


def test_a_gap_in_the_poses_is_not_bridged():
    with pytest.raises(
        DataError, match=r"no poses between 10.000 and 10.500 s, a gap longer than 0.4 s, in which 1 of 2"
    ):
        track(max_gap=0.4).at([10.5, 10.2])
    track(max_gap=0.4).at([10.0, 10.5])


def test_poses_that_are_none_are_named():
    with pytest.raises(DataError, match="needs poses at two times at least, got 1"):
        PoseTrack.from_angles([1.0, 1.0], np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.raises(DataError, match=r"quaternion at row 1 is \[0.0, 0.0, 0.0, 0.0\]"):
        PoseTrack.from_quaternions([1.0, 2.0], np.zeros((2, 3)), [[1, 0, 0, 0], [0, 0, 0, 0]])
    with pytest.raises(DataError, match="2 positions but 3 rotations"):
        PoseTrack.from_angles([1.0, 2.0], np.zeros((2, 3)), np.zeros((3, 3)))
    with pytest.raises(DataError, match="time at row 1 is nan"):
        PoseTrack.from_angles([1.0, np.nan], np.zeros((2, 3)), np.zeros((2, 3)))
