import numpy as np
import pytest

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.papers.tomic2019.fusion.two_methods import best_labels
from mlsroad_pipeline.papers.tomic2019.image_labels.labeller import label_through_images

AXES = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])


def looking_along_x(place):
    k = [[100.0, 0, 49.5], [0, 100.0, 39.5], [0, 0, 1]]
    return Camera(k, None, AXES, -AXES @ np.array(place, dtype=float), 100, 80)


def wall(x, y, step=0.04):
    across, up = np.meshgrid(np.arange(*y, step), np.arange(-1.5, 1.5, step))
    return np.column_stack([np.full(across.size, x), across.ravel(), up.ravel()])


def halves(left, right, height=80, width=100):
    """Probabilities that are one-hot: one class left of the image's middle, another right of it."""
    out = np.zeros((height, width, 3), dtype=np.float32)
    out[:, : width // 2, left] = out[:, width // 2 :, right] = 1
    return out


def test_points_take_the_class_of_their_pixel_and_hidden_ones_take_none():
    front, back = wall(6.0, (-2, 0)), wall(9.0, (-2.5, 2.5))  # the image's right half is the front wall, y below 0
    xyz = np.concatenate([front, back])
    found = label_through_images(
        xyz, [("a", looking_along_x([0, 0, 0]), halves(1, 2))], groups=["a", "b"], n_classes=3
    )  # fmt: skip
    labels = best_labels(found.probabilities)
    assert (labels[0, : len(front)] == 2)[front[:, 1] < -0.05].all()
    shadow = (back[:, 1] < -0.1) & (back[:, 1] > -2.8)
    assert (labels[0, len(front) :][shadow] == -1).all()
    free = back[:, 1] > 0.1
    assert (labels[0, len(front) :][free] == 1).all() and (labels[1] == -1).all()
    assert (
        np.isnan(found.probabilities[1]).all()
        and (np.nan_to_num(found.probabilities[0]).max(axis=1) == (labels[0] >= 0)).all()
    )


def test_images_of_one_camera_are_averaged_and_counted():
    xyz = wall(8.0, (-2, 2))
    images = [("a", looking_along_x([x, 0, 0]), halves(*pair)) for x, pair in ((0, (0, 0)), (1, (0, 0)), (2, (1, 1)))]
    images.append(("b", looking_along_x([0, 0, 0]), halves(2, 2)))
    found = label_through_images(xyz, images, groups=["a", "b"], n_classes=3)
    assert (found.n_images[0] == 3).all() and (found.n_images[1] == 1).all()
    np.testing.assert_allclose(found.probabilities[0], [[2 / 3, 1 / 3, 0]] * len(xyz), atol=1e-6)
    np.testing.assert_allclose(found.pooled(), [[2 / 4, 1 / 4, 1 / 4]] * len(xyz), atol=1e-6)
    assert (best_labels(found.probabilities) == [[0], [2]]).all()


def test_a_survey_without_images_labels_nothing():
    found = label_through_images(wall(8.0, (-1, 1)), [], groups=["a"], n_classes=3)
    assert (best_labels(found.probabilities) == -1).all() and np.isnan(found.pooled()).all()


def test_images_that_show_no_labelled_point_are_not_segmented():
    """Points beside the image, hidden points and occluders alone cost no segmentation."""
    asked = []

    def segmented(name):
        asked.append(name)
        return halves(1, 2)

    xyz = np.concatenate([wall(8.0, (-2, 2)), wall(4.0, (-4, 4)), wall(-8.0, (-2, 2))])
    n = len(wall(8.0, (-2, 2)))
    behind = Camera([[100.0, 0, 49.5], [0, 100.0, 39.5], [0, 0, 1]], None, AXES * [[-1], [1], [-1]], [0, 0, 0], 100, 80)
    images = [
        ("a", looking_along_x([0, 0, 0]), lambda: segmented("hidden")),
        ("a", behind, lambda: segmented("others alone")),
        ("a", looking_along_x([9, 0, 0]), lambda: segmented("past it")),
        ("a", looking_along_x([5, 0, 0]), lambda: segmented("seen")),
    ]
    found = label_through_images(xyz, images, groups=["a"], n_classes=3, n_labelled=n)
    labels = best_labels(found.probabilities)
    assert asked == ["seen"] and labels.shape == (1, n) and (labels[0] >= 0).any()
    again = label_through_images(xyz, [("a", images[-1][1], halves(1, 2))], groups=["a"], n_classes=3)
    np.testing.assert_array_equal(found.probabilities, again.probabilities[:, :n])


def test_points_farther_than_the_limit_hide_others_but_take_nothing():
    xyz = np.concatenate([wall(6.0, (-2, 0)), wall(9.0, (-2.5, 2.5))])
    image = ("a", looking_along_x([0, 0, 0]), halves(1, 2))
    whole, near = (
        best_labels(label_through_images(xyz, [image], groups=["a"], n_classes=3, max_distance=limit).probabilities)[0]
        for limit in (np.inf, 8.0)
    )
    close = np.linalg.norm(xyz, axis=1) <= 8.0
    assert np.array_equal(near[close], whole[close]) and (near[~close] == -1).all() and (whole[~close] >= 0).any()


def test_images_that_do_not_fit_are_named():
    camera = looking_along_x([0, 0, 0])
    with pytest.raises(DataError, match=r"camera 'c', the survey's cameras are \['a'\]"):
        label_through_images(wall(8.0, (-1, 1)), [("c", camera, halves(0, 1))], groups=["a"], n_classes=3)
    with pytest.raises(DataError, match=r"shape \(80, 100, 3\), got \(60, 100, 3\)"):
        label_through_images(wall(8.0, (-1, 1)), [("a", camera, halves(0, 1, height=60))], groups=["a"], n_classes=3)
