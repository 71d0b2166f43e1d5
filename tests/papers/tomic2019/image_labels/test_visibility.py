import numpy as np
import open3d as o3d
import pytest
from references.cameras import nearest_disc, seen_past_rectangles

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.cameras.projection import project_points
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.papers.tomic2019.image_labels.depth_buffer import ground_relief, nearest_discs, typical_spacing
from mlsroad_pipeline.papers.tomic2019.image_labels.visibility import (
    DepthBuffer,
    HiddenPointRemoval,
    hidden_point_removal,
    visible_points,
)

EYE = np.array([0.0, 0.0, 2.4])
CAMERA = Camera(
    [[310.0, 0, 239.5], [0, 310.0, 179.5], [0, 0, 1]], None,
    [[0.0, -1, 0], [0, 0, -1], [1, 0, 0]], np.array([0.0, 2.4, 0.0]), 480, 360,
)  # fmt: skip
"""At 2.4 m above the origin, looking along x."""
METHODS = pytest.mark.parametrize(
    "method", [DepthBuffer(), HiddenPointRemoval(voxel_size=0.15)], ids=["buffer", "hull"]
)


def grid(low, high, step):
    """Return points on an upright or level rectangle, metres."""
    axes = [np.arange(a, b + 1e-9, step) if b > a else np.array([a]) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def share(values):
    return float(np.mean(values))


@METHODS
def test_a_wall_hides_what_stands_behind_it(method, rng):
    front, back = ([10.0, -1, 0.5], [10.0, 2, 4]), ([16.0, -6, 0], [16.0, 6, 6])
    xyz = np.concatenate([grid(*front, 0.04), grid(*back, 0.05)])
    xyz = xyz + rng.normal(0, 0.004, xyz.shape)
    truth = seen_past_rectangles(xyz, EYE, [front])
    truth[: len(grid(*front, 0.04))] = True  # noise puts some of the wall's own points behind it
    seen = visible_points(xyz, CAMERA, method=method)
    assert 0.1 < share(~truth) < 0.4
    assert share(seen[truth]) > 0.95 and share(~seen[~truth]) > 0.95
    # The wall itself is seen throughout.
    assert seen[: len(grid(*front, 0.04))].all() or isinstance(method, HiddenPointRemoval)


def test_a_road_does_not_hide_itself_however_far(rng):
    xyz = grid([4.0, -4, 0], [80.0, 4, 0], 0.1)
    xyz[:, 2] += rng.normal(0, 0.005, len(xyz))
    inside = project_points(xyz, CAMERA)[2]
    assert share(visible_points(xyz, CAMERA)[inside]) > 0.995


def test_points_seen_through_the_gaps_of_a_sparse_wall_are_hidden(rng):
    wall, behind = grid([8.0, -2, 0], [8.0, 2, 4.5], 0.12), grid([12.0, -1, 1.0], [12.0, 1, 3.5], 0.05)
    xyz = np.concatenate([wall + rng.uniform(-0.03, 0.03, wall.shape), behind])
    small = {"spacing": 0.06}  # half of the wall's own, as where a front is sparser than what else the image shows
    closed, left_open = (visible_points(xyz, CAMERA, method=DepthBuffer(gap=g, **small)) for g in (5, 0))
    assert closed[: len(wall)].all()
    assert share(closed[len(wall) :]) < 0.1 and share(left_open[len(wall) :]) > 0.5


def test_a_pole_hides_no_more_than_its_own_width():
    pole, wall = grid([6.0, -0.05, 0], [6.0, 0.05, 5], 0.02), grid([12.0, -3, 0.5], [12.0, 3, 4.5], 0.04)
    seen = visible_points(np.concatenate([pole, wall]), CAMERA)[len(pole) :]
    shadow = np.abs(wall[:, 1]) < 0.1  # twice as far, twice as wide
    assert not seen[shadow].any()
    assert seen[np.abs(wall[:, 1]) > 0.1 + 2 * 0.06].all()


def test_what_is_not_in_the_image_is_not_seen_and_hides_nothing_beyond_the_range():
    xyz = np.array([[10.0, 0, 2.4], [-10.0, 0, 2.4], [10.0, 30, 2.4], [50.0, 5.0, 2.4]])
    assert visible_points(xyz, CAMERA).tolist() == [True, False, False, True]
    assert visible_points(xyz, CAMERA, method=DepthBuffer(max_range=40)).tolist() == [True, False, False, False]
    assert visible_points(xyz, CAMERA, method=HiddenPointRemoval(max_range=40)).tolist() == [True, False, False, False]


def test_the_front_of_a_sphere_is_seen_by_its_hull(rng):
    xyz = rng.normal(size=(4000, 3))
    xyz /= np.linalg.norm(xyz, axis=1, keepdims=True)
    eye = np.array([0.0, 0.0, 6.0])
    towards = ((eye - xyz) * xyz).sum(axis=1) / np.linalg.norm(eye - xyz, axis=1)
    seen = hidden_point_removal(xyz, eye, radius=7.0 * 100)
    assert seen[towards > 0.3].all() and not seen[towards < -0.3].any()


@pytest.mark.parametrize("exponent", [1, 3])
def test_hidden_point_removal_is_that_of_open3d(rng, exponent):
    xyz = np.concatenate([rng.uniform(-5, 5, (3000, 3)), grid([6.0, -3, 0], [6.0, 3, 4], 0.2)])
    eye = np.array([20.0, 3.0, 2.0])
    radius = np.linalg.norm(xyz - eye, axis=1).max() * 10.0**exponent
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(xyz))
    _, rows = cloud.hidden_point_removal(eye, radius)
    seen = hidden_point_removal(xyz, eye, radius=radius)
    assert sorted(rows) == np.flatnonzero(seen).tolist()
    assert 20 < seen.sum() < len(xyz)


def test_hardly_any_points_and_flat_ones_are_seen_as_they_are():
    eye = np.zeros(3)
    assert hidden_point_removal(np.zeros((0, 3)), eye, radius=1.0).tolist() == []
    assert hidden_point_removal([[1.0, 0, 0], [2.0, 0, 0]], eye, radius=9.0).tolist() == [True, False]
    assert hidden_point_removal([[1.0, 0, 0], [0, 2.0, 0], [0, 0, 0]], eye, radius=9.0).all()
    flat = np.array([[np.cos(a), np.sin(a), 0.0] for a in np.linspace(0, 1.2, 9)]) * 3
    assert hidden_point_removal(flat, eye, radius=30.0).all()


def test_discs_are_drawn_as_a_slow_painter_draws_them(rng):
    n = 60
    u, v = (rng.uniform(-2, side + 2, n).astype(np.float32) for side in (24, 18))
    inside = (u > -0.5) & (u < 23.5) & (v > -0.5) & (v < 17.5)
    u, v, z = u[inside], v[inside], rng.uniform(1, 20, inside.sum()).astype(np.float32)
    options = {"focal": 30.0, "diameter": 0.4, "width": 24, "height": 18}
    painted, depth = nearest_discs(u, v, z, *options.values())
    assert np.array_equal(painted, nearest_disc(u, v, z, **options))
    assert (painted >= 0).sum() > 60
    assert np.array_equal(depth, np.where(painted >= 0, z[painted], np.inf))


@pytest.mark.parametrize(("distance", "step"), [(10.0, 0.02), (10.0, 0.05), (30.0, 0.05)])
def test_spacing_of_a_wall_is_that_of_its_points(distance, step):
    y, z = np.meshgrid(np.arange(-6, 6, step), np.arange(-3, 3, step))
    u, v = (700 * values.ravel() / distance + middle for values, middle in ((y, 500), (z, 300)))
    inside = (u >= 0) & (u < 1000) & (v >= 0) & (v < 600)
    depth = np.full(inside.sum(), distance, np.float32)
    places = u[inside].astype(np.float32), v[inside].astype(np.float32)
    found = typical_spacing(*places, depth, focal=700.0, width=1000, height=600)
    assert found == pytest.approx(step, rel=0.1)  # shells are a fifth deep, blocks hold whole numbers of points


def test_few_points_have_no_spacing():
    few = np.ones(5, np.float32)
    assert typical_spacing(few, few, few, focal=700.0, width=100, height=60) == 0.0
    assert typical_spacing(few[:0], few[:0], few[:0], focal=700.0, width=100, height=60) == 0.0


def test_ground_may_be_farther_by_its_roughness_over_the_slope_of_the_line_of_sight():
    road = grid([3.0, -2, 0], [40.0, 2, 0], 0.25)
    post = grid([20.0, 0, 0.5], [20.0, 0, 2], 0.1)
    above = np.array([[20.0, 1.0, 5.0]])
    xyz = np.concatenate([road, post, above])
    found = ground_relief(xyz, np.arange(len(xyz)), EYE, 0.5, 0.15, 0.1)
    expected = 0.1 * np.linalg.norm(road - EYE, axis=1) / 2.4
    np.testing.assert_allclose(found[: len(road)], expected, rtol=1e-5)
    assert (found[len(road) :] == 0).all()
    assert ground_relief(xyz, np.zeros(0, np.int64), EYE, 0.5, 0.15, 0.1).shape == (0,)


def test_rough_grass_does_not_hide_itself_and_a_bank_still_hides(rng):
    grass = grid([20.0, -6, 0], [60.0, 6, 0], 0.08)
    grass[:, 2] += rng.normal(0, 0.02, len(grass))
    inside = project_points(grass, CAMERA)[2]
    rough = share(visible_points(grass, CAMERA)[inside])
    assert rough > 0.97 > share(visible_points(grass, CAMERA, method=DepthBuffer(relief=0))[inside]) + 0.05
    bank = grid([20.0, -6, 0.0], [20.0, 6, 1.5], 0.08)
    seen = visible_points(np.concatenate([grass, bank]), CAMERA)[: len(grass)]
    truth = seen_past_rectangles(grass, EYE, [([20.0, -6, 0], [20.0, 6, 1.4])])
    shadow = inside & ~truth & (grass[:, 0] > 22)
    assert shadow.sum() > 1000 and share(seen[shadow]) < 0.01


@pytest.mark.parametrize("step", [0.02, 0.04, 0.08])
def test_the_back_of_a_box_is_hidden_by_its_front_however_dense_the_points(step):
    """As a car's back is, that the scanner saw in passing."""
    front, back = grid([12.0, -1, 0.3], [12.0, 1, 1.8], step), grid([13.0, -0.8, 0.4], [13.0, 0.8, 1.6], step)
    seen = visible_points(np.concatenate([front, back]), CAMERA)
    assert seen[: len(front)].all() and share(seen[len(front) :]) < 0.02


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: DepthBuffer(relief=-1), "relief must be a finite number >= 0, got -1"),
        (lambda: DepthBuffer(disc=0), "disc must be a finite number > 0, got 0"),
        (lambda: DepthBuffer(spacing=0), "spacing must be a finite number > 0, got 0"),
        (lambda: DepthBuffer(gap=-1), "gap must be a finite number >= 0, got -1"),
        (lambda: DepthBuffer(gap_directions=5), "gap_directions must be 1, 2, 3 or 4, got 5"),
        (lambda: DepthBuffer(max_range=0), "max_range must be > 0, got 0"),
        (lambda: HiddenPointRemoval(voxel_size=-0.1), "voxel_size must be"),
        (
            lambda: hidden_point_removal([[3.0, 0, 0]], np.zeros(3), radius=2.0),
            "at least the largest distance 3, got 2",
        ),
    ],
)
def test_parameters_outside_their_domain_are_named(build, message):
    with pytest.raises(ParameterError, match=message):
        build()
