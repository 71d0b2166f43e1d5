"""Labelling of points by a trained model."""

import sys
import types

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import label_cloud

MODULE = "mlsroad_pipeline.algorithms.planted_labeller"
METADATA = {"entry_point": f"{MODULE}:label", "classes": ["ground", "object"]}


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
    return module


def test_the_named_function_labels_the_cloud(bundle, labeller):
    cloud = PointCloud(np.array([[0, 0, 0.0], [0, 0, 1.0]]))
    labels, confidence = label_cloud(bundle, cloud)
    assert labels.dtype == np.int16
    assert confidence.dtype == np.float32
    np.testing.assert_array_equal(labels, [0, 1])


def test_a_model_of_another_version_of_the_package_says_what_is_missing(bundle, labeller):
    cloud = PointCloud(np.zeros((1, 3)))
    with pytest.raises(ParameterError, match=f"needs {MODULE}:gone, which this version lacks"):
        label_cloud(ModelBundle("planted", {}, {**METADATA, "entry_point": f"{MODULE}:gone"}), cloud)
    missing = "mlsroad_pipeline.algorithms.no_such_module:label"
    with pytest.raises(ParameterError, match=f"needs {missing}"):
        label_cloud(ModelBundle("planted", {}, {**METADATA, "entry_point": missing}), cloud)


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
