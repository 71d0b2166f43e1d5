"""Spherical neighbourhoods against a search point by point."""

import math

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.features.sphere_features import (
    attribute_columns,
    find_spheres,
    sphere_feature_names,
)

SETTINGS = {"radius": 0.3, "n_scales": 3, "ratio": 2.0, "points_per_radius": 3.0}


def cloud(n=1200, seed=0):
    """A plane, a vertical line and scattered points, far from the origin."""
    rng = np.random.default_rng(seed)
    plane = np.column_stack([rng.uniform(0, 4, (n // 2, 2)), rng.normal(0, 0.01, n // 2)])
    line = np.column_stack([rng.normal(2, 0.01, (n // 4, 2)), rng.uniform(0, 3, n // 4)])
    return np.concatenate([plane, line, rng.uniform(0, 4, (n // 4, 3))]) + [1000, -2000, 50]


def subsampled(points, minimum, size, *values):
    """Return the means of points and values over the cells of a grid, in the order of the cells."""
    cells = [tuple(math.floor(v / size) for v in point - minimum) for point in points]
    rows = {cell: [i for i, other in enumerate(cells) if other == cell] for cell in sorted(set(cells))}
    return [np.array([array[of].mean(axis=0) for of in rows.values()]) for array in (points, *values)]


def described(query, points, values, radius):
    """Return the features of a sphere, formula by formula."""
    near = np.flatnonzero(((points - query) ** 2).sum(axis=1) <= radius**2)
    offset = (points[near] - query) / radius
    w, shape = np.zeros(3), [np.nan] * 15
    if len(near) >= 3:
        w, e = np.linalg.eigh(np.cov(offset.T, bias=True))
        w, e = np.maximum(w[::-1], 0), e[:, ::-1]
        share = w[w > 0] / w.sum()
        shape = [w.sum(), np.prod(w) ** (1 / 3), -(share * np.log(share)).sum()]
        shape += [(w[0] - w[1]) / w[0], (w[1] - w[2]) / w[0], w[2] / w[0], w[2] / w.sum()]
        shape += [abs(math.pi / 2 - math.acos(min(abs(e[2, i]), 1))) for i in (0, 2)]
        shape += [abs((offset @ e[:, i]).mean()) for i in range(3)]
        shape += [((offset @ e[:, i]) ** 2).mean() for i in range(3)]
    radiometry = [m for v in values[near].T for m in (v.mean(), v.var())]
    return [*shape, offset[:, 2].mean(), (offset[:, 2] ** 2).mean(), len(near), *radiometry], w


def test_features_are_those_of_a_search_point_by_point():
    xyz = cloud()
    values = np.random.default_rng(1).random((len(xyz), 4))
    pyramid = find_spheres(xyz, dict(zip(("intensity", "red", "green", "blue"), values.T, strict=True)), **SETTINGS)
    finest = subsampled(xyz, xyz.min(axis=0), 0.1, values)
    assert len(pyramid) == len(finest[0])
    np.testing.assert_allclose(finest[0][pyramid.owner], xyz, atol=0.1)
    rows = np.random.default_rng(2).choice(len(pyramid), 150, replace=False)
    table = pyramid.describe(rows)
    assert table.shape[1] == len(sphere_feature_names(3))
    few = 0
    for scale in range(3):
        points, of_points = subsampled(finest[0], finest[0].min(axis=0), 0.1 * 2**scale, finest[1])
        if scale == 0:
            points, of_points = finest
        for i, row in enumerate(rows):
            expected, w = described(finest[0][row], points, of_points, 0.3 * 2**scale)
            found = table[i, 26 * scale : 26 * (scale + 1)]
            few += np.isnan(expected[0])
            # Directions of equal eigenvalues are arbitrary.
            clear = (
                slice(None) if min(w[0] - w[1], w[1] - w[2]) > 0.02 * w[0] else [0, 1, 2, 3, 4, 5, 6, *range(15, 26)]
            )
            np.testing.assert_allclose(found[clear], np.array(expected)[clear], rtol=1e-3, atol=2e-5)
    assert few > 10


def test_defaults_search_every_cell_that_a_sphere_touches():
    xyz = np.random.default_rng(3).uniform(0, 0.5, (4000, 3))
    pyramid = find_spheres(xyz, {}, n_scales=2)
    points = pyramid.scales[0].points
    found = pyramid.describe(np.arange(len(pyramid)))[:, 17]
    expected = [(((points - p) ** 2).sum(axis=1) <= 0.01).sum() for p in points]
    np.testing.assert_array_equal(found, expected)


def test_selections_and_threads_do_not_change_the_features():
    pyramid = find_spheres(cloud(), {"intensity": np.linspace(0, 1, 1200)}, **SETTINGS)
    whole = pyramid.describe(np.arange(len(pyramid)))
    rows = np.random.default_rng(4).permutation(len(pyramid))[:200]
    np.testing.assert_array_equal(pyramid.describe(rows, n_threads=3), whole[rows])
    colour = np.concatenate([attribute_columns(3, name) for name in ("red", "green", "blue")])
    assert np.isnan(whole[:, colour]).all() and not np.isnan(whole[:, attribute_columns(3, "intensity")]).any()


def test_points_of_one_place_are_one_voxel():
    pyramid = find_spheres(np.full((5, 3), 7.0), {}, n_scales=2)
    table = pyramid.describe(np.array([0]))
    assert pyramid.owner.tolist() == [0] * 5 and table[0, [17, 43]].tolist() == [1, 1]
    assert np.isnan(table[0, :15]).all()


@pytest.mark.parametrize(
    ("values", "message"),
    [({"radius": 0}, "radius"), ({"n_scales": 0}, "n_scales"), ({"ratio": 1}, "ratio"), ({"points_per_radius": 9}, "1..8")],
)  # fmt: skip
def test_parameters_outside_their_domain_are_refused(values, message):
    with pytest.raises(ParameterError, match=message):
        find_spheres(np.zeros((1, 3)), {}, **values)


def test_wrong_clouds_are_refused():
    with pytest.raises(DataError, match="at least 1 points"):
        find_spheres(np.zeros((0, 3)), {})
    with pytest.raises(DataError, match="intensity is NaN in row 1"):
        find_spheres(np.zeros((2, 3)), {"intensity": [0, np.nan]})
    with pytest.raises(DataError, match="unknown attributes"):
        find_spheres(np.zeros((2, 3)), {"time": [0, 1]})
