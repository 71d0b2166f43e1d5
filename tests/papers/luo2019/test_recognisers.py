"""Baselines of JointNet: separation of planted shapes, models as arrays, error messages."""

import numpy as np
import pytest
import torch

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.papers.luo2019.descriptors.recognisers import (
    HierarchyRecogniser,
    ShotRecogniser,
    SpinImageRecogniser,
)
from mlsroad_pipeline.papers.luo2019.pointnet.parameters import PointNetParameters
from mlsroad_pipeline.papers.luo2019.pointnet.recogniser import PointNet, PointNetRecogniser
from mlsroad_pipeline.papers.shared.recognition.descriptor_machine import DescriptorParameters

MACHINE = DescriptorParameters(radii=[0.0, 3.0], costs=[10.0], gammas=[0.003, 0.01], n_folds=2)
NETWORK = PointNetParameters(n_points=32, widths=[16, 16, 32], hidden=[16, 16], epochs=25, learning_rate=0.01)
RECOGNISERS = {
    "spin_image": (SpinImageRecogniser, MACHINE),
    "shot": (ShotRecogniser, MACHINE),
    "hierarchy_descriptor": (HierarchyRecogniser, MACHINE),
    "pointnet": (PointNetRecogniser, NETWORK),
}
every = pytest.mark.parametrize("slug", RECOGNISERS)


def shapes(rng, n):
    """Poles, plates and balls, 40 points each, standing anywhere."""
    objects = []
    for _ in range(n):
        ball = rng.normal(size=(40, 3))
        pole, plate = rng.normal(size=(40, 3)) * [0.05, 0.05, 1.0], rng.normal(size=(40, 3)) * [1.0, 1.0, 0.05]
        objects += [pole, plate, ball / np.linalg.norm(ball, axis=1, keepdims=True)]
    return [p + rng.uniform(-50, 50, 3) for p in objects], np.array(["pole", "plate", "ball"] * n)


@every
def test_planted_shapes_are_told_apart_and_models_survive(slug, rng):
    kind, parameters = RECOGNISERS[slug]
    objects, classes = shapes(rng, 14)
    fresh, truth = shapes(rng, 6)
    found = kind(parameters).fit(objects, classes)
    probabilities = found.predict_proba(fresh)
    assert (found.classes_[probabilities.argmax(axis=1)] == truth).mean() > 0.85
    np.testing.assert_allclose(probabilities.sum(axis=1), 1.0, atol=1e-5)
    again = kind.from_arrays(found.to_arrays(), parameters)
    assert again.predict_proba(fresh).tobytes() == probabilities.tobytes()
    assert kind(parameters).fit(objects, classes).predict_proba(fresh).tobytes() == probabilities.tobytes()
    other = {**found.to_arrays(), "classes": np.array(["ball", "pole"])}
    with pytest.raises(DataError, match="2 classes|not 2"):
        kind.from_arrays(other, parameters)
    with pytest.raises(DataError, match="lack"):
        kind.from_arrays({}, parameters)


@every
def test_bad_objects_and_few_points(slug, rng):
    kind, parameters = RECOGNISERS[slug]
    objects, classes = shapes(rng, 4)
    found = kind(parameters).fit(objects, classes)
    for n in (1, 2, 5):
        probabilities = found.predict_proba([np.full((n, 3), 3.0), rng.normal(size=(n, 3))])
        assert np.isfinite(probabilities).all() and probabilities.shape == (2, 3)
    assert found.predict_proba([]).shape == (0, 3)
    with pytest.raises(DataError, match=r"object 1 .*got 0"):
        found.predict_proba([objects[0], np.zeros((0, 3))])
    with pytest.raises(DataError, match="object 0 has 1 points with NaN"):
        found.predict_proba([np.array([[0, np.nan, 0]])])
    with pytest.raises(DataError, match=f"{slug} needs objects of at least two classes"):
        kind(parameters).fit(objects, ["pole"] * len(objects))


def test_lengths_of_the_descriptors_are_the_papers(rng):
    objects, _ = shapes(rng, 1)
    assert HierarchyRecogniser.describe_objects(objects, 0.0).shape == (3, 100)
    assert SpinImageRecogniser.describe_objects(objects, 0.0).shape == (3, 153)
    assert ShotRecogniser.describe_objects(objects, 0.0).shape == (3, 352)
    whole = SpinImageRecogniser.describe_objects(objects, 0.0)
    np.testing.assert_allclose(whole.sum(axis=1), 1.0, atol=1e-5)  # no point is outside
    turned = [p @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]).T for p in objects]
    np.testing.assert_allclose(SpinImageRecogniser.describe_objects(turned, 0.0), whole, atol=1e-4)


def test_pointnet_starts_with_transforms_that_change_nothing_and_does_not_mind_order(rng):
    net = PointNet(NETWORK, 4).eval()
    points = torch.from_numpy(rng.normal(size=(5, 3, 32)).astype(np.float32))
    torch.testing.assert_close(net.input_transform(points), torch.eye(3).expand(5, 3, 3))
    scores, matrix = net(points)
    torch.testing.assert_close(matrix, torch.eye(64).expand(5, 64, 64))
    torch.testing.assert_close(net(points[:, :, torch.randperm(32)])[0], scores, atol=1e-5, rtol=1e-4)
    assert scores.shape == (5, 4)


def test_parameters_out_of_range_are_named():
    with pytest.raises(ParameterError, match=r"radii .*got .-1"):
        DescriptorParameters(radii=[-1.0])
    with pytest.raises(ParameterError, match="costs must be numbers > 0"):
        DescriptorParameters(costs=[0.0])
    with pytest.raises(ParameterError, match="widths must be 3 numbers"):
        PointNetParameters(widths=[64])
    with pytest.raises(ParameterError, match=r"device .*got 'tpu'"):
        PointNetRecogniser(PointNetParameters(device="tpu")).fit(*shapes(np.random.default_rng(1), 2))
