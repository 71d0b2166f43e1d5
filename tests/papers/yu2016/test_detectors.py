"""Baseline detectors on planted objects in any orientation, and bad input."""

import numpy as np
import pytest
from helpers.planted import (
    FOREST,
    LABELS,
    METHODS,
    SCHEME,
    STAGES,
    WANTED,
    described,
    street,
    trained,
)

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.papers.shared.detection.detector import detect_objects
from mlsroad_pipeline.papers.shared.detection.training import DetectorTraining, TrainingObjects, train_object_detector
from mlsroad_pipeline.papers.yu2016.bottom_up_top_down.detector import BottomUpTopDownParameters
from mlsroad_pipeline.papers.yu2016.bottom_up_top_down.oriented_points import OrientedPointParameters
from mlsroad_pipeline.papers.yu2016.hough_forest.detector import (
    HoughForest,
    HoughForestParameters,
)
from mlsroad_pipeline.papers.yu2016.object_matching.detector import (
    ObjectMatchingParameters,
)

methods = pytest.mark.parametrize("slug", METHODS)


@pytest.fixture(scope="module")
def models():
    """Return one model of each method, trained on the same street."""
    scene, objects = street(np.random.default_rng(1), 8)
    return {slug: trained(slug, scene, objects, np.tile(LABELS, 8)) for slug in METHODS}


@methods
@pytest.mark.parametrize("intensity", [True, False])
def test_planted_objects_are_detected_in_any_orientation(slug, intensity, models, rng):
    scene, objects = street(rng, 5, intensity=intensity)
    found = detect_objects(described(slug, scene, objects), models[slug])
    assert (found["label"] == np.tile(LABELS, 5)).mean() >= 14 / 15
    assert found["label"].dtype == np.int16 and found["scores"].dtype == np.float32
    assert found["scores"].shape == (15, 2) and np.isfinite(found["scores"]).all()
    chosen = found["label"] >= 0
    rows = np.flatnonzero(chosen)
    np.testing.assert_array_equal(found["score"][chosen], found["scores"][rows, found["label"][chosen]])
    assert (found["score"][~chosen] == 0).all()


@methods
def test_same_seed_same_model_and_moved_scene_same_scores(slug, models, rng):
    scene, objects = street(np.random.default_rng(1), 8)
    again = trained(slug, scene, objects, np.tile(LABELS, 8))
    for name, values in models[slug].arrays.items():
        assert again.arrays[name].tobytes() == values.tobytes(), name
    parts = described(slug, scene, objects)
    moved = {**parts, "centres": parts["centres"] + [389_300.0, 5_819_700.0, 34.0]}
    one, other = (detect_objects(found, again) for found in (parts, moved))
    np.testing.assert_allclose(one["scores"], other["scores"], atol=0.03)


@methods
def test_raw_points_are_labelled(slug, models, rng):
    scene, _ = street(rng, 3)
    road = np.column_stack([rng.uniform(-5, 75, 5000), rng.uniform(-5, 5, 5000), np.zeros(5000)])
    columns = {
        "intensity": np.concatenate([scene["intensity"], np.full(len(road), 0.2, np.float32)]),
        "ground": np.arange(len(scene) + len(road)) >= len(scene),
    }
    cloud = PointCloud(np.concatenate([scene.xyz, road]), columns)
    labels, confidence = label_cloud(models[slug], cloud)
    assert (labels[len(scene) :] == -1).all()
    cars = np.flatnonzero(scene["label"] == TAXONOMY["car"])
    assert (labels[cars] == 1).mean() > 0.5 and (confidence[labels >= 0] > 0).all()
    empty = label_cloud(models[slug], PointCloud(np.zeros((0, 3))))
    assert len(empty[0]) == len(empty[1]) == 0


@methods
def test_tiny_objects_are_not_detected_and_an_empty_scene_has_none(slug, models, rng):
    scene = PointCloud(rng.random((3, 3)), {"intensity": np.ones(3, np.float32)})
    found = detect_objects(described(slug, scene, {"objects": np.zeros(3, np.int32)}), models[slug])
    assert found["scores"].shape == (1, 2) and np.isfinite(found["scores"]).all() and found["label"][0] == -1
    nothing = described(slug, scene, {"objects": np.full(3, -1, np.int32)})
    assert detect_objects(nothing, models[slug])["scores"].shape == (0, 2)


@methods
def test_one_example_is_enough_to_train_and_none_is_never_detected(slug, rng, caplog):
    scene, objects = street(rng, 2)
    labels = np.array([0, -1, -1, -1, 1, -1], np.int16)
    model = trained(slug, scene, objects, labels)
    found = detect_objects(described(slug, scene, objects), model)
    assert np.isfinite(found["scores"]).all()
    without = trained(slug, scene, objects, np.where(labels == 1, -1, labels).astype(np.int16))
    assert "No training object is a car" in caplog.text
    found = detect_objects(described(slug, scene, objects), without)
    assert (found["scores"][:, 1] == 0).all() and (found["label"] != 1).all()
    with pytest.raises(DataError, match="no training scenes"):
        train_object_detector({}, {}, DetectorTraining(slug, METHODS[slug], STAGES, WANTED, SCHEME, {}))


@methods
def test_a_street_of_weight_zero_is_excluded_from_threshold_selection(slug, rng):
    """Its cars are labelled as others: thresholds chosen on it too give false positives or misses for half of the cars."""
    scene, objects = street(rng, 6)
    parts = described(slug, scene, objects)
    own, other = np.ones(18, bool), np.where(LABELS == 1, -1, LABELS).astype(np.int16)
    reached = {}
    for weight in (0.0, 1.0):
        labels = {"a": {"label": np.tile(LABELS, 6), "own": own}}
        labels["b"] = {"label": np.tile(other, 6), "own": own, "weight": weight}
        model = train_object_detector(
            {"a": parts, "b": parts}, labels, DetectorTraining(slug, METHODS[slug], STAGES, WANTED, SCHEME, {})
        )
        reached[weight] = model.metadata["learned"]["geometry"]["f_scores"][1]
    assert reached[0.0] > 0.9 > reached[1.0] + 0.05


def test_bad_parameters_are_named():
    with pytest.raises(ParameterError, match=r"hough_forest.n_trees .*got 0"):
        HoughForestParameters(n_trees=0)
    with pytest.raises(ParameterError, match=r"hough_forest.cell .*got 0"):
        HoughForestParameters(cell=0)
    with pytest.raises(ParameterError, match=r"object_matching.least .*got 2"):
        ObjectMatchingParameters(least=2)
    with pytest.raises(ParameterError, match=r"bottom_up_top_down.candidates .*got 0"):
        BottomUpTopDownParameters(candidates=0)
    with pytest.raises(ParameterError, match=r"n_radial .*got 1"):
        OrientedPointParameters(n_radial=1)
    with pytest.raises(DataError, match="arrays of a Hough forest lack roots"):
        HoughForest.from_arrays({}, intensity=True)


def test_geometry_variant_of_the_forest_ignores_intensity(rng):
    scene, objects = street(rng, 3)
    parts = described("hough_forest", scene, objects)
    labels = np.tile(LABELS, 3)
    one = HoughForest.fit(TrainingObjects(parts, labels, 2), FOREST)[0]
    bright = {**parts, "descriptors": parts["descriptors"].copy()}
    bright["descriptors"][:, 19] = rng.random(len(bright["descriptors"]))
    other = HoughForest.fit(TrainingObjects(bright, labels, 2), FOREST)[0]
    for name, values in one.to_arrays().items():
        assert values.tobytes() == other.to_arrays()[name].tobytes(), name
