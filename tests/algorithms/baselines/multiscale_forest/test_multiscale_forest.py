"""Labels of small streets: another street, missing attributes, outliers, storage, balanced samples."""

from dataclasses import replace

import numpy as np
import pytest
from references.patches import SCHEME, street

from mlsroad_pipeline.algorithms.baselines.multiscale_forest.labeller import label_scene, spheres_of
from mlsroad_pipeline.algorithms.baselines.multiscale_forest.parameters import SLUG, MultiscaleForestParameters
from mlsroad_pipeline.algorithms.baselines.multiscale_forest.training import fit, training_spheres
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import label_cloud

QUICK = MultiscaleForestParameters(n_trees=15, n_scales=5, max_per_scene=300, max_features=0.2)


def spheres(cloud, parameters=QUICK):
    return training_spheres(cloud, parameters, scheme=SCHEME)


@pytest.fixture(scope="module")
def model():
    return fit(
        [spheres(street(seed)) for seed in (0, 1)], parameters=QUICK, scheme=SCHEME, trained_on={"survey": "street"}
    )


def right(model, cloud):
    truth = SCHEME.encode(cloud["label"], source="street")
    labels, confidence = label_cloud(model, cloud)
    assert labels.dtype == np.int16 and confidence.dtype == np.float32
    assert 0 < confidence.min() <= confidence.max() <= 1
    return (labels == truth).mean()


def test_another_street_is_labelled_with_and_without_colour(model):
    cloud = street(5)
    assert model.metadata["attributes"] == ["rgb"]
    assert right(model, cloud) > 0.97
    grey = replace(cloud, columns={**cloud.columns, "rgb": np.full((len(cloud), 3), 90, np.uint8)})
    assert right(model, street(5, colour=False)) == right(model, grey) > 0.95


def test_classes_without_training_points_are_never_predicted(model):
    vehicle = SCHEME.classes.index("vehicle")
    assert vehicle not in model.arrays["trained_classes"]
    assert (label_cloud(model, street(5))[0] != vehicle).all()


def test_the_model_survives_storage_and_jobs(model):
    cloud = street(5)
    stored = ModelBundle(SLUG, {name: np.array(a) for name, a in model.arrays.items()}, dict(model.metadata))
    for first, second in zip(label_cloud(model, cloud), label_cloud(stored, cloud), strict=True):
        np.testing.assert_array_equal(first, second)
    again = fit([spheres(street(seed)) for seed in (0, 1)], parameters=QUICK, scheme=SCHEME, trained_on={}, n_jobs=2)
    for name, array in model.arrays.items():
        np.testing.assert_array_equal(again.arrays[name], array)


def test_points_of_a_voxel_share_their_label(model):
    cloud = street(5)
    labels = label_scene(cloud, model)
    pyramid = spheres_of(cloud, QUICK)
    for name in ("label", "confidence"):
        of_voxel = np.full(len(pyramid), np.nan)
        of_voxel[pyramid.owner] = labels[name]
        np.testing.assert_array_equal(of_voxel[pyramid.owner], labels[name])


def test_blocks_of_voxels_do_not_matter(model, monkeypatch):
    cloud = street(5)
    expected = label_cloud(model, cloud)
    monkeypatch.setattr("mlsroad_pipeline.algorithms.baselines.multiscale_forest.labeller._BLOCK", 1000)
    for first, second in zip(expected, label_cloud(model, cloud), strict=True):
        np.testing.assert_array_equal(first, second)


def test_outliers_get_no_class_and_change_nothing(model):
    cloud = street(5)
    labels, confidence = label_cloud(model, cloud)
    n = 5
    noisy = PointCloud(
        np.concatenate([cloud.xyz, cloud.xyz[:n] + 40]),
        {**{name: np.concatenate([v, v[:n]]) for name, v in cloud.columns.items()},
         "outlier": np.arange(len(cloud) + n) >= len(cloud)},
    )  # fmt: skip
    found, sure = label_cloud(model, noisy)
    assert (found[-n:] == -1).all() and not sure[-n:].any()
    np.testing.assert_array_equal(found[:-n], labels)
    np.testing.assert_array_equal(sure[:-n], confidence)
    all_out = noisy.with_columns(outlier=np.ones(len(noisy), bool))
    assert (label_cloud(model, all_out)[0] == -1).all() and len(spheres(all_out)["labels"]) == 0


def test_nan_intensities_count_as_the_median_or_as_none():
    cloud = street(5)
    values = np.linspace(0, 1, len(cloud)).astype(np.float32)
    holes = np.where(np.arange(len(cloud)) % 7 == 0, np.float32(np.nan), values)
    filled = np.where(np.isnan(holes), np.nanmedian(holes), holes)
    some = np.arange(20)
    found, expected = (spheres_of(cloud.with_columns(intensity=v), QUICK).describe(some) for v in (holes, filled))
    np.testing.assert_array_equal(found, expected)
    unknown = cloud.with_columns(intensity=np.full(len(cloud), np.nan, np.float32))
    np.testing.assert_array_equal(spheres_of(unknown, QUICK).describe(some), spheres_of(cloud, QUICK).describe(some))


@pytest.mark.parametrize("n", [0, 1, 3])
def test_tiny_clouds(model, n):
    cloud = PointCloud(np.arange(3.0 * n).reshape(n, 3), {"rgb": np.zeros((n, 3), np.uint8)})
    labels, confidence = label_cloud(model, cloud)
    assert len(labels) == len(confidence) == n and (labels >= 0).all() and (confidence > 0).all()


def test_voxels_per_class_are_bounded_and_labels_outside_the_core_unused(model):
    cloud = street(5)
    drawn = spheres(cloud, replace(QUICK, max_per_scene=20))
    assert np.unique_counts(drawn["labels"])[1].tolist() == [20, 20, 20]
    few = fit(
        [spheres(street(seed)) for seed in (0, 1)],
        parameters=replace(QUICK, max_per_class=50), scheme=SCHEME, trained_on={},
    )  # fmt: skip
    assert few.metadata["trained_on"]["voxels"] == 150 and model.metadata["trained_on"]["voxels"] == 1800
    outside = cloud.with_columns(core=np.zeros(len(cloud), bool))
    assert len(spheres(outside)["labels"]) == 0


def test_a_single_class_and_an_empty_split_are_refused():
    cloud = street(0)
    one = spheres(cloud.select(np.flatnonzero(cloud["label"] == cloud["label"][0])))
    for scenes, message in (([one], "of 1 classes"), ([], "no training scenes: the split 'train' is empty")):
        with pytest.raises(DataError, match=message):
            fit(scenes, parameters=QUICK, scheme=SCHEME, trained_on={})


@pytest.mark.parametrize(
    "values", [{"radius": -1}, {"n_trees": 0}, {"max_features": 0}, {"dropout": 1}, {"points_per_radius": 0.5}]
)
def test_parameters_outside_their_domain_are_refused(values):
    with pytest.raises(ParameterError, match=f"multiscale_forest.{next(iter(values))}"):
        MultiscaleForestParameters(**values)
