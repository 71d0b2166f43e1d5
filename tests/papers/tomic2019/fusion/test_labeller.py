"""Fusion as a model: division of scenes, stored arrays, and labels of a stored model."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.model_store.bundle_files import load_bundle, save_bundle
from mlsroad_pipeline.papers.tomic2019.fusion.labeller import (
    FusionParameters,
    divide_scenes,
    fit,
    fuse_scene,
    fusion_sample,
)

SCHEME = ClassScheme("two", ("a", "b"), (("road",), ("building",)), (), (11, 6))


def planted(rng, n=4000):
    """The features know class a alone, the first camera class b alone; the second sees nothing, half is in no image."""
    truth = rng.integers(0, 2, n)
    swap = rng.random(n) < 0.5
    features = {"label": np.where((truth == 1) & swap, 0, truth).astype(np.int16), "confidence": np.full(n, 0.8, "f4")}
    camera = np.where((truth == 0) & swap, 1, truth)
    probabilities = np.full((n, 2, 2), np.nan, dtype=np.float16)
    seen = rng.random(n) < 0.5
    probabilities[seen, 0] = np.eye(2)[camera[seen]] * 0.8 + 0.1
    codes = np.array([TAXONOMY["road"], TAXONOMY["building"]], dtype=np.uint8)[truth]
    core = rng.random(n) < 0.7
    scene = PointCloud(rng.normal(size=(n, 3)), {"core": core, "label": codes}, np.zeros(3))
    return scene, features, {"probabilities": probabilities}, truth, seen


def learned(rng):
    scene, features, images, truth, _ = planted(rng)
    sample = fusion_sample(scene, features, images, scheme=SCHEME)
    assert np.array_equal(sample["reference"], truth[scene["core"]])
    settings = {"parameters": FusionParameters(), "scheme": SCHEME, "cameras": ["x", "y"], "trained_on": {}}
    half = {name: values[: len(values) // 2] for name, values in sample.items()}
    rest = {name: values[len(values) // 2 :] for name, values in sample.items()}
    parts, whole = fit([half, rest], **settings), fit([sample], **settings)
    assert all(np.array_equal(parts.arrays[name], whole.arrays[name]) for name in whole.arrays)
    return whole


def test_each_drive_is_divided_along_the_road():
    keys = [f"test.one.{k:03d}" for k in range(5)] + ["test.two.000", "test.two.001"]
    first, second = divide_scenes(keys, 0.6)
    assert first == [*keys[:3], keys[5]] and second == [*keys[3:5], keys[6]]
    for share in (0.01, 0.99):  # each set has a scene of every drive
        first, second = divide_scenes(keys, share)
        assert sorted(first + second) == keys
        assert {k.rpartition(".")[0] for k in first} == {k.rpartition(".")[0] for k in second}


def test_drives_that_cannot_be_divided_are_named():
    with pytest.raises(DataError, match=r"drive 'test\.two' has 1 scene"):
        divide_scenes(["test.one.000", "test.one.001", "test.two.000"], 0.5)
    with pytest.raises(DataError, match="not trained on"):
        divide_scenes([], 0.5)
    with pytest.raises(ParameterError, match=r"share .*got 1"):
        FusionParameters(share=1)


def test_stored_model_is_better_than_either_and_keeps_the_features_where_no_camera_sees(rng, tmp_path):
    model = learned(rng)
    save_bundle(model, tmp_path / "model")
    _, features, images, truth, seen = planted(rng)
    found = fuse_scene(features, images, load_bundle(tmp_path / "model"))
    again = fuse_scene(features, images, model)
    assert all(np.array_equal(found[name], again[name]) for name in again)
    assert np.array_equal(found["seen"], seen) and np.array_equal(found["label"][~seen], features["label"][~seen])
    assert (found["image_label"][~seen] == -1).all()
    right = {n: (found[n] == truth)[seen].mean() for n in ("label", "pool_label", "image_label", "feature_label")}
    # Where the two contradict each other nothing tells who is right; no rule is worse than the better of the two.
    assert min(right["label"], right["pool_label"]) >= max(right["image_label"], right["feature_label"]) - 0.03
    assert ((found["confidence"] > 0) & (found["confidence"] <= 1)).all()


def test_points_without_a_label_of_the_features_have_none(rng):
    model = learned(rng)
    _, features, images, _, seen = planted(rng)
    features["label"][:50] = -1
    found = fuse_scene(features, images, model)
    assert (found["label"][:50] == -1).all() and (found["pool_label"][:50] == -1).all()
    assert (found["confidence"][:50] == 0).all() and np.array_equal(found["seen"], seen)


def test_other_cameras_and_points_alone_are_refused(rng):
    model = learned(rng)
    scene, features, images, _, _ = planted(rng, 100)
    with pytest.raises(DataError, match="expected labels of 2 labellers"):
        fuse_scene(features, {"probabilities": images["probabilities"][:, :1]}, model)
    with pytest.raises(ParameterError, match="'fusion' needs images"):
        label_cloud(model, scene)
