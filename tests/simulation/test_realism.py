"""Closed forms: lines of a known scanner over a plane, grids of known density, planes with planted noise."""

import numpy as np
import pytest
from scipy.stats import ks_2samp

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.simulation import PRESETS
from mlsroad_pipeline.simulation.realism import (
    binned_quantiles,
    distribution_gap,
    fit_scan_lines,
    incidence_angles,
    plane_residuals,
    surface_density,
)


def side_looking(*, height=1.83, step=0.5, spacing=0.2, lines=12, reach=12.0, wall=6.0, first_angle=12.0, yaw=0.3):
    """Return points, in the order measured, of a scanner that looks left over a plane to a wall."""
    angles = np.radians(np.arange(first_angle, 120.0, step))
    out = []
    for k in range(lines):
        r = height * np.tan(angles)
        ground = (angles < np.pi / 2) & (r < reach)
        far = np.full(ground.sum(), k * spacing), r[ground], np.zeros(ground.sum())
        beyond = angles[~ground & (angles < np.radians(115.0))]
        up = height - reach / np.tan(np.minimum(beyond, np.radians(114.9)))
        on_wall = np.full(len(beyond), k * spacing), np.full(len(beyond), reach), np.minimum(up, wall)
        out.append(np.column_stack([np.r_[a, b] for a, b in zip(far, on_wall, strict=True)]))
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    return np.concatenate(out) @ turn.T + [100.0, -50.0, 3.0]


@pytest.mark.parametrize(("height", "step", "reach"), [(1.83, 0.5, 12.0), (2.4, 0.25, 17.0), (1.2, 0.4, 6.0)])
def test_scan_lines_recover_the_scanner(height, step, reach):
    points = side_looking(height=height, step=step, reach=reach)
    found = fit_scan_lines(points)
    assert len(found.first) == 12
    # The steps are finite differences of a tangent, hence the small bias.
    assert found.height == pytest.approx(np.full(12, height), rel=0.01)
    assert found.step == pytest.approx(np.full(12, step), rel=0.01)
    assert found.reach == pytest.approx(np.full(12, reach), abs=0.4)
    spacing = np.linalg.norm(np.diff(found.nadir, axis=0), axis=1)
    assert spacing == pytest.approx(np.full(11, 0.2), abs=0.01)
    assert found.nadir[:, 2] == pytest.approx(np.full(12, 3.0))
    assert found.direction == pytest.approx(np.tile([-np.sin(0.3), np.cos(0.3)], (12, 1)), abs=1e-9)
    assert (np.diff(found.first) == len(points) // 12).all() and found.first[0] == 0


def test_lines_without_enough_ground_are_skipped():
    assert len(fit_scan_lines(side_looking(reach=1.2)).first) == 0
    for few in (np.zeros((0, 3)), np.zeros((1, 3)), np.zeros((200, 3))):
        assert len(fit_scan_lines(few).first) == 0


def test_the_oakland_preset_has_the_geometry_of_the_recordings(real_data):
    recorded = np.loadtxt(real_data("oakland", "oakland_part2_ac.xyz_label_conf.gz"))[:, :3]
    found, (device,) = fit_scan_lines(recorded), PRESETS["oakland"].devices
    assert len(found.first) > 400
    preset = PRESETS["oakland"].scanner
    assert np.median(found.height) == pytest.approx(preset.platform + device.lever[2], abs=0.05)
    assert np.median(found.step) == pytest.approx(np.degrees(device.step), abs=0.02)
    nearest = np.hypot(*(recorded[found.first, :2] - found.nadir[:, :2]).T)
    angle = np.degrees(np.arctan2(nearest, found.height))
    assert np.median(angle) == pytest.approx(device.field[0], abs=4.0)


def test_density_of_a_grid_is_that_of_its_spacing():
    x, y = np.meshgrid(np.arange(60) * 0.1, np.arange(60) * 0.1)
    density = surface_density(np.column_stack([x.ravel(), y.ravel(), np.zeros(3600)]), k=48).reshape(60, 60)
    # 49 points lie within four spacings of an inner point (Gauss's circle), the 48 others the farthest at exactly four.
    assert density[10:-10, 10:-10] == pytest.approx(48 / (np.pi * 0.4**2))
    assert density[0, 0] < density[30, 30] / 1.8
    assert np.isnan(surface_density(np.zeros((5, 3)), k=5)).all()
    assert np.isinf(surface_density(np.zeros((6, 3)), k=5)).all()


@pytest.mark.parametrize("noise", [0.002, 0.01])
def test_scatter_about_planes_is_the_planted_noise(rng, noise):
    n = 60_000
    xy = rng.uniform(0, 10, (n, 2))
    # A plane through the middles of cells in z, so that no cell cuts the noise.
    normal = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])
    z = -(xy @ normal[:2]) / normal[2]
    points = np.column_stack([xy, z]) + noise * rng.standard_normal((n, 1)) * normal
    scatter, centre = plane_residuals(points, cell_size=1.0, min_points=100)
    assert np.sqrt(np.mean(scatter**2)) == pytest.approx(noise, rel=0.02)
    assert np.abs(centre @ normal).max() < 5 * noise
    few = points[:6]
    assert plane_residuals(few, cell_size=100.0, min_points=7)[0].shape == (0,)


def test_scatter_is_unbiased_for_few_points(rng):
    cells = np.arange(4000) * 2.0
    points = rng.uniform(0.2, 0.8, (4000, 5, 3)) + np.stack([cells, np.zeros(4000), np.zeros(4000)], 1)[:, None]
    points[..., 2] = 0.5 + 0.001 * rng.standard_normal((4000, 5))
    scatter, _ = plane_residuals(points.reshape(-1, 3), cell_size=1.0, min_points=5)
    assert len(scatter) == 4000
    assert np.mean(scatter**2) == pytest.approx(1e-6, rel=0.06)


def test_incidence_on_the_ground_is_the_angle_from_the_nadir():
    angles = np.radians([0.0, 30.0, 60.0, 89.0])
    points = np.column_stack([2 * np.tan(angles), np.zeros(4), np.zeros(4)])
    up, down = np.tile([0.0, 0.0, 1.0], (4, 1)), np.tile([0.0, 0.0, -1.0], (4, 1))
    for normals in (up, down):
        assert incidence_angles(points, normals, [0.0, 0.0, 2.0]) == pytest.approx([0.0, 30.0, 60.0, 89.0], abs=1e-5)
    assert np.isnan(incidence_angles(points[:1], up[:1] * np.nan, [0.0, 0.0, 2.0]))
    assert np.isnan(incidence_angles(points[:1], up[:1], points[0]))
    with pytest.raises(DataError, match=r"\(3, 3\)"):
        incidence_angles(points, up[:3], [0.0, 0.0, 2.0])


def test_quantiles_of_bins_are_numpys_own(rng):
    at, values = rng.uniform(0, 3, 500), rng.standard_normal(500)
    values[:5] = np.nan
    found = binned_quantiles(values, at, [0.0, 1.0, 2.0, 5.0, 6.0])
    for b, (low, high) in enumerate([(0, 1), (1, 2), (2, 5)]):
        assert found[b] == pytest.approx(np.nanquantile(values[(at >= low) & (at < high)], [0.25, 0.5, 0.75]))
    assert np.isnan(found[3]).all()
    with pytest.raises(ParameterError, match="rising"):
        binned_quantiles(values, at, [0.0, 0.0])


def test_gap_of_distributions_is_scipys_statistic(rng):
    a, b = rng.standard_normal(300), np.round(rng.standard_normal(200) + 0.4, 1)
    assert distribution_gap(a, np.append(b, np.nan)) == pytest.approx(ks_2samp(a, b).statistic)
    assert distribution_gap(b, b) == 0.0
    assert distribution_gap(b, b + 10) == 1.0
    assert np.isnan(distribution_gap(a, []))


def test_bad_arguments_are_errors():
    for call, match in (
        (lambda: fit_scan_lines(np.zeros((3, 3)), min_jump=0), "min_jump must be a finite number > 0, got 0"),
        (lambda: surface_density(np.zeros((3, 3)), k=0), "k must be at least 1, got 0"),
        (lambda: plane_residuals(np.zeros((3, 3)), cell_size=-1), "cell_size must be a finite number > 0, got -1"),
        (lambda: plane_residuals(np.zeros((3, 3)), min_points=3), "min_points must be at least 4, got 3"),
    ):
        with pytest.raises(ParameterError, match=match):
            call()
    with pytest.raises(DataError, match="xyz"):
        fit_scan_lines(np.full((30, 3), np.nan))
