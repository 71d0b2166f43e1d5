from dataclasses import replace

import numpy as np
import pytest
from references.simulator import scene_of

from mlsroad_pipeline.simulation import PRESETS
from mlsroad_pipeline.simulation.model.meshes import DIFFUSE, FOLIAGE, GLASS, GROUND, RETRO, Surface, join
from mlsroad_pipeline.simulation.model.solids import box
from mlsroad_pipeline.simulation.parameters.devices import Device, ScannerSystem
from mlsroad_pipeline.simulation.rays.scene import RayScene, build_static, triangle_soup
from mlsroad_pipeline.simulation.rays.surfaces import WET
from mlsroad_pipeline.simulation.scanning.amplitudes import FULL_SCALE_DB, amplitude_of, backscatter, range_deviation
from mlsroad_pipeline.simulation.scanning.receiver import GHOST, _tilted, receive
from mlsroad_pipeline.simulation.scanning.scanner import Pulses
from mlsroad_pipeline.simulation.street.ground_mesh import ground_mesh
from mlsroad_pipeline.simulation.street.street import draw_street

WALL = Surface(21, (0.5, 0.5, 0.5), 0.5)


@pytest.fixture(scope="module")
def street():
    return draw_street(1, length=60.0)


def parameters_with(**changes):
    """Return parameters of one scanner with changed fields, by default without noise."""
    fields = {"range_noise": 0.0, "accuracy": 0.0, "max_range": 200.0, **changes}
    system = ScannerSystem("one", (Device(1e5, 10.0, **fields),))
    none = dict.fromkeys(("profile_rate", "pulse_rate", "range_noise", "beam_divergence", "max_range"))
    return replace(PRESETS["tiny"], scanner=system, **none)


def sweep(angles):
    d = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles]).astype(np.float32)
    rays = np.concatenate([np.zeros_like(d), d], axis=1)
    return Pulses(np.zeros(len(d)), np.asarray(angles, dtype=np.float64), d, rays)


def received(street, meshes, pulses, parameters, seed=1):
    scene = scene_of(street, meshes, range(1, len(meshes) + 1), [], np.zeros(3))
    return receive(scene, pulses, parameters, np.random.default_rng(seed))


def test_ranges_are_multiples_of_the_step(street):
    meshes = [box([1.0, 60, 40], [12.5, 0, 0], WALL)]
    returns, _ = received(street, meshes, sweep(np.linspace(-0.6, 0.6, 500)), parameters_with(range_step=0.05))
    steps = returns.distance / 0.05
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert len(np.unique(returns.distance)) > 20


def test_noise_grows_with_incidence_as_the_spot_stretches(street):
    tilt = 1.2
    meshes = [box([1.0, 400, 40], [10.5, 0, 0], WALL)]
    parameters = parameters_with(range_noise=0.002, divergence=0.004)
    pulses = sweep(np.full(8000, tilt))
    returns, _ = received(street, meshes, pulses, parameters)
    distance = 10.0 / np.cos(tilt)
    amplitude = returns.intensity.mean() * FULL_SCALE_DB
    stretch = 0.25 * 0.004 * distance * np.tan(tilt)
    assert returns.distance.std() == pytest.approx(range_deviation(0.002, amplitude, stretch), rel=0.05)
    assert returns.distance.std() > 2 * range_deviation(0.002, amplitude, 0.0)


def picket_scene():
    """Return three combs of thin leaves at 10, 13 and 16 m before a wall at 20 m: every beam hits several."""
    leaf = Surface(31, (0.1, 0.3, 0.1), 0.5, FOLIAGE)
    y = np.arange(-2, 2, 0.05)
    combs = [join([box([0.002, 0.024, 4], [10 + 3 * k, v + 0.011 * k, 0], leaf) for v in y]) for k in range(3)]
    return [*combs, box([1, 40, 40], [20.5, 0, 0], WALL)]


def test_a_beam_through_leaves_gives_many_returns_in_order(street):
    parameters = replace(parameters_with(divergence=0.006, max_returns=4), beam_rays=9)
    pulses = sweep(np.linspace(-0.1, 0.1, 3000))
    returns, surfaces = received(street, picket_scene(), pulses, parameters)
    assert {1, 2, 3, 4} == set(returns.total.tolist())
    several = np.bincount(returns.pulse) >= 3
    assert several.mean() > 0.1
    assert (np.diff(returns.distance)[np.diff(returns.pulse) == 0] > 0.6).all()
    assert (returns.number <= returns.total).all()
    np.testing.assert_array_equal(surfaces.label == 21, returns.distance > 18)
    one, _ = received(street, picket_scene(), pulses, replace(parameters, beam_rays=1))
    assert (one.total == 1).all()


def test_a_scanner_of_one_return_keeps_the_strongest(street):
    pulses = sweep(np.linspace(-0.1, 0.1, 3000))
    many = replace(parameters_with(divergence=0.006, max_returns=8), beam_rays=9)
    single = replace(parameters_with(divergence=0.006, max_returns=1), beam_rays=9)
    every, _ = received(street, picket_scene(), pulses, many)
    best, _ = received(street, picket_scene(), pulses, single)
    assert len(np.unique(best.pulse)) == len(best.pulse) and (best.total == 1).all()
    strongest = np.zeros(len(pulses.time))
    np.maximum.at(strongest, every.pulse, every.intensity)
    np.testing.assert_allclose(best.intensity, strongest[best.pulse], atol=1e-6)


def test_mirrors_put_ghosts_behind_themselves(street):
    pane, behind_us = Surface(20, (0.1, 0.1, 0.1), 0.3, GLASS), box([1, 40, 40], [-3.5, 0, 0], WALL)
    meshes = [box([0.01, 40, 40], [5.005, 0, 0], pane), behind_us]
    returns, surfaces = received(street, meshes, sweep(np.zeros(4000)), parameters_with())
    ghosts = surfaces.label == GHOST
    # 5 m to the pane, and 8 m from there to the wall behind the scanner.
    np.testing.assert_allclose(returns.distance[ghosts], 13.0, atol=1e-3)
    assert 0.01 < ghosts.sum() / 4000 < 0.1


def test_saturated_returns_bloom_along_the_profile(street):
    sign, far = Surface(42, (0.5, 0.5, 0.5), 0.8, RETRO), box([1, 60, 40], [30.5, 0, 0], WALL)
    plate = box([0.01, 0.6, 0.6], [8.0, 0, 0], sign)
    step = Device(1e5, 10.0).step
    angles = np.arange(-300, 300) * step
    half = 0.3 / 8.0
    sharp, _ = received(street, [plate, far], sweep(angles), parameters_with())
    blooming, surfaces = received(street, [plate, far], sweep(angles), parameters_with(blooming=8 * step))
    near = (blooming.distance < 10) & (np.abs(angles[blooming.pulse]) > half + 0.5 * step)
    assert 10 <= near.sum() <= 16
    assert (np.abs(angles[blooming.pulse[near]]) < half + 9 * step).all()
    assert (surfaces.label[near] == 42).all()
    assert not ((sharp.distance < 10) & (np.abs(angles[sharp.pulse]) > half + 0.5 * step)).any()


def test_corrected_intensity_is_the_reflectance_at_any_range(street):
    for distance in (10.0, 40.0):
        meshes = [box([1.0, 40, 40], [distance + 0.5, 0, 0], WALL)]
        returns, _ = received(street, meshes, sweep(np.zeros(2000)), parameters_with(corrected=True))
        # Walls have a tone of their own about their albedo of 0.5.
        assert returns.intensity.mean() == pytest.approx(0.5, abs=0.13)


@pytest.mark.parametrize("wetness", [0.0, 0.1, 0.5])
def test_a_share_of_paved_ground_is_wet_and_dark(street, wetness):
    meshes = [ground_mesh(street, k) for k in range(-2, 3)]
    scene = scene_of(street, meshes, [0] * 5, [], np.zeros(3), wetness=wetness)
    s, left = (g.ravel() for g in np.meshgrid(np.arange(-110, 170, 0.9), np.linspace(-3, 3, 41)))
    xy, _ = street.alignment.place(s, left)
    above = np.column_stack([xy, street.ground.height(s, left) + 5.0])
    rays = np.column_stack([above, np.tile([0, 0, -1.0], (len(s), 1))]).astype(np.float32)
    surfaces = scene.resolve(scene.cast(rays, np.zeros(len(s))), rays)
    road = surfaces.label == 1
    wet = surfaces.kind[road] == WET
    assert wet.mean() == pytest.approx(wetness, abs=0.35 * wetness)
    if wetness:
        assert surfaces.reflectivity[road][wet].mean() < 0.5 * surfaces.reflectivity[road][~wet].mean()


def test_parts_give_the_hits_of_the_whole(street, rng):
    meshes = [box(rng.uniform(0.2, 2, 3), rng.uniform([-20, -5, -3], [20, 5, 3]), WALL) for _ in range(40)]
    numbers = np.arange(1, 41)
    whole = scene_of(street, meshes, numbers, [], np.zeros(3))
    parts = [
        build_static(triangle_soup(meshes[low:high], numbers[low:high], centre, heading=heading))
        for low, high, centre, heading in ((0, 15, np.array([3.0, 1, 0]), 0.4), (15, 40, np.array([-7.0, 0, 2]), -1.0))
    ]
    pieces = RayScene(street, parts, [], np.zeros(3), wetness=0.0)
    d = rng.normal(size=(3000, 3))
    rays = np.hstack(
        [rng.uniform([-22, -6, -4], [22, 6, 4], (3000, 3)), d / np.linalg.norm(d, axis=1, keepdims=True)]
    ).astype(np.float32)
    times = np.zeros(3000)
    a, b = whole.cast(rays, times), pieces.cast(rays, times)
    assert 300 < (a.face >= 0).sum() < 2900
    np.testing.assert_allclose(a.distance, b.distance, atol=1e-4)
    np.testing.assert_array_equal(whole.instances[a.face[a.face >= 0]], pieces.instances[b.face[a.face >= 0]])
    np.testing.assert_array_equal(whole.occluded(rays, times), pieces.occluded(rays, times))


def test_ground_scatters_back_as_oren_and_nayar_say():
    roughness = 0.6
    a = 1 - 0.5 * roughness**2 / (roughness**2 + 0.33)
    b = 0.45 * roughness**2 / (roughness**2 + 0.09)
    slant = np.radians([0.0, 20.0, 45.0, 70.0, 80.0, 87.0])
    # Light and eye in one direction: alpha and beta are both the slant, and the azimuths agree.
    wanted = np.cos(slant) * (a + b * np.sin(slant) * np.tan(slant))
    np.testing.assert_allclose([backscatter(float(np.cos(angle))) for angle in slant], wanted, rtol=1e-9)
    low = float(np.cos(np.radians(80)))
    rough, smooth = (amplitude_of(0.2, kind, low, 10.0) for kind in (GROUND, DIFFUSE))
    assert rough - smooth == pytest.approx(10 * np.log10(2.75), abs=0.1)
    # A white surface at normal incidence, 10 m away, is the reference, apart from the near field.
    assert amplitude_of(1.0, DIFFUSE, 1.0, 10.0) == pytest.approx(38.0 - 10 * np.log10(1.16))


def test_tilted_rays_lie_at_their_angle_around_the_axis(rng):
    rays, chance = rng.normal(size=(2000, 6)).astype(np.float32), rng.random((2000, 2), dtype=np.float32)
    rays[:, 3:] /= np.linalg.norm(rays[:, 3:], axis=1, keepdims=True)
    assert (np.abs(rays[:, 5]) > 0.9).sum() > 50  # steep ones have other axes
    found = _tilted(rays, np.arange(2000), chance, 0.01)
    across = (found - rays)[:, 3:].astype(np.float64)
    np.testing.assert_array_equal(found[:, :3], rays[:, :3])
    np.testing.assert_allclose((across * rays[:, 3:]).sum(axis=1), 0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(across, axis=1), 0.01 * np.sqrt(0.25 + 0.75 * chance[:, 1]), atol=1e-6)
