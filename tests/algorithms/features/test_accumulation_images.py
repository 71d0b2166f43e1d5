"""Accumulation images against their definition, in closed form, and under what must not change them."""

import numpy as np
import pytest
from references.accumulation import images, normalised

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.features.accumulation_images import compute_images, concatenate_objects

SIZES = (16, 8, 16)


@pytest.fixture
def objects(rng):
    stretch = rng.uniform(0.2, 6.0, (6, 3))
    return [rng.normal(size=(n, 3)) * s for n, s in zip((400, 50, 13, 3, 2, 1), stretch, strict=True)]


@pytest.mark.parametrize("sizes", [SIZES, (5, 3, 2), (1, 1, 1)])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"isotropic": True},
        {"relative": False},
        {"window": (2.0, 4.0)},
        {"bilinear": True},
        {"printed": True},
    ],
)
def test_images_follow_the_definition(objects, sizes, options):
    found = compute_images(objects, sizes=sizes, **options)
    for i, points in enumerate(objects):
        for image, wanted in zip(found, images(points, sizes, **options), strict=True):
            np.testing.assert_allclose(image[i], wanted, rtol=1e-5, atol=1e-7)
    assert [image.shape for image in found] == [(6, 5, size, size) for size in sizes]


def test_rows_of_equation_4_leave_half_of_the_image_empty(objects):
    image = compute_images(objects[:2], printed=True)[0]
    assert not image[:, :, :8].any() and image[:, :, 8:].sum(axis=(2, 3))[:, 0] == pytest.approx(np.ones(2))


def test_a_pole_a_plate_and_a_ring():
    z = np.linspace(0, 8, 1601)[:-1]
    pole = np.column_stack([np.zeros((1600, 2)), z])
    hssi, vqai, vaai = compute_images([pole])
    np.testing.assert_allclose(
        hssi[0, :, :, 0], np.vstack([[np.full(16, 1 / 16)], np.full((4, 16), 1 / 64)]), atol=0.002
    )
    assert vqai[0, 0, 4, 4] == pytest.approx(1.0) and vaai[0, 0, 8, 8] == pytest.approx(1.0)
    np.testing.assert_allclose(vqai[0, 1:, 4, 4], 0.25, atol=0.002)
    angle = np.arange(3600) * np.pi / 1800 + 1e-4
    ring = np.column_stack([3 * np.cos(angle), 5 * np.sin(angle), np.full(3600, 2.0)])
    hssi, vqai, vaai = compute_images([ring])
    assert hssi[0, 0, 8, 7:9].sum() == pytest.approx(1.0)  # the middle height, at a distance of 1
    assert vaai[0, 0].sum() == pytest.approx(2 / np.sqrt(5), abs=1e-4)  # from (0, 0, -1) to (1, 0, 1)
    assert vaai[0, 3].sum() == pytest.approx(1 / np.sqrt(2), abs=1e-4)  # the ring is the floor of its slice
    np.testing.assert_allclose(vqai[0, 0], vqai[0, 0].T, atol=0.002)


def test_slices_add_up_and_angles_are_cosines(objects):
    hssi, vqai, vaai = compute_images(objects)
    np.testing.assert_allclose(vqai[:, 1:].sum(axis=1), vqai[:, 0], atol=1e-6)
    for image in (hssi, vqai):
        np.testing.assert_allclose(image[:, 0].sum(axis=(1, 2)), 1.0, atol=1e-5)
    assert vaai.min() >= 0 and (vaai[:, 0].sum(axis=(1, 2)) <= 1.0).all()
    np.testing.assert_allclose(hssi[:, 1:].sum(axis=(2, 3)), vqai[:, 1:].sum(axis=(2, 3)), atol=1e-6)


def test_moving_scaling_and_shuffling_change_nothing(objects, rng):
    one = compute_images(objects)
    moved = [points * [2.0, 0.5, 4.0] + [512.0, 4096.0, 64.0] for points in objects]
    shuffled = [points[rng.permutation(len(points))] for points in objects]
    for changed in (moved, shuffled):
        for image, other in zip(one, compute_images(changed), strict=True):
            assert np.abs(image - other).sum() <= 0.01 * image.sum()  # a point at a border may fall to either side


def test_a_quarter_turn_turns_the_images_from_above(objects):
    hssi, vqai, vaai = compute_images(objects)
    turned = compute_images([np.column_stack([-p[:, 1], p[:, 0], p[:, 2]]) for p in objects])
    np.testing.assert_allclose(turned[0], hssi, atol=1e-6)
    for image, other in ((vqai, turned[1]), (vaai, turned[2])):
        np.testing.assert_allclose(other[:3], np.swapaxes(image, 2, 3)[:3, :, ::-1], atol=1e-6)


def test_weights_count(objects):
    heavy = [np.repeat(p, 3, axis=0) for p in objects]
    wanted = compute_images(heavy, relative=False)
    found = compute_images(objects, weights=[np.full(len(p), 3.0) for p in objects], relative=False)
    for image, other in zip(found, wanted, strict=True):
        np.testing.assert_allclose(image, other, rtol=1e-6)
    with pytest.raises(DataError, match=r"weights of object 1 .*got \(3,\)"):
        compute_images(objects[:2], weights=[np.ones(400), np.ones(3)])
    with pytest.raises(DataError, match="weights of object 1 has inf"):
        compute_images(objects[:2], weights=[np.ones(400), np.full(50, np.inf)])
    with pytest.raises(DataError, match="weights are given for 1 of 2 objects"):
        compute_images(objects[:2], weights=[np.ones(400)])


def test_isotropic_keeps_proportions():
    box = np.array([[0, 0, 0], [1, 2, 4.0]])
    np.testing.assert_allclose(normalised(box, isotropic=True), [[-0.25, -0.5, 0], [0.25, 0.5, 2]])
    assert np.argwhere(compute_images([box], isotropic=True)[1][0, 0]).tolist() == [[3, 2], [5, 6]]
    assert np.argwhere(compute_images([box])[1][0, 0]).tolist() == [[0, 0], [7, 7]]


def test_a_window_shows_size_and_keeps_what_is_outside_at_its_edge():
    z = np.linspace(0, 2.999, 300)
    low, high = (np.column_stack([np.full((300, 2), 7.0), 50 + factor * z]) for factor in (1.0, 2.0))
    hssi, vqai, _ = compute_images([low, high], window=(2.0, 4.0))
    rows = hssi[:, 0, :, 0]
    assert (rows[0, :12] > 0).all() and (rows[0, 12:] == 0).all()  # 3 m are three quarters of the height
    assert rows[1, :15] == pytest.approx(1 / 24, abs=0.004) and rows[1, 15] == pytest.approx(9 / 24, abs=0.004)
    np.testing.assert_allclose(vqai[:, 0, 4, 4], 1.0, rtol=1e-5)
    wide = np.array([[-5.0, 0, 0], [5.0, 0, 0], [0.4, 0, 0]])
    for image in compute_images([wide], window=(2.0, 4.0))[1:]:
        size = image.shape[-1]
        assert np.argwhere(image[0, 0]).T[0].tolist() == [0, int(2.4 * size / 4), size - 1]
    boxes = [np.array([[0, 0, 0], [1, 2, 4.0]]), np.array([[0, 0, 0], [2, 4, 8.0]])]
    stretched = compute_images(boxes)
    np.testing.assert_array_equal(stretched[1][0], stretched[1][1])  # without a window size is not seen
    for window in ((0.0, 4.0), (2.0, np.inf), (np.nan, 4.0)):
        with pytest.raises(ParameterError, match="window must be two lengths above 0"):
            compute_images(boxes, window=window)


def test_a_point_can_be_shared_between_the_cells_around_it(objects, rng):
    options = {"window": (2.0, 4.0), "bilinear": True}
    ends = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 3.9]])  # the middle of the box is at 0
    inner = [np.vstack([ends, [[0.1, 0.35, 1.1]]]), np.vstack([ends, [[0.1, 0.35, 1.1]] * 2])]
    one, two = (compute_images([points], relative=False, **options)[1][0, 0] for points in inner)
    wanted = np.zeros((8, 8))
    wanted[3:5, 4:6] = np.outer([0.3, 0.7], [0.8, 0.2])  # 4.2 and 4.7 cells of half a metre; centres at 3.5, 4.5, 5.5
    np.testing.assert_allclose(two - one, wanted, atol=1e-6)
    for image in compute_images(objects, **options)[:2]:
        np.testing.assert_allclose(image[:, 0].sum(axis=(1, 2)), 1.0, atol=1e-5)
    moved = [points + rng.normal(0, 1e-6, points.shape) for points in objects]  # little changes little at any border
    for image, other in zip(compute_images(objects, **options), compute_images(moved, **options), strict=True):
        np.testing.assert_allclose(image[:, 0], other[:, 0], atol=1e-4)


def test_points_that_are_all_alike_lie_in_the_middle():
    for n in (1, 2, 40):
        hssi, vqai, vaai = compute_images([np.full((n, 3), 7.25)])
        assert np.argwhere(hssi[0] > 0).tolist() == [[0, 8, 0], [3, 0, 0]]
        assert np.argwhere(vqai[0] > 0).tolist() == [[0, 4, 4], [3, 4, 4]]
        assert vaai[0, 0, 8, 8] == pytest.approx(1.0)


def test_threads_types_and_no_objects(objects):
    one = compute_images(objects)
    for other in (compute_images(objects, n_threads=2), compute_images([p.tolist() for p in objects])):
        assert [image.tobytes() for image in one] == [image.tobytes() for image in other]
    single = [p.astype(np.float32) for p in objects]
    assert all(image.dtype == np.float32 for image in compute_images(single))
    assert [image.shape for image in compute_images([])] == [(0, 5, 16, 16), (0, 5, 8, 8), (0, 5, 16, 16)]


def test_bad_objects_are_named(objects):
    broken = objects[0].copy()
    broken[7, 1] = np.nan
    with pytest.raises(DataError, match="object 1 has 1 points with NaN or infinite coordinates, the first at row 7"):
        compute_images([objects[1], broken])
    with pytest.raises(DataError, match=r"object 2 .*got 0"):
        compute_images([*objects[:2], np.zeros((0, 3))])
    with pytest.raises(DataError, match=r"object 0 .*got \(4, 2\)"):
        concatenate_objects([np.zeros((4, 2))])
    with pytest.raises(ParameterError, match=r"sizes .*got \(16, 0, 16\)"):
        compute_images(objects, sizes=(16, 0, 16))
