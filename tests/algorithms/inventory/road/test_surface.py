"""Surface of a road: planes, surfaces, ruts and evenness of planted ground, straightedges against a slow reference."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.inventory.road.stations import Located
from mlsroad_pipeline.algorithms.inventory.road.surface import (
    CELL,
    CELLS,
    REACH,
    Ground,
    evenness,
    fit_planes,
    lath_gaps,
    ruts,
    surface_heights,
)

STATIONS = 30
NO_EDGES = np.full((2, STATIONS), np.nan)


def ground_of(shape, n=400_000, noise=0.002, natural=0.0, seed=5):
    """Return the ground of random points with the heights of a function of station and offset."""
    rng = np.random.default_rng(seed)
    station, offset = rng.uniform(0, STATIONS, n), rng.uniform(-6, 6, n)
    ground = Ground.empty(STATIONS, 50.0)
    z = 50.0 + shape(station, offset) + noise * rng.normal(size=n)
    ground.add(Located(np.arange(n), station, offset), z, rng.random(n) < natural)
    return ground


def slanted(station, offset):
    return 0.05 * station - 0.025 * offset


def test_a_plane_has_its_slope_and_crossfall():
    planes = fit_planes(ground_of(slanted), NO_EDGES)
    assert np.allclose(planes.slope, 0.05, atol=3e-4) and np.allclose(planes.crossfall, 0.025, atol=3e-4)
    assert np.allclose(planes.height, 0.05 * (np.arange(STATIONS) + 0.5), atol=1e-3)


def test_bumps_and_kerbs_in_the_strip_do_not_tilt_the_plane():
    def bumpy(station, offset):
        return slanted(station, offset) + np.where(offset > 1.2, 0.12, 0.0) + np.where(offset < -1.3, -0.3, 0.0)

    planes = fit_planes(ground_of(bumpy), NO_EDGES)
    assert np.allclose(planes.crossfall, 0.025, atol=1e-3)
    edges = np.stack([np.full(STATIONS, -5.0), np.full(STATIONS, 1.6)])
    assert np.allclose(fit_planes(ground_of(bumpy), edges).crossfall, 0.025, atol=1e-3)


def test_natural_or_missing_ground_has_no_plane():
    assert np.isnan(fit_planes(ground_of(slanted, natural=1.0), NO_EDGES).slope).all()
    assert np.isnan(fit_planes(ground_of(slanted, n=20), NO_EDGES).slope).all()


def test_the_surface_bridges_holes_and_leaves_out_reflections_under_vehicles():
    def reflecting(station, offset):
        return slanted(station, offset) - np.where((offset > 3) & (offset < 4), 0.6, 0.0)

    ground = ground_of(reflecting)
    surface = surface_heights(ground, fit_planes(ground, NO_EDGES))
    offset = (np.arange(CELLS) + 0.5) * CELL - REACH
    true = slanted(np.arange(STATIONS)[:, None] + 0.5, offset)
    seen = np.abs(offset) < 6
    assert np.abs(surface - true)[:, seen].max() < 0.01


def test_planted_ruts_have_their_depth_and_sparse_ground_has_none():
    def rutted(station, offset):
        return slanted(station, offset) - 0.012 * np.exp(-(((offset - 0.75) / 0.2) ** 2))

    ground = ground_of(rutted)
    left, right = ruts(ground, fit_planes(ground, NO_EDGES), NO_EDGES)
    assert np.allclose(right, 0.012, atol=0.002) and (left < 0.002).all()
    narrow = np.stack([np.full(STATIONS, -5.0), np.full(STATIONS, 1.5)])
    left, right = ruts(ground, fit_planes(ground, narrow), narrow)
    assert np.isfinite(left).all() and np.isnan(right).all()
    sparse, noisy = ground_of(rutted, n=20_000), ground_of(rutted, noise=0.03)
    for other in (sparse, noisy):
        assert np.isnan(ruts(other, fit_planes(other, NO_EDGES), NO_EDGES)).all()


def test_a_dip_in_the_wheel_path_is_uneven():
    def dipped(station, offset):
        return slanted(station, offset) - 0.01 * np.exp(-(((station - 15.5) / 0.6) ** 2))

    ground = ground_of(dipped)
    gaps = evenness(ground, fit_planes(ground, NO_EDGES))
    assert gaps[15] == pytest.approx(0.01, abs=0.002) and np.nanmax(gaps[:12]) < 0.002
    assert np.isnan(gaps[[0, 1, -1]]).all()


def slow_gaps(level, size):
    """Return the gaps under straightedges by trying all pairs of places to lie on."""
    gaps = np.zeros(len(level))
    for first in range(max(len(level) - size + 1, 1)):
        part = level[first : first + size]
        at = np.arange(len(part))
        for a in at:
            for b in at[a + 1 :]:
                line = part[a] + (part[b] - part[a]) * (at - a) / (b - a)
                if (line >= part - 1e-12).all():
                    inside = slice(first + a, first + b + 1)
                    gaps[inside] = np.maximum(gaps[inside], (line - part)[a : b + 1])
    return gaps


@pytest.mark.parametrize(("n", "size"), [(36, 21), (20, 17), (9, 21)])
def test_straightedges_lie_as_all_pairs_of_places_say(n, size):
    for seed in range(5):
        level = np.random.default_rng(seed).normal(size=n).cumsum()
        assert np.allclose(lath_gaps(level, size), slow_gaps(level, size))
