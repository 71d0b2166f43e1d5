import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.papers.tomic2019.image_labels.crops import Crops
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import TrainingParameters


def tagged(n, rng, rare=0.0):
    """Images whose colours say their labels and places: red the row, green the column, blue 10 times the label + 5."""
    out = []
    for k in range(n):
        labels = rng.integers(0, 2, (60, 80))
        if k == 0 and rare:
            labels[40:46, 70:76] = 2
        row, column = np.mgrid[:60, :80]
        out.append((np.stack([row, column, 10 * labels + 5], axis=2).astype(np.uint8), labels.astype(np.int16)))
    return out


def batches(samples, n_classes=3, **parameters):
    how = TrainingParameters(**{"n_steps": 6, "batch_size": 4, "crop": 33, "scale": (1.0, 1.0), **parameters})
    return list(Crops(samples, n_classes, how, (1, 2, 3)).batches(np.random.default_rng(5)))


def test_labels_stay_with_their_pixels(rng):
    seen = set()
    for images, labels in batches(tagged(5, rng), class_crops=0.0):
        assert images.shape == (4, 33, 33, 3) and labels.shape == (4, 33, 33)
        assert np.array_equal(images[..., 2], 10 * labels + 5)
        step = np.diff(images[..., 1].astype(int), axis=2)
        assert (np.abs(step) == 1).all()
        seen.update((step[:, 0, 0] > 0).tolist())
    assert seen == {True, False}  # mirrored and not


def test_small_images_are_filled_up_and_not_learned_there(rng):
    for images, labels in batches(tagged(2, rng), crop=97, flip=False):
        beyond = np.ones((97, 97), dtype=bool)
        beyond[:60, :80] = False
        assert (labels[:, beyond] == -1).all() and (labels[:, ~beyond] >= 0).all()
        assert (images[:, beyond] == [1, 2, 3]).all()


def test_scaled_crops_show_as_much_less_or_more(rng):
    for scale in (0.5, 1.5):
        for images, labels in batches(tagged(4, rng), scale=(scale, scale), crop=30, flip=False):
            inside = images[0, :, 2:-2, 1].astype(float)[5]
            assert np.diff(inside).mean() == pytest.approx(1 / scale, abs=0.06)
            assert set(np.unique(labels)) <= {0, 1}


def test_crops_around_classes_show_them_and_every_class_as_often(rng):
    samples = tagged(40, rng, rare=1.0)
    around = np.concatenate([labels for _, labels in batches(samples, n_steps=60, class_crops=1.0, crop=25)])
    anywhere = np.concatenate([labels for _, labels in batches(samples, n_steps=60, class_crops=0.0, crop=25)])
    shows = [(part == 2).any(axis=(1, 2)).mean() for part in (around, anywhere)]
    assert abs(shows[0] - 1 / 3) < 0.08 and shows[1] < 0.05


def test_shares_leave_out_what_is_not_labelled():
    labels = np.array([[0, 0, 1, -1]] * 4)
    crops = Crops([(np.zeros((4, 4, 3), np.uint8), labels)] * 2, 3, TrainingParameters(), (0, 0, 0))
    np.testing.assert_allclose(crops.shares, [2 / 3, 1 / 3, 0])


def test_every_image_comes_once_before_one_comes_again(rng):
    samples = [(np.full((40, 40, 3), k, np.uint8), np.zeros((40, 40), np.int16)) for k in range(8)]
    seen = np.concatenate([images[:, 5, 5, 0] for images, _ in batches(samples, class_crops=0.0, n_steps=4)])
    assert sorted(seen[:8]) == sorted(seen[8:]) == list(range(8))


def test_image_without_a_label_and_wrong_sizes():
    nothing = [(np.zeros((40, 40, 3), np.uint8), np.full((40, 40), -1))]
    assert all((labels == -1).all() for _, labels in batches(nothing, class_crops=1.0))
    with pytest.raises(DataError, match=r"image 0 has \(40, 40\) pixels, its labels \(40, 41\)"):
        batches([(np.zeros((40, 40, 3), np.uint8), np.zeros((40, 41), np.int16))])
