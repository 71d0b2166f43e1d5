"""Labels of small streets: what is learnt, clouds without intensity, ground or points, outliers and smoothing."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from references.patches import SCHEME
from references.patches import street as plain_street

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import (
    describe_scene,
    label_cloud_softly,
    voxel_probabilities,
)
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import SLUG, BoostedTreesParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.sampling import sample_voxels, training_voxels
from mlsroad_pipeline.algorithms.models.boosted_trees.training import fit
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.algorithms.stages import find_ground

QUICK = BoostedTreesParameters(rounds=15, min_child_samples=5, checkpoint_rounds=15)


def street(seed):
    """Add an intensity that separates the classes in part."""
    cloud = plain_street(seed)
    intensity = (cloud["label"] % 7 + np.random.default_rng(seed).normal(0, 2, len(cloud))).astype(np.float32)
    return replace(cloud, columns={**cloud.columns, "intensity": intensity})


def voxels_of(cloud, parameters=QUICK):
    return training_voxels(cloud, find_ground(cloud, GroundParameters()), parameters=parameters, scheme=SCHEME)


@pytest.fixture(scope="module")
def model():
    return fit(
        [voxels_of(street(seed)) for seed in (0, 1)],
        parameters=QUICK, ground=GroundParameters(), scheme=SCHEME, trained_on={"survey": "street"},
    )  # fmt: skip


def without(cloud, *names):
    return replace(cloud, columns={name: v for name, v in cloud.columns.items() if name not in names})


def test_another_street_is_labelled(model):
    cloud = street(5)
    truth = SCHEME.encode(cloud["label"], source="street")
    labels, confidence = label_cloud(model, cloud)
    assert (labels[truth >= 0] == truth[truth >= 0]).mean() > 0.9
    assert labels.dtype == np.int16 and confidence.dtype == np.float32
    assert 0 < confidence.min() <= confidence.max() <= 1
    blank, _ = label_cloud(model, without(cloud, "intensity"))
    assert (blank[truth >= 0] == truth[truth >= 0]).mean() > 0.8


def test_the_model_survives_storage(model):
    cloud = street(5)
    stored = ModelBundle(SLUG, {name: np.array(a) for name, a in model.arrays.items()}, dict(model.metadata))
    for first, second in zip(label_cloud(model, cloud), label_cloud(stored, cloud), strict=True):
        np.testing.assert_array_equal(first, second)


def test_neither_order_nor_chunks_of_points_matter(model):
    cloud = street(5)
    order = np.random.default_rng(0).permutation(len(cloud))
    labels, confidence = label_cloud(model, cloud)
    mixed, other = label_cloud(model, cloud.select(order))
    assert (mixed == labels[order]).mean() > 0.999
    assert np.median(np.abs(other - confidence[order])) < 1e-6


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


@pytest.mark.parametrize("n", [0, 1, 3])
def test_tiny_clouds(model, n):
    cloud = PointCloud(np.arange(3.0 * n).reshape(n, 3), {"intensity": np.full(n, 0.5, np.float32)})
    labels, confidence = label_cloud(model, cloud)
    assert len(labels) == len(confidence) == n and (labels >= 0).all() and (confidence > 0).all()


def test_heights_without_ground_are_measured_from_the_lowest_point():
    cloud = street(5)
    n = len(cloud)
    none = {"ground": np.zeros(n, bool), "height": np.full(n, np.nan, np.float32)}
    low = (cloud.xyz[:, 2] - cloud.xyz[:, 2].min()).astype(np.float32)
    plain = describe_scene(cloud, {"ground": none["ground"], "height": low})
    np.testing.assert_array_equal(describe_scene(cloud, none).values, plain.values)


def test_nan_intensities_count_as_the_median_or_as_none():
    cloud = street(5)
    ground = find_ground(cloud, GroundParameters())
    median, holes = cloud["intensity"].copy(), cloud["intensity"].copy()
    rows = np.arange(0, len(cloud), 7)
    holes[rows] = np.nan
    median[rows] = np.nanmedian(holes)
    filled = describe_scene(cloud.with_columns(intensity=median), ground)
    np.testing.assert_array_equal(describe_scene(cloud.with_columns(intensity=holes), ground).values, filled.values)
    unknown = cloud.with_columns(intensity=np.full(len(cloud), np.nan, np.float32))
    plain = describe_scene(without(cloud, "intensity"), ground)
    np.testing.assert_array_equal(describe_scene(unknown, ground).values, plain.values)


def test_a_constant_intensity_is_none():
    cloud = without(street(5), "intensity")
    ground = find_ground(cloud, GroundParameters())
    constant = replace(cloud, columns={**cloud.columns, "intensity": np.zeros(len(cloud), np.float32)})
    np.testing.assert_array_equal(describe_scene(constant, ground).values, describe_scene(cloud, ground).values)


def test_temperature_offsets_and_smoothing_change_the_probabilities(model):
    cloud = street(5)
    features = describe_scene(cloud, find_ground(cloud, GroundParameters()))

    def with_(smoothing=0.0, **arrays):
        parameters = {
            **model.metadata["parameters"],
            SLUG: {**model.metadata["parameters"][SLUG], "smoothing": smoothing},
        }
        bundle = ModelBundle(SLUG, {**model.arrays, **arrays}, {**model.metadata, "parameters": parameters})
        return voxel_probabilities(features, bundle)

    plain = with_()
    np.testing.assert_allclose(plain.sum(axis=1), 1)
    soft = with_(temperature=np.array(2.0))
    np.testing.assert_array_equal(soft.argmax(axis=1), plain.argmax(axis=1))
    assert soft.max(axis=1).mean() < plain.max(axis=1).mean()
    offsets = np.zeros(len(SCHEME))
    offsets[1] = 1.0
    shifted = with_(offsets=offsets)
    ratio = np.log(shifted[:, 1] / shifted[:, 0]) - np.log(plain[:, 1] / plain[:, 0])
    np.testing.assert_allclose(ratio, 1.0)
    smooth = with_(smoothing=1.0)
    np.testing.assert_allclose(smooth.sum(axis=1), 1)
    own = features.cells.index >> 1
    _, cell = np.unique(own, axis=0, return_inverse=True)
    assert all(np.ptp(smooth[cell == c], axis=0).max() < 1e-12 for c in range(0, cell.max(), 50))


def test_voxels_per_class_are_bounded_and_labels_outside_the_core_unused():
    cloud = street(5)
    drawn = voxels_of(cloud, replace(QUICK, max_per_class=20))
    counts = np.bincount(drawn["rows"], minlength=len(SCHEME))
    np.testing.assert_array_equal(counts, np.minimum(drawn["found"], 20))
    outside = replace(cloud, columns={**cloud.columns, "core": np.zeros(len(cloud), bool)})
    assert len(voxels_of(outside)["rows"]) == 0


def test_a_class_set_without_classes_is_refused():
    cloud = street(5)
    ground = find_ground(cloud, GroundParameters())
    sets = np.zeros((1, len(SCHEME)), bool)
    with pytest.raises(DataError, match="row 0 of the class sets allows no class"):
        sample_voxels(cloud, ground, np.zeros(len(cloud), np.int16), sets, parameters=QUICK)


def test_a_model_of_other_features_is_refused(model):
    other = ModelBundle(SLUG, model.arrays, {**model.metadata, "feature_names": ["height"]})
    with pytest.raises(DataError, match="train it again"):
        label_cloud(other, street(5))


@pytest.mark.parametrize("smoothing", [0.0, 0.5])
def test_points_of_the_context_have_no_label_and_change_no_other_one(model, smoothing):
    parameters = model.metadata["parameters"] | {SLUG: asdict(replace(QUICK, smoothing=smoothing))}
    other = ModelBundle(SLUG, model.arrays, model.metadata | {"parameters": parameters})
    cloud = street(5)
    near = cloud.xyz[:, 0] > np.median(cloud.xyz[:, 0])
    soft, whole = (label_cloud_softly(one, other) for one in (cloud.with_columns(near=near), cloud))
    assert (soft.labels[~near] == -1).all() and (soft.owner[~near] == -1).all()
    np.testing.assert_array_equal(soft.labels[near], whole.labels[near])
    np.testing.assert_array_equal(soft.confidence[near], whole.confidence[near])
    np.testing.assert_array_equal(soft.probabilities[soft.owner[near]], whole.probabilities[whole.owner[near]])
