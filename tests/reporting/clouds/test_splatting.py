"""Software renderer against a per-pixel reference, and its invariances."""

import numpy as np
import pytest
from references import evaluation as references

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.reporting.clouds.splatting import (
    close_gaps,
    depth_shading,
    nearest_points,
    render_points,
    shaded_picture,
)
from mlsroad_pipeline.reporting.clouds.view import View, birds_eye_view, look_at

PLAIN = View(np.eye(3), np.zeros(3), 1.0, (40, 30), False)
"""One pixel per metre, z away from the viewer, the origin in the picture's middle."""


@pytest.fixture
def cloud(rng):
    # quarters of a metre: exact in float32, so that rounding cannot tell the two apart
    return np.round(rng.uniform(-25, 25, (3000, 3)) * 4) / 4 + 0.125


@pytest.mark.parametrize("side", [1, 2, 3])
def test_nearest_points_equal_painting_one_by_one(cloud, side):
    index, depth = nearest_points(cloud, PLAIN, splat_metres=float(side))
    pixels = cloud[:, :2] + [20, 15]
    expected = references.splat(pixels, cloud[:, 2], [side] * len(cloud), (30, 40))
    np.testing.assert_array_equal(index, expected[0])
    np.testing.assert_array_equal(depth, expected[1])


def test_perspective_divides_by_depth_and_hides_what_lies_behind_the_viewer(rng):
    view = look_at([0, 0, 0], [0, 1, 0], size=(40, 30), field_of_view=90.0)
    cloud = rng.uniform(-5, 5, (2000, 3))
    index, depth = nearest_points(cloud, view, splat_metres=1e-6)
    ahead = cloud[:, 1] >= 0.1
    pixels = np.column_stack([20 + 20 * cloud[:, 0] / cloud[:, 1], 15 - 20 * cloud[:, 2] / cloud[:, 1]])
    seen = np.flatnonzero(ahead)
    expected, _ = references.splat(pixels[seen], cloud[seen, 1], [1] * len(seen), (30, 40))
    # pixels are compared by the depth that they show: float32 may push a point over a pixel's border
    same = index == np.where(expected >= 0, seen[expected], -1)
    assert same.mean() > 0.99
    assert (depth[index >= 0] >= 0.1).all()


def test_equally_near_points_go_to_the_first_and_order_changes_nothing_else(cloud, rng):
    twice = np.vstack([cloud, cloud])
    index, depth = nearest_points(twice, PLAIN)
    assert index.max() < len(cloud)
    order = rng.permutation(len(cloud))
    _, permuted = nearest_points(cloud[order], PLAIN)
    np.testing.assert_array_equal(permuted, depth)


def test_utm_coordinates_show_the_same_picture(rng):
    cloud = rng.random((4000, 3)) * [30, 10, 4]
    offset = np.array([431_000.0, 4_583_000.0, 70.0])
    colours = rng.integers(0, 256, (4000, 3), dtype=np.uint8)
    pictures = [render_points(c, colours, birds_eye_view(c, width=160)) for c in (cloud, cloud + offset)]
    assert (pictures[0] != pictures[1]).mean() < 0.01


def test_splats_grow_with_closeness_up_to_the_limit():
    view = look_at([0, 0, 0], [0, 1, 0], size=(101, 101), field_of_view=90.0)
    seen = [
        (nearest_points(np.array([[0.0, distance, 0.0]]), view, splat_metres=1.0, largest_splat=9)[0] >= 0).sum()
        for distance in (2.0, 10.0, 50.0)
    ]
    assert seen == [81, 25, 1]


def test_a_point_at_the_border_paints_only_what_is_inside():
    index, _ = nearest_points(np.array([[-20.0, -15.0, 0.0]]), PLAIN, splat_metres=3.0)
    assert (index >= 0).sum() == 4
    assert index[0, 0] == 0


def test_gaps_of_a_surface_close_and_open_ground_stays_open():
    index, depth = np.full((20, 20), -1), np.full((20, 20), np.inf, dtype=np.float32)
    index[4:16:2, 4:16:2] = np.arange(36).reshape(6, 6)
    depth[index >= 0] = 5.0
    closed, closed_depth = close_gaps(index, depth, reach=3)
    assert (closed[6:13, 6:13] >= 0).all()
    assert (closed_depth[6:13, 6:13] == 5).all()
    assert (closed[:4] == -1).all()
    np.testing.assert_array_equal(close_gaps(index, depth, reach=0)[0], index)


def test_background_seen_through_a_surface_is_covered_but_not_a_step_within_it():
    index, depth = np.zeros((9, 9), dtype=np.int64), np.full((9, 9), 5.0, dtype=np.float32)
    index[4, 4], depth[4, 4] = 1, 9.0
    closed, closed_depth = close_gaps(index, depth, reach=2)
    assert (closed[4, 4], closed_depth[4, 4]) == (0, 5.0)
    depth[4, 4] = 5.2
    assert close_gaps(index, depth, reach=2)[0][4, 4] == 1


def test_shading_darkens_what_lies_behind_an_edge_and_nothing_else():
    depth = np.full((20, 40), 10.0, dtype=np.float32)
    depth[:, :20] = 5.0
    depth[:, 38:] = np.inf
    shade = depth_shading(depth, PLAIN)
    assert (shade[:, 20] < 0.8).all()
    assert (shade[:, :20] == 1).all()
    assert (shade[:, 30:] == 1).all()


def test_flat_colours_are_kept_and_oversampling_averages():
    index = np.array([[0, 0], [0, -1]])
    paint = np.array([[100, 0, 0]], dtype=np.uint8)
    one = np.ones((2, 2), dtype=np.float32)
    picture = shaded_picture(index, one, paint, oversampling=2)
    np.testing.assert_array_equal(picture, [[[139, 64, 64]]])
    np.testing.assert_array_equal(shaded_picture(index, one, paint)[0, 0], [100, 0, 0])


def test_render_is_repeatable_and_leaves_its_input_alone(cloud, rng):
    colours = rng.integers(0, 256, cloud.shape, dtype=np.uint8)
    before = cloud.copy(), colours.copy()
    pictures = [render_points(cloud, colours, PLAIN) for _ in range(2)]
    np.testing.assert_array_equal(*pictures)
    assert pictures[0].shape == (30, 40, 3)
    np.testing.assert_array_equal(cloud, before[0])
    np.testing.assert_array_equal(colours, before[1])


def test_no_points_give_a_white_picture():
    picture = render_points(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), PLAIN)
    assert (picture == 255).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: nearest_points(np.zeros((1, 2)), PLAIN), r"shape \(n, 3\)"),
        (lambda: nearest_points(np.array([[0, 0, np.inf]]), PLAIN), "NaN or infinite"),
        (lambda: render_points(np.zeros((1, 3)), np.zeros((2, 3), np.uint8), PLAIN), r"shape \(1, 3\)"),
    ],
)
def test_what_cannot_be_painted_is_named(call, message):
    with pytest.raises(DataError, match=message):
        call()
