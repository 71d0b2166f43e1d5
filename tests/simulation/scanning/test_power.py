from dataclasses import replace

import numpy as np
import pytest
from references.simulator import scene_of

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.simulation import PRESETS
from mlsroad_pipeline.simulation.model.meshes import RETRO, Surface
from mlsroad_pipeline.simulation.model.solids import box
from mlsroad_pipeline.simulation.parameters.devices import Device, ScannerSystem
from mlsroad_pipeline.simulation.parameters.known_scanners import SCANNERS, scanner_system
from mlsroad_pipeline.simulation.scanning.amplitudes import FULL_SCALE_DB, lowered_power, power_of
from mlsroad_pipeline.simulation.scanning.receiver import receive
from mlsroad_pipeline.simulation.scanning.scanner import Pulses
from mlsroad_pipeline.simulation.street.ground import GRASS
from mlsroad_pipeline.simulation.street.ground_mesh import ground_mesh
from mlsroad_pipeline.simulation.street.street import draw_street

WALL = Surface(21, (0.5, 0.5, 0.5), 0.5)
CONTROLLED = {"power_control": 26.0, "power_target": 13.0, "power_memory": 50, "intensity_scale": (5.0, 35.0)}


@pytest.fixture(scope="module")
def street():
    return draw_street(1, length=60.0)


def swept(street, meshes, *, n=1500, half=0.2, seed=1, **fields):
    """Return the points of a scanner of one beam that sweeps over meshes ahead of it."""
    device = Device(1e5, 10.0, **{"range_noise": 0.0, "accuracy": 0.0, "max_range": 300.0, **fields})
    none = dict.fromkeys(("profile_rate", "pulse_rate", "range_noise", "beam_divergence", "max_range"))
    parameters = replace(PRESETS["tiny"], scanner=ScannerSystem("one", (device,)), beam_rays=1, **none)
    angle = np.linspace(-half, half, n)
    d = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]).astype(np.float32)
    pulses = Pulses(np.arange(n) / device.pulse_rate, angle, d, np.concatenate([0 * d, d], axis=1))
    scene = scene_of(street, meshes, range(1, len(meshes) + 1), [], np.zeros(3))
    return receive(scene, pulses, parameters, np.random.default_rng(seed))[0]


def wall_at(distance, reflectivity=0.5):
    return box([1.0, 4 * distance, 40], [distance + 0.5, 0, 0], Surface(21, (0.5, 0.5, 0.5), reflectivity))


def test_power_follows_a_step_as_an_exponential_average():
    memory, before, after = 40, 30.0, 18.0
    amplitude = np.concatenate([np.full(200, before), np.full(300, after)]).astype(np.float32)
    lowered = lowered_power(amplitude, np.zeros(500, np.int64), 1, 25.0, 10.0, memory)
    np.testing.assert_allclose(lowered[:200], before - 10.0, atol=1e-4)
    count = np.arange(300)
    expected = after + (before - after) * (1 - 1 / memory) ** count - 10.0
    np.testing.assert_allclose(lowered[200:], expected, atol=1e-4)


def test_power_stays_within_its_limits_and_each_beam_has_its_own(rng):
    beam = np.arange(6000) % 3
    amplitude = np.choose(beam, [5.0, 20.0, 60.0]) + rng.normal(0, 0.1, 6000)
    lowered = lowered_power(amplitude.astype(np.float32), beam, 3, 24.0, 13.0, 100)
    assert (lowered[beam == 0] == 0).all()
    np.testing.assert_allclose(lowered[beam == 1], 7.0, atol=0.3)
    assert (lowered[beam == 2] == 24.0).all()


def test_pulses_without_return_do_not_change_the_power():
    amplitude = np.array([-99, 25, -99, -99, 25, 25], np.float32)
    lowered = lowered_power(amplitude, np.zeros(6, np.int64), 1, 20.0, 13.0, 10)
    np.testing.assert_allclose(lowered, [0, 12, 12, 12, 12, 12], atol=1e-5)


def test_intensity_of_a_wall_is_the_target_until_the_power_is_at_its_maximum(street):
    near = [swept(street, [wall_at(d)], **CONTROLLED).intensity for d in (10.0, 20.0, 60.0)]
    for intensity in near:
        # The tone of the wall differs from place to place; the mean is held at the target.
        assert intensity.mean() == pytest.approx((13.0 - 5.0) / 30.0, abs=0.03)
    far = swept(street, [wall_at(200.0)], **CONTROLLED).intensity
    fixed = swept(street, [wall_at(200.0)], **{**CONTROLLED, "power_control": 0.0}).intensity
    np.testing.assert_array_equal(far, fixed)
    assert far.mean() < near[0].mean() - 0.05


def test_materials_keep_their_contrast_within_the_memory(street):
    dark, bright = box([1, 2, 40], [10.5, 1.0, 0], Surface(21, (0.5,) * 3, 0.1)), wall_at(10.6, 0.4)
    returns = swept(street, [dark, bright], n=4000, half=0.5, **{**CONTROLLED, "power_memory": 4000})
    y = returns.distance * np.sin(np.linspace(-0.5, 0.5, 4000)[returns.pulse])
    inside = np.abs(y - 1.0) < 0.95
    gap = returns.intensity[~inside & (np.abs(y) < 3)].mean() - returns.intensity[inside].mean()
    assert gap == pytest.approx(10 * np.log10(4) / 30.0, rel=0.25)


def test_sheeting_is_brightest_and_weak_surfaces_beside_it_are_detected(street):
    sign = box([0.01, 1.0, 1.0], [8.0, 0, 0], Surface(42, (0.5, 0.5, 0.5), 0.8, RETRO))
    returns = swept(street, [sign, wall_at(30.0)], n=4000, half=0.5, **CONTROLLED)
    plate = returns.distance < 10
    assert np.median(returns.intensity[plate][:5]) > 0.7 > np.median(returns.intensity[~plate]) + 0.3
    assert (~plate).sum() > 3000


def test_gains_belong_to_beams_and_stay_through_a_survey(rng):
    device = replace(SCANNERS["hdl64"].devices[0], gain_spread=2.0)
    number = np.sort(rng.choice(10_000_000, 5000, replace=False))
    amplitude = np.full(5000, 15.0, np.float32)
    gain = power_of(device, number / device.pulse_rate, amplitude, seed=3, scanner=0).gain
    per_beam = [np.unique(gain[number % 64 == b]) for b in range(64)]
    assert all(len(values) == 1 for values in per_beam)
    assert np.std(np.concatenate(per_beam)) == pytest.approx(2.0, rel=0.3)
    other = power_of(device, number / device.pulse_rate, amplitude, seed=4, scanner=0).gain
    assert not np.array_equal(gain, other)


def test_a_fixed_power_costs_and_changes_nothing(street):
    power = power_of(Device(1e5, 10.0), np.zeros(3), np.zeros(3, np.float32), seed=0, scanner=0)
    assert len(power.lowered) == len(power.gain) == 0
    default = swept(street, [wall_at(10.0)])
    scaled = swept(street, [wall_at(10.0)], intensity_scale=(0.0, 50.0))
    np.testing.assert_allclose(default.intensity, scaled.intensity, atol=1e-6)
    np.testing.assert_array_equal(default.distance, scaled.distance)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"intensity_scale": [5.0, 5.0]}, "intensity_scale must be two rising amplitudes, got .5.0, 5.0."),
        ({"intensity_scale": [5.0]}, "intensity_scale must be 2 finite numbers"),
        ({"intensity_scale": [0.0, 40.0], "corrected": True}, "either corrected or on an intensity_scale"),
        ({"power_control": -1.0}, "power_control must be between 0 and 100, got -1.0"),
        ({"power_target": float("nan")}, "power_target must be finite"),
        ({"power_memory": 0}, "power_memory must be an integer >= 1, got 0"),
        ({"power_memory": 2.5}, "power_memory must be an integer >= 1, got 2.5"),
        ({"gain_spread": -0.1}, "gain_spread must be between 0 and 100"),
    ],
)
def test_wrong_fields_are_named(fields, message):
    with pytest.raises(ParameterError, match=message):
        scanner_system({"like": "vmx450", **fields})


def test_grass_is_brighter_by_its_gain_and_nothing_else(street):
    meshes = [ground_mesh(street, k) for k in range(3)]
    s, left = (g.ravel() for g in np.meshgrid(np.arange(20, 40, 0.2), np.linspace(-14, 14, 141)))
    xy, _ = street.alignment.place(s, left)
    origin = np.column_stack([xy, street.ground.height(s, left) + 4.0])
    d = np.tile([0.0, 0.0, -1.0], (len(s), 1))
    pulses = Pulses(np.zeros(len(s)), np.zeros(len(s)), d.astype(np.float32), np.hstack([origin, d]).astype(np.float32))
    found = []
    for gain in (0.0, 3.0):
        system = ScannerSystem("one", (Device(1e5, 10.0, range_noise=0.0, turf_gain=gain),))
        none = dict.fromkeys(("profile_rate", "pulse_rate", "range_noise", "beam_divergence", "max_range"))
        parameters = replace(PRESETS["tiny"], scanner=system, beam_rays=1, **none)
        scene = scene_of(street, meshes, [0] * 3, [], np.zeros(3))
        found.append(receive(scene, pulses, parameters, np.random.default_rng(5)))
    (plain, surfaces), (bright, _) = found
    np.testing.assert_array_equal(plain.distance, bright.distance)
    rise = (bright.intensity - plain.intensity) * FULL_SCALE_DB
    grass = surfaces.label == GRASS
    assert grass.sum() > 300 and (~grass).sum() > 300
    np.testing.assert_allclose(rise[grass], 3.0, atol=1e-3)
    np.testing.assert_allclose(rise[~grass], 0.0, atol=1e-6)
