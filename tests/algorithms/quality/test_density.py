"""Figures of the point density against closed forms."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.quality.chunks import inspect_chunk, merge
from mlsroad_pipeline.algorithms.quality.density import count_places, density_figures

UTM = np.array([389_300.0, 5_819_700.0, 0.0])


def figures(xy):
    return merge([inspect_chunk(PointCloud(np.column_stack([xy, np.zeros(len(xy))]), {}, UTM))])


def test_uniform_square_has_the_concentration_of_its_area(rng):
    report = figures(rng.uniform(-30, 30, (60 * 60 * 40, 2)))
    assert report.density == pytest.approx(40, rel=0.01) and report.median_density == pytest.approx(40, abs=1)
    assert report.concentration == pytest.approx(1, abs=0.03)


def test_scan_from_one_place_has_the_ratio_of_its_median_radii(rng):
    radius, angle = 50 * rng.random(400_000) ** 2, 2 * np.pi * rng.random(400_000)
    report = figures(np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]))
    # the median radius of the points is 50 / 4, that of the area of the disc 50 / sqrt(2)
    assert report.concentration == pytest.approx(12.5 / (50 / np.sqrt(2)), rel=0.05)
    assert report.median_density < 0.5 * report.density


def test_place_does_not_matter(rng):
    xy = rng.normal(0, 8, (5000, 2))
    assert figures(xy + 2000).concentration == figures(xy).concentration


@pytest.mark.parametrize("n", [0, 1])
def test_no_cell_and_one_cell(n):
    found = density_figures(np.zeros(n, np.int64), np.full(n, 7), 1.0)
    np.testing.assert_equal(tuple(found), (7.0, 7.0, 1.0) if n else (np.nan,) * 3)


@pytest.mark.parametrize(
    ("xy", "places"),
    [
        (np.zeros((0, 2)), 0),
        ([[0.0, 0.0], [10.0, 20.0]], 1),
        ([[0.0, 0.0], [600.0, 700.0]], 1),  # two cells that touch at a corner
        ([[0.0, 0.0], [1100.0, 0.0]], 2),
        ([[0.0, 0.0], [600.0, 0.0], [1100.0, 0.0], [9000.0, 0.0]], 2),
    ],
)
def test_places_are_groups_of_cells_that_touch(xy, places):
    assert count_places(np.asarray(xy)) == places
