"""Relations between the results of every stateless kernel on changed inputs."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.kernels import KERNELS, UTM, heights_above_ground, model_stages, supervoxel_features
from scipy.sparse import csr_array
from sklearn.metrics import adjusted_rand_score

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.features.eigen import compute_eigen_features
from mlsroad_pipeline.algorithms.features.supervoxel_features import compute_supervoxel_features

registry = pytest.mark.parametrize("kernel", KERNELS.values(), ids=KERNELS)


@pytest.fixture(scope="module")
def xyz():
    """A road, a wall, a pole and a bush: 3,000 points, float64, no two of them alike."""
    rng = np.random.default_rng(7)
    road = np.column_stack([rng.uniform(0, 8, 1500), rng.uniform(0, 6, 1500), rng.normal(0, 0.01, 1500)])
    wall = np.column_stack([rng.uniform(0, 8, 800), rng.normal(6.5, 0.01, 800), rng.uniform(0.05, 3, 800)])
    pole = np.column_stack([rng.normal(4, 0.05, 300), rng.normal(3, 0.05, 300), rng.uniform(0.05, 4, 300)])
    bush = rng.normal([6.5, 1.5, 0.8], 0.25, (400, 3))
    return np.round(np.concatenate([road, wall, pole, bush]), 3)  # millimetres, which survive the move to UTM


def as_bytes(results):
    parts = [[r.data, r.indices, r.indptr] if isinstance(r, csr_array) else [r] for r in results]
    return [array.tobytes() for group in parts for array in group]


def changed_share(kernel, one, other, tolerance=0.0):
    """Share of points whose result differs, as far as a result has one row per point."""
    if kernel.partition:
        return 1.0 - adjusted_rand_score(one[0], other[0])
    worst = 0.0
    for first, second in zip(one, other, strict=True):
        assert first.shape == second.shape and first.dtype == second.dtype
        if first.dtype == np.bool_:
            same = first == second
        else:
            same = np.isclose(first, second, rtol=2e-3, atol=2e-3 + tolerance, equal_nan=True)
        worst = max(worst, float((~same).reshape(len(first), -1).any(axis=1).mean()))
    return worst


@registry
def test_input_is_not_modified(kernel, xyz):
    given = xyz.copy()
    given.flags.writeable = False
    kernel.run(given)
    assert np.array_equal(given, xyz)


@registry
def test_same_input_gives_the_same_bytes(kernel, xyz):
    assert as_bytes(kernel.run(xyz)) == as_bytes(kernel.run(xyz.copy()))


@registry
def test_layout_of_the_array_does_not_matter(kernel, xyz):
    padded = np.zeros((len(xyz), 5))
    padded[:, 1:4] = xyz
    assert as_bytes(kernel.run(padded[:, 1:4])) == as_bytes(kernel.run(xyz))
    assert as_bytes(kernel.run(np.asfortranarray(xyz))) == as_bytes(kernel.run(xyz))


@pytest.mark.parametrize("name", [name for name, kernel in KERNELS.items() if kernel.threads])
def test_threads_give_the_bytes_of_one(name, xyz):
    run = KERNELS[name].run
    assert as_bytes(run(xyz, n_threads=1)) == as_bytes(run(xyz, n_threads=2))


@registry
def test_place_on_earth_does_not_matter(kernel, xyz):
    """Float64 coordinates of UTM size keep their millimetres, so results stay but for points at a voxel's border."""
    assert changed_share(kernel, kernel.run(xyz), kernel.run(xyz + UTM), kernel.tolerance) <= kernel.shift + 0.002


@registry
def test_quarter_turn_does_not_matter(kernel, xyz):
    if kernel.turn is None:
        return
    turned = np.column_stack([-xyz[:, 1], xyz[:, 0], xyz[:, 2]])
    assert changed_share(kernel, kernel.run(xyz), kernel.run(turned)) <= kernel.turn + 0.002


def test_directions_turn_with_the_points(xyz):
    turned = np.column_stack([-xyz[:, 1], xyz[:, 0], xyz[:, 2]])
    one, other = compute_eigen_features(xyz, k=12), compute_eigen_features(turned, k=12)
    for x, y, z in (("nx", "ny", "nz"), ("direction_x", "direction_y", "direction_z")):
        before = np.column_stack([-one[y], one[x], one[z]])
        after = np.column_stack([other[x], other[y], other[z]])
        cosine = np.abs((before * after).sum(axis=1))  # an axis has no sign
        assert (cosine > 0.999).mean() > 0.99


@registry
def test_order_of_the_points_does_not_matter(kernel, xyz):
    order = np.random.default_rng(3).permutation(len(xyz))
    one, other = kernel.run(xyz), kernel.run(xyz[order])
    if len(one[0]) != len(xyz):  # one row per supervoxel, which are numbered as they come
        one, other = ([np.sort(part, axis=0) for part in parts] for parts in (one, other))
        assert changed_share(kernel, one, other) <= 0.002
        return
    moved = [part[order] if getattr(part, "shape", (0,))[0] == len(xyz) else part for part in one]
    assert changed_share(kernel, moved[:1], other[:1]) <= kernel.permute + 0.002


@registry
def test_labels_are_numbered_by_first_point(kernel, xyz):
    labels = kernel.run(xyz)[0]
    if not kernel.partition:
        assert labels.dtype != np.int64
        return
    found = labels[labels >= 0]
    _, first = np.unique(found, return_index=True)
    assert labels.dtype == np.int32 and np.all(np.diff(first) > 0)


@registry
@pytest.mark.parametrize("n_points", [0, 1, 2])
def test_hardly_any_points_are_no_error(kernel, n_points):
    given = np.arange(3.0 * n_points).reshape(n_points, 3)
    if n_points < kernel.minimum:
        with pytest.raises(DataError, match=f"needs at least {kernel.minimum} points, got {n_points}"):
            kernel.run(given)
        return
    results = kernel.run(given)
    per_point = results[0]
    assert len(per_point) == n_points or per_point.ndim == 2


@registry
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_coordinates_that_are_no_numbers_are_named_with_their_row(kernel, xyz, value):
    broken = xyz.copy()
    broken[11, 2] = value
    if kernel.run is supervoxel_features:  # its labels cannot be made of such points
        labels = np.zeros(len(xyz), dtype=np.int32)
        height = np.zeros(len(xyz), dtype=np.float32)
        with pytest.raises(DataError, match="row 11"):
            compute_supervoxel_features(broken, labels, csr_array((1, 1)), height_above_ground=height)
        return
    with pytest.raises(DataError, match="row 11"):
        kernel.run(broken)


@registry
def test_wrong_shape_is_named(kernel):
    if kernel.run in (supervoxel_features, model_stages, heights_above_ground):
        return
    with pytest.raises(DataError, match=r"\(n, 3\).*\(4, 2\)"):
        kernel.run(np.zeros((4, 2)))
