"""Labelling of points by a trained model."""

import sys
import types

import numpy as np
import pytest
from helpers.planted_method import plant_method

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import label_cloud, label_softly

MODULE = "mlsroad_pipeline.algorithms.planted_labeller"
METADATA = {"classes": ["ground", "object"]}


@pytest.fixture
def bundle():
    return ModelBundle("planted", {"threshold": np.array([0.5])}, METADATA)


@pytest.fixture
def labeller(monkeypatch):
    """Plant a module below the package whose function may be replaced."""
    module = types.ModuleType(MODULE)
    module.label = lambda cloud, bundle: (
        (cloud.xyz[:, 2] > bundle.arrays["threshold"][0]).astype(int),
        np.ones(len(cloud)),
    )
    monkeypatch.setitem(sys.modules, MODULE, module)
    plant_method(monkeypatch, "planted", f"{MODULE}:label")
    return module


def test_the_function_of_the_method_labels_the_cloud(bundle, labeller):
    cloud = PointCloud(np.array([[0, 0, 0.0], [0, 0, 1.0]]))
    labels, confidence = label_cloud(bundle, cloud)
    assert labels.dtype == np.int16
    assert confidence.dtype == np.float32
    np.testing.assert_array_equal(labels, [0, 1])


@pytest.mark.parametrize("function", [label_cloud, label_softly])
def test_a_model_of_an_unknown_method_is_named_in_one_line(function):
    registered = {"name": "mlsroad-gone", "version": 3, "run_id": "r"}
    bundle = ModelBundle("gone", {}, {**METADATA, "registered": registered})
    with pytest.raises(ParameterError) as error:
        function(bundle, PointCloud(np.zeros((1, 3))))
    message = str(error.value)
    assert message.startswith("model 'mlsroad-gone 3': unknown method 'gone' (known: detrended_forest, ")
    assert message.endswith("kedro run --pipelines=SLUG") and len(message.splitlines()) == 1


def test_an_import_path_that_a_model_of_another_version_stored_is_not_used(bundle, labeller):
    paths = {"entry_point": "mlsroad_pipeline.algorithms.no_such_module:label", "soft_entry_point": "os:system"}
    stored = ModelBundle(bundle.slug, bundle.arrays, {**METADATA, **paths})
    assert label_softly(stored, PointCloud(np.array([[0, 0, 1.0]]))).labels.tolist() == [1]


@pytest.mark.parametrize(
    ("result", "message"),
    [
        ((np.zeros(3, int), np.zeros(3)), r"labels \(3,\) and confidences \(3,\) for the 2 points of street.laz"),
        ((np.array([0, 2]), np.zeros(2)), r"labels 0..2 of 2 classes"),
        ((np.array([-2, 0]), np.zeros(2)), r"labels -2..0 of 2 classes"),
    ],
)
def test_wrong_results_of_a_model_are_named(bundle, labeller, result, message):
    labeller.label = lambda cloud, model: result
    with pytest.raises(DataError, match=message):
        label_cloud(bundle, PointCloud(np.zeros((2, 3)), source="street.laz"))
