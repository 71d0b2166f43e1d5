from dataclasses import replace

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.simulation import PRESETS
from mlsroad_pipeline.simulation.model.meshes import rotation_matrix
from mlsroad_pipeline.simulation.parameters.devices import Device
from mlsroad_pipeline.simulation.parameters.known_scanners import SCANNERS, scanner_system
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters
from mlsroad_pipeline.simulation.scanning.scanner import draw_calibration, georeference, send_pulses
from mlsroad_pipeline.simulation.street.drive import Drive


def standing(system):
    """Return the drive of a vehicle at rest at the origin for five seconds, x to the east."""
    poses = np.zeros((1001, 6))
    body = np.array([[0.0, 0.0], [0.0, 0.0], [-9.0, -9.0]])
    return Drive(np.arange(1001) / 200, np.linspace(0, 1, 1001), poses, poses, 0.0, body)


def pulses_of(name, count, device=0):
    system = SCANNERS[name]
    return send_pulses(standing(system), system.devices[device], first=0, last=count, centre=np.zeros(3))


def test_the_vmx450_scans_crosswise_at_its_rates():
    left, right = SCANNERS["vmx450"].devices
    assert (left.pulse_rate, left.profile_rate) == (550_000, 200)
    assert (left.range_noise, left.accuracy, left.divergence) == (0.005, 0.008, 0.0003)
    axes = [device.mounting[:, 0] for device in (left, right)]
    np.testing.assert_allclose([np.degrees(np.arctan2(a[1], a[0])) for a in axes], [45, -45])
    pulses = pulses_of("vmx450", 2750)
    assert np.degrees(np.median(np.diff(pulses.angle))) == pytest.approx(360 * 200 / 550_000)
    # Profiles are planes across the axis.
    np.testing.assert_allclose(pulses.beam @ axes[0], 0, atol=1e-6)


def test_the_64_beams_lie_on_their_cones_all_around():
    device = SCANNERS["hdl64"].devices[0]
    pulses = pulses_of("hdl64", int(1.333e6 / 10))
    assert len(pulses.time) == int(1.333e6 / 10)
    elevation = np.degrees(np.arcsin(pulses.beam[:, 2])).reshape(-1)
    beam = np.arange(len(elevation)) % 64
    for k in (0, 31, 32, 63):
        np.testing.assert_allclose(elevation[beam == k], device.elevations[k], atol=1e-4)
    assert (device.elevations[0], device.elevations[-1]) == (2.0, -24.8)
    np.testing.assert_allclose(-np.diff(device.elevations[:32]), 1 / 3, atol=1e-3)
    np.testing.assert_allclose(-np.diff(device.elevations[32:]), 0.515, atol=1e-3)
    azimuth = np.degrees(np.arctan2(pulses.beam[beam == 5, 1], pulses.beam[beam == 5, 0]))
    turn = np.diff(np.unwrap(azimuth, period=360))
    np.testing.assert_allclose(turn, 360 * 10 * 64 / 1.333e6, atol=1e-3)
    assert abs(turn.sum()) == pytest.approx(360, abs=0.5)
    # Angle 0 is straight ahead.
    ahead = pulses.beam[np.argmin(np.abs(pulses.angle))]
    assert ahead[0] > 0.9 and abs(ahead[1]) < 1e-3


@pytest.mark.parametrize(
    ("name", "beams", "highest", "lowest", "columns", "height"),
    [
        ("hdl32", 32, 10.67, -30.67, 1086, 1.84), ("vlp32", 32, 15.0, -25.0, 1875, 1.9), ("vlp32_front", 32, 15.0, -25.0, 1875, 1.68),
        ("vlp16", 16, 15.0, -15.0, 1875, 1.9), ("pandar64", 64, 14.882, -24.897, 1800, 1.73),
        ("hesai_xt32", 32, 15.0, -16.0, 2000, 1.9), ("os1_64", 64, 22.5, -22.5, 1024, 1.8),
        ("os1_128", 128, 22.5, -22.5, 1024, 1.8),
    ],
)  # fmt: skip
def test_rotating_heads_have_the_beams_and_columns_of_their_data_sheets(name, beams, highest, lowest, columns, height):
    system = SCANNERS[name]
    device = system.devices[0]
    assert len(set(device.elevations)) == len(device.elevations) == beams
    assert (max(device.elevations), min(device.elevations)) == (highest, pytest.approx(lowest))
    assert 2 * np.pi / device.step == pytest.approx(columns, abs=1)
    assert system.platform + device.lever[2] == pytest.approx(height)


def test_side_looking_scanners_cover_their_own_side_alone():
    for number, sign in ((0, 1.0), (1, -1.0)):
        pulses = pulses_of("sick_side", 3600, device=number)
        assert 0.45 < len(pulses.time) / 3600 < 0.55
        assert (sign * pulses.beam[:, 1] > -1e-6).all()
        np.testing.assert_allclose(pulses.beam[:, 0], 0, atol=1e-6)
        assert {-1, 1} == set(np.sign(pulses.beam[np.abs(pulses.beam[:, 2]) > 0.9, 2]))


def test_the_scanner_of_oakland_covers_the_left_from_near_the_nadir_up():
    pulses = pulses_of("oakland", 720)
    assert len(pulses.time) == pytest.approx(720 * 168 / 360, abs=2)
    assert (pulses.beam[:, 1] > -1e-6).all()
    from_nadir = np.degrees(np.arccos(-pulses.beam[:, 2]))
    assert from_nadir.min() == pytest.approx(12.0, abs=0.51) and from_nadir.max() > 179.0


def test_boresight_and_bias_move_points_as_they_should():
    device = replace(SCANNERS["vmx450"].devices[0], lever=(0.1, 0.2, 0.3))
    drive = standing(SCANNERS["vmx450"])
    pulses = send_pulses(drive, device, first=0, last=500, centre=np.zeros(3))
    rows, distance = np.arange(len(pulses.time)), np.full(len(pulses.time), 30.0)
    wrong = draw_calibration(replace(PRESETS["vmx450"], boresight_error=0.05), scanner=0)
    angle = np.arccos((np.trace(wrong.turn) - 1) / 2)
    assert 0 < angle < np.radians(0.4)
    exact = georeference(pulses, rows, distance, drive, device)
    np.testing.assert_allclose(exact, pulses.rays[:, :3] + 30.0 * pulses.rays[:, 3:], atol=1e-5)
    off = georeference(pulses, rows, distance, drive, device, calibration=wrong)
    expected = [0.1, 0.2, 0.3] + wrong.shift + (30.0 + wrong.bias) * pulses.beam @ wrong.turn.T
    np.testing.assert_allclose(off, expected, atol=1e-5)
    none = draw_calibration(replace(PRESETS["vmx450"], boresight_error=0.0), scanner=0)
    np.testing.assert_array_equal(none.turn, np.eye(3))
    assert not none.shift.any() and none.bias == wrong.bias != 0


def test_mounting_turns_as_the_angles_say():
    device = Device(1e5, 10.0, yaw=30.0, pitch=-20.0, roll=5.0)
    np.testing.assert_allclose(device.mounting, rotation_matrix(*np.radians([30.0, -20.0, 5.0])))
    assert device.step == pytest.approx(2 * np.pi * 10 / 1e5)


def test_a_custom_scanner_is_read_from_configuration():
    assert scanner_system("hdl64") is SCANNERS["hdl64"]
    slower = scanner_system({"like": "vmx450", "name": "slow", "pulse_rate": 300e3, "platform": 3.0})
    assert [device.pulse_rate for device in slower.devices] == [300e3, 300e3] and slower.platform == 3.0
    assert slower.devices[1].yaw == -45.0
    own = scanner_system({"devices": [{"pulse_rate": 2e5, "profile_rate": 20, "elevations": [-1, 0, 1]}]})
    assert own.name == "own" and own.devices[0].elevations == (-1.0, 0.0, 1.0)
    parameters = simulation_parameters({"preset": "tiny", "scanner": "hdl64", "max_range": 60.0})
    assert parameters.pulse_rate is None and parameters.devices[0].pulse_rate == 1.333e6
    assert parameters.devices[0].max_range == 60.0
    assert simulation_parameters({"preset": "tiny", "scanner": "vmx450"}) == PRESETS["tiny"]


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ("vmx", "scanner 'vmx' is unknown .scanners: vmx450, vmq1ha, mx9, sick_side"),
        ({"like": "hdl64", "pulse": 3}, "unknown fields of a scanner: pulse"),
        ({"name": "x"}, "scanner must have devices, or be like one of"),
        ({"devices": [{"profile_rate": 10}]}, "a scanner's device must have pulse_rate"),
        ({"like": "hdl64", "devices": [], "max_range": 3.0}, "max_range must stand in each of its devices"),
        ({"like": "hdl64", "devices": []}, "must have 1 to 8 devices, got 0"),
        ({"like": "hdl64", "field": [10, -10]}, "field must be two rising angles"),
        ({"like": "hdl64", "elevations": [95.0]}, "elevations must be within 90 degrees"),
        ({"like": "hdl64", "lever": [1.0]}, "lever must be 3 finite numbers"),
        ({"like": "hdl64", "lever": "up"}, "lever must be numbers, got 'up'"),
        ({"like": "hdl64", "max_returns": 9}, "max_returns must be between 1 and 8, got 9"),
        ({"like": "hdl64", "min_range": 50.0, "max_range": 40.0}, "min_range must be below max_range 40.0"),
        ({"like": "hdl64", "pulse_rate": 5000.0}, "pulse_rate must be at least 16 pulses per profile"),
        ({"like": "hdl64", "yaw": float("nan")}, "yaw must be finite"),
        ({"like": "hdl64", "accuracy": -1.0}, "accuracy must be between 0 and 100"),
        ({"like": "hdl64", "accuracy": "fine"}, "accuracy must be between 0 and 100, got 'fine'"),
        ({"like": "hdl64", "yaw": "left"}, "yaw must be finite, got 'left'"),
        ({"like": "hdl64", "divergence": 0.0}, "divergence must be a finite number > 0"),
    ],
)
def test_bad_scanners_are_named(config, message):
    with pytest.raises(ParameterError, match=message):
        scanner_system(config)
