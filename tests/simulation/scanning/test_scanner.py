from dataclasses import replace

import numpy as np
import pytest
from references.simulator import scene_of

from mlsroad_pipeline.simulation import PRESETS
from mlsroad_pipeline.simulation.model.meshes import RETRO, Surface
from mlsroad_pipeline.simulation.model.solids import box
from mlsroad_pipeline.simulation.parameters.devices import Device
from mlsroad_pipeline.simulation.scanning.amplitudes import FULL_SCALE_DB, range_deviation
from mlsroad_pipeline.simulation.scanning.receiver import receive
from mlsroad_pipeline.simulation.scanning.scanner import Pulses, georeference, send_pulses
from mlsroad_pipeline.simulation.street.street import draw_street

WALL = Surface(21, (0.5, 0.5, 0.5), 0.5)


@pytest.fixture(scope="module")
def street():
    return draw_street(1, length=60.0)


def facing(street, distance, surface, *, size=40.0):
    """Return a scene with a wall straight ahead of the origin along x."""
    return scene_of(street, [box([1.0, size, size], [distance + 0.5, 0, 0], surface)], [1], [], np.zeros(3))


def pulses_along(directions):
    d = np.asarray(directions, dtype=np.float64)
    d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
    n = len(d)
    rays = np.concatenate([np.zeros((n, 3), np.float32), d], axis=1)
    return Pulses(np.zeros(n), np.zeros(n), d, rays)


def test_range_noise_on_a_plane_is_the_closed_form(street):
    parameters = replace(PRESETS["tiny"], range_noise=0.02, beam_divergence=1e-9)
    pulses = pulses_along(np.tile([1.0, 0, 0], (20000, 1)))
    returns, _ = receive(facing(street, 20.0, WALL), pulses, parameters, np.random.default_rng(1))
    error = returns.distance - 20.0
    amplitude = returns.intensity.mean() * FULL_SCALE_DB
    assert error.mean() == pytest.approx(0, abs=4 * 0.02 / np.sqrt(len(error)))
    assert error.std() == pytest.approx(range_deviation(0.02, amplitude, 0.0), rel=0.03)
    assert len(error) > 0.99 * 20000
    assert (returns.total == 1).all()


def test_no_noise_puts_points_on_the_plane(street):
    parameters = replace(PRESETS["tiny"], range_noise=0.0)
    angle = np.linspace(-0.6, 0.6, 2000)
    pulses = pulses_along(np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]))
    returns, _ = receive(facing(street, 12.0, WALL), pulses, parameters, np.random.default_rng(1))
    x = returns.distance * pulses.rays[returns.pulse, 3]
    np.testing.assert_allclose(x, 12.0, atol=1e-3)


def test_intensity_falls_with_range_angle_and_albedo(street):
    def mean(distance, surface, tilt=0.0):
        directions = np.tile([np.cos(tilt), np.sin(tilt), 0], (3000, 1))
        parameters = replace(PRESETS["tiny"], beam_divergence=1e-9)
        scene = facing(street, distance, surface, size=400.0)
        returns, _ = receive(scene, pulses_along(directions), parameters, np.random.default_rng(0))
        return float(returns.intensity.mean())

    dark, sign = Surface(21, (0.5, 0.5, 0.5), 0.1), Surface(42, (0.5, 0.5, 0.5), 0.5, RETRO)
    assert mean(10, WALL) > mean(25, WALL) > mean(60, WALL)
    assert mean(10, WALL) > mean(10, WALL, tilt=1.0)
    assert mean(10, WALL) - mean(10, dark) == pytest.approx(10 * np.log10(5) / FULL_SCALE_DB, abs=0.015)
    assert mean(20, sign) > mean(20, WALL) + 0.25


def test_weak_returns_drop_out(street):
    black = Surface(50, (0.02, 0.02, 0.02), 0.03)
    pulses = pulses_along(np.tile([np.cos(1.2), np.sin(1.2), 0], (2000, 1)))
    returns, _ = receive(facing(street, 25.0, black, size=400.0), pulses, PRESETS["tiny"], np.random.default_rng(0))
    assert len(returns.pulse) < 200


def edge_scene(street, gap):
    """Return a near half wall and a far whole one, `gap` apart."""
    near, far = box([0.1, 20, 40], [10.05, -10, 0], WALL), box([0.1, 80, 80], [10.05 + gap, 0, 0], WALL)
    return scene_of(street, [near, far], [1, 2], [], np.zeros(3))


def sweeps_over_the_edge():
    """Return 100 sweeps over the edge at angle 0, coarser than the beam is wide, each a little aside of the last."""
    aside = np.random.default_rng(8).uniform(-0.0025, 0.0025, (100, 1))
    angle = (np.linspace(-0.02, 0.02, 9) + aside).ravel()
    return pulses_along(np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]))


def test_edges_within_the_pulse_length_mix(street):
    parameters = replace(PRESETS["tiny"], range_noise=0.0, beam_divergence=0.004)
    returns, _ = receive(edge_scene(street, 0.4), sweeps_over_the_edge(), parameters, np.random.default_rng(3))
    between = (returns.distance > 10.02) & (returns.distance < 10.38)
    assert 5 < between.sum() < 60
    assert (returns.total == 1).all()


def test_edges_beyond_the_pulse_length_give_two_returns(street):
    parameters = replace(PRESETS["tiny"], range_noise=0.0, beam_divergence=0.004)
    scene = edge_scene(street, 2.0 + Device.pulse_length)
    returns, _ = receive(scene, sweeps_over_the_edge(), parameters, np.random.default_rng(3))
    assert not ((returns.distance > 10.05) & (returns.distance < 12.5)).any()
    double = returns.total == 2
    assert double.sum() >= 4
    first, last = returns.distance[double & (returns.number == 1)], returns.distance[double & (returns.number == 2)]
    assert (first < last).all()
    np.testing.assert_array_equal(returns.face[double & (returns.number == 1)] < 12, True)


def test_pulses_turn_at_the_profile_rate_and_miss_the_van(stream, parameters):
    centre = np.zeros(3)
    pulses = send_pulses(stream.drive, parameters.devices[0], first=0, last=2800, centre=centre)
    per_turn = parameters.pulse_rate / parameters.profile_rate
    step = np.diff(pulses.angle)
    assert np.median(step) == pytest.approx(2 * np.pi / per_turn, rel=1e-6)
    np.testing.assert_allclose(np.linalg.norm(pulses.rays[:, 3:], axis=1), 1, atol=1e-6)
    assert 0.6 * 2800 < len(pulses.time) < 2800
    # All beams of one scanner lie in one plane of the van's frame.
    assert np.linalg.svd(pulses.beam, compute_uv=False)[2] < 1e-3


def test_the_reported_trajectory_puts_points_off_by_centimetres(stream, scene, parameters):
    device = parameters.devices[1]
    pulses = send_pulses(stream.drive, device, scanner=1, first=0, last=4000, centre=scene.centre)
    exact = replace(parameters, range_noise=0.0, beam_divergence=1e-9)
    returns, _ = receive(scene, pulses, exact, np.random.default_rng(0))
    reported = georeference(pulses, returns.pulse, returns.distance, stream.drive, device)
    true = pulses.rays[returns.pulse, :3] + returns.distance[:, None] * pulses.rays[returns.pulse, 3:] + scene.centre
    error = np.linalg.norm(reported - true, axis=1)
    assert 0.001 < np.median(error) < 0.06
    blind = georeference(
        pulses, returns.pulse, returns.distance, replace(stream.drive, reported=stream.drive.true), device
    )
    np.testing.assert_allclose(blind, true, atol=1e-3)
