"""Estimated trajectories against simulated scanners with a known trajectory."""

import numpy as np
import pytest
from references.inventory import scanned_street

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.scenes.trajectory_estimation import estimate_trajectory

UTM = np.array([583_000.0, 4_477_000.0, 120.0])
WEEK = 312_345.0


def error(trajectory, time, centre):
    """Distance in metres between estimated and true centres."""
    true = np.column_stack([np.interp(trajectory.time, time, centre[:, axis]) for axis in range(3)])
    return np.linalg.norm(trajectory.xyz - true, axis=1)


@pytest.mark.parametrize(
    "mounting", [{"yaw": 0.0, "pitch": 0.0}, {"yaw": 45.0, "pitch": 20.0}, {"yaw": -45.0, "rate": 200.0}]
)
def test_centre_of_a_line_scanner(rng, mounting):
    xyz, time, centre = scanned_street(rng, pulses=48_000, seconds=2.0, **mounting)
    estimated = estimate_trajectory(xyz + UTM, time + WEEK)
    assert len(estimated.time) >= 6
    assert error(estimated, time + WEEK, centre + UTM).max() < 0.02


def test_two_scanners_give_the_mean_of_their_centres(rng):
    parts = [scanned_street(rng, seconds=2.0, yaw=yaw, lever=(0, side, 0)) for yaw, side in [(45, 0.5), (-45, -0.5)]]
    xyz, time = (np.concatenate([part[i] for part in parts]) for i in range(2))
    scanner = np.repeat([1, 2], [len(part[0]) for part in parts])
    order = rng.permutation(len(xyz))
    estimated = estimate_trajectory(xyz[order] + UTM, time[order], scanner=scanner[order])
    middle = parts[0][2]
    other = np.column_stack([np.interp(parts[0][1], parts[1][1], parts[1][2][:, axis]) for axis in range(3)])
    assert error(estimated, parts[0][1], (middle + other) / 2 + UTM).max() < 0.03


def test_a_known_rate_needs_no_search_and_a_thinned_survey_is_fine(rng):
    xyz, time, centre = scanned_street(rng, seconds=2.0)
    keep = rng.random(len(xyz)) < 0.3
    estimated = estimate_trajectory(xyz[keep], time[keep], rotation_rate=75.2)
    assert error(estimated, time, centre).max() < 0.05


def test_same_points_same_bytes_and_input_kept(rng):
    xyz, time, _ = scanned_street(rng, seconds=1.0)
    before = xyz.copy(), time.copy()
    one = estimate_trajectory(xyz, time)
    assert one.xyz.tobytes() == estimate_trajectory(xyz, time).xyz.tobytes()
    np.testing.assert_array_equal(xyz, before[0])
    np.testing.assert_array_equal(time, before[1])


def test_two_scanners_without_a_column_are_refused(rng):
    parts = [scanned_street(rng, seconds=1.0, yaw=yaw) for yaw in (45, -45)]
    xyz, time = (np.concatenate([part[i] for part in parts]) for i in range(2))
    with pytest.raises(DataError, match=r"run\.laz: no trajectory from scanner 0: .*several scanners"):
        estimate_trajectory(xyz, time, source="run.laz")


def test_flat_ground_alone_is_refused(rng):
    xyz, time, _ = scanned_street(rng, seconds=1.0, walls=False)
    with pytest.raises(DataError, match="do not determine one scan plane: flat ground alone"):
        estimate_trajectory(xyz, time)


def test_times_per_turn_are_refused(rng):
    xyz, time, _ = scanned_street(rng, seconds=1.0)
    with pytest.raises(DataError, match=r"points share \d+ times: times per pulse are needed"):
        estimate_trajectory(xyz, np.floor(time * 75) / 75)


def test_points_in_no_order_of_time_are_refused(rng):
    xyz, time, _ = scanned_street(rng, seconds=1.0)
    with pytest.raises(DataError, match="no trajectory from scanner 0"):
        estimate_trajectory(xyz, rng.permutation(time))


def test_bad_input_is_named(rng):
    xyz, time, _ = scanned_street(rng, seconds=0.02)
    with pytest.raises(DataError, match=r"a\.las: no trajectory from 0 points"):
        estimate_trajectory(np.zeros((0, 3)), [], source="a.las")
    with pytest.raises(DataError, match=r"a\.las: no trajectory from \d+ points, 1 without time"):
        estimate_trajectory(xyz, np.append(time[1:], np.nan), source="a.las")
    with pytest.raises(DataError, match=r"a\.las: .*no half second has 200 points"):
        estimate_trajectory(xyz[:100], time[:100], source="a.las")
    with pytest.raises(DataError, match=r"a\.las: gps_time must have shape"):
        estimate_trajectory(xyz, time[1:], source="a.las")
    with pytest.raises(ParameterError, match="interval must be"):
        estimate_trajectory(xyz, time, interval=0)
    with pytest.raises(ParameterError, match="rotation_rate must be"):
        estimate_trajectory(xyz, time, rotation_rate=-1.0)
