import numpy as np
import pytest
from conftest import REPOSITORY
from helpers.yaml_files import read_yaml

from mlsroad_pipeline.algorithms.cameras.cityscapes import (
    CITYSCAPES,
    encode_label_image,
    image_classes,
    point_probabilities,
    segmentation_table,
)
from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError


@pytest.fixture(scope="module")
def scheme():
    given = read_yaml(REPOSITORY / "conf" / "base" / "parameters_classes.yml")
    return ClassScheme.from_config("tomic2019", given["classes"]["schemes"]["tomic2019"])


def test_nineteen_classes_become_the_ten_of_the_paper(scheme):
    assert len(CITYSCAPES) == 19 and len({category for category, _ in CITYSCAPES.values()}) == 7
    eye = point_probabilities(np.eye(19), list(CITYSCAPES), scheme)
    becomes = dict(zip(CITYSCAPES, (scheme.classes[k] for k in eye.argmax(axis=1)), strict=True))
    read = {
        "wall": "hard scape",
        "fence": "man-made object",
        "rider": "human",
        "motorcycle": "bicycle",
        "train": "vehicle",
    }
    assert {name: becomes[name] for name in read} == read
    assert {name for name in becomes.values()} == set(scheme.classes)  # the sky's row is even and counts for the first
    np.testing.assert_allclose(eye[10], 0.1)


def test_probabilities_of_one_class_are_summed_and_the_sky_left_out(scheme):
    given = np.zeros((1, 19))
    given[0, [0, 1, 10, 13]] = [0.2, 0.1, 0.5, 0.2]  # road, sidewalk, sky, car
    out = point_probabilities(given, list(CITYSCAPES), scheme)
    assert out[0, scheme.labels_of(["man-made terrain", "vehicle"])].tolist() == pytest.approx([0.6, 0.4])
    own = np.concatenate([np.full((1, 10), 0.05), [[0.5]]], axis=1)
    np.testing.assert_allclose(point_probabilities(own, image_classes(scheme), scheme), 0.1, atol=1e-6)


def test_label_images_have_the_sky_last(scheme):
    codes = np.array([[0, TAXONOMY["road"]], [TAXONOMY["outlier"], TAXONOMY["person"]]])
    assert encode_label_image(codes, scheme).tolist() == [[10, 0], [-1, 9]]


def test_iou_is_that_of_the_formula_and_means_run_over_what_is_present():
    matrix = np.array([[6, 2, 0, 0], [1, 3, 0, 0], [0, 0, 0, 0]])
    table = segmentation_table(matrix, ["a", "b", "c"], ["x", "x", "y"]).set_index(["kind", "name"])
    assert table["iou"]["class"].tolist()[:2] == pytest.approx([6 / 9, 3 / 6]) and np.isnan(table["iou"]["class", "c"])
    assert table["iou"]["class", "mean"] == pytest.approx((6 / 9 + 3 / 6) / 2)
    assert table["iou"]["category", "x"] == 1 and table["iou"]["category", "mean"] == 1
    assert table["pixels"]["class"].tolist() == [8, 4, 0, 12]


def test_what_does_not_fit_is_named(scheme):
    with pytest.raises(DataError, match=r"shape \(n, 2\), got \(3, 4\)"):
        point_probabilities(np.ones((3, 4)), ["a", "b"], scheme)
    with pytest.raises(ParameterError, match="image class 'a' is neither"):
        point_probabilities(np.ones((3, 2)), ["a", "sky"], scheme)
    with pytest.raises(DataError, match=r"must have shape \(2, 3\), got \(2, 2\)"):
        segmentation_table(np.ones((2, 2), int), ["a", "b"])
