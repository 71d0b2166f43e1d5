"""Objects, their reference classes and the counting of detections on planted scenes."""

from dataclasses import replace

import numpy as np
import pytest
from sklearn.metrics import adjusted_rand_score, f1_score

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.palette import HIT_COLOUR, MISSED_COLOUR, WRONG_COLOUR
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import NormalizedCutParameters
from mlsroad_pipeline.algorithms.segmentation.stage import (
    SegmentationParameters,
    measure_segmentation,
    owned_by_core,
    reference_objects,
    segment_scene,
    segmentation_table,
)
from mlsroad_pipeline.papers.shared.detection.scoring import (
    FALSE,
    MISSED,
    RIGHT,
    DetectionParameters,
    count_detections_of_scene,
    detection_curves,
    detection_outcomes,
    detection_table,
    object_classes,
    wanted_objects,
    without_reference,
)
from mlsroad_pipeline.papers.shared.detection.thresholds import best_threshold, detect_by_thresholds, object_weights
from mlsroad_pipeline.papers.shared.detection.training import training_weights
from mlsroad_pipeline.papers.shared.figures import detection_figure

SCHEME = ClassScheme(
    "test", ("pole", "car", "other"), (("light_pole",), ("car",), ("road", "tree")), ("unlabelled",), (64, 66, 1)
)
WANTED = DetectionParameters(scheme="test", classes=("pole", "car"), min_points=5)


def street(rng, *, instances=True):
    """Two poles, a car and a tree on a road; the second pole is outside the core."""
    parts = {
        "road": rng.uniform([0, 0, -0.02], [30, 6, 0.02], (3000, 3)),
        "light_pole": rng.uniform([2, 1, 0.1], [2.1, 1.1, 4], (200, 3)),
        "car": rng.uniform([8, 2, 0.3], [12, 4, 1.5], (4000, 3)),
        "tree": rng.uniform([18, 1, 0.3], [20, 3, 4], (9000, 3)),
        "far pole": rng.uniform([28, 1, 0.1], [28.1, 1.1, 4], (200, 3)),
    }
    names = [name.replace("far pole", "light_pole") for name in parts]
    sizes = [len(part) for part in parts.values()]
    xyz = np.concatenate(list(parts.values()))
    columns = {"label": np.repeat([TAXONOMY[n] for n in names], sizes).astype(np.uint8), "core": xyz[:, 0] < 25}
    if instances:
        columns["instance"] = np.repeat([0, 11, 12, 13, 99], sizes).astype(np.int32)
    ground = {"ground": np.repeat([True, False, False, False, False], sizes)}
    return PointCloud(xyz, columns), ground


PARAMETERS = SegmentationParameters(normalized_cut=NormalizedCutParameters(tolerance=0.4))


@pytest.mark.parametrize("instances", [True, False])
def test_objects_get_the_class_of_their_reference(rng, instances):
    scene, ground = street(rng, instances=instances)
    objects = segment_scene(scene, ground, PARAMETERS)
    assert (objects["objects"][ground["ground"]] == -1).all() and objects["objects"].max() == 3
    found = object_classes(scene, objects, scheme=SCHEME, parameters=WANTED)
    assert found["label"].tolist() == [0, 1, -1, 0]
    assert found["own"].tolist() == [True, True, True, False]


def test_reference_objects_number_instances_and_take_their_most_frequent_class(rng):
    scene, _ = street(rng)
    numbers, classes = reference_objects(scene, SCHEME)
    assert np.unique(numbers).tolist() == [0, 1, 2, 3, 4]
    assert classes.tolist() == [-1, 0, 1, 2, 0]


def test_true_and_false_positives_and_misses_count_in_the_owning_scene(rng):
    scene, ground = street(rng)
    objects = segment_scene(scene, ground, PARAMETERS)
    scores = np.array([[0.3, 0.1], [0.0, 0.9], [0.4, 0.0], [0.8, 0.2]], np.float32)
    detections = {"label": np.array([-1, 1, 0, 0], np.int16), "score": scores.max(axis=1) * [0, 1, 1, 1]}
    detections["scores"] = scores
    counted = count_detections_of_scene(scene, objects, detections, scheme=SCHEME, parameters=WANTED)
    assert counted["n_objects"].tolist() == [1, 1]  # the pole outside of the core is another scene's
    assert counted["label"].tolist() == [0, 1] and counted["right"].tolist() == [False, True]
    table = detection_table({"test.a": counted, "test.b": counted}, method="m", classes=WANTED.classes)
    value = table.set_index(["class", "metric"])["value"]
    assert value["pole", "fn"] == 2 and value["pole", "fp"] == 2 and value["car", "tp"] == 2
    assert value["all", "precision"] == 0.5
    curves = detection_curves({"test.a": counted}, split="test", classes=WANTED.classes)
    # The pole of the core is not detected, but has a score, and a wrong object scores more; the car scores more than
    # the pole does as a car.
    np.testing.assert_allclose(curves["pole"], [[0.4, 0.3], [0.0, 0.5], [0.0, 1.0]], rtol=1e-6)
    np.testing.assert_allclose(curves["car"], [[0.9, 0.1], [1.0, 0.5], [1.0, 1.0]], rtol=1e-6)


def test_small_references_are_excluded(rng):
    scene, ground = street(rng)
    objects = segment_scene(scene, ground, PARAMETERS)
    nothing = {"label": np.full(4, -1, np.int16), "score": np.zeros(4), "scores": np.zeros((4, 2))}
    strict = DetectionParameters(scheme="test", classes=("pole", "car"), min_points=500)
    counted = count_detections_of_scene(scene, objects, nothing, scheme=SCHEME, parameters=strict)
    assert counted["n_objects"].tolist() == [0, 1]


def test_matches_of_small_references_are_excluded_from_training(rng):
    scene, ground = street(rng)
    objects = segment_scene(scene, ground, PARAMETERS)
    strict = DetectionParameters(scheme="test", classes=("pole", "car"), min_points=500)
    found = object_classes(scene, objects, scheme=SCHEME, parameters=strict)
    assert found["label"].tolist() == [0, 1, -1, 0] and found["own"].tolist() == [False, True, True, False]


@pytest.mark.parametrize("silence", ["ignored label", "car of no instance", "tree of no instance"])
def test_segments_without_reference_are_excluded_from_training_and_scores(rng, silence):
    scene, ground = street(rng)
    objects = segment_scene(scene, ground, PARAMETERS)
    columns = {name: values.copy() for name, values in scene.columns.items()}
    if silence == "ignored label":
        columns["label"][columns["instance"] == 13] = TAXONOMY["unlabelled"]
    else:
        columns["instance"][columns["instance"] == (12 if silence == "car of no instance" else 13)] = 0
    spoilt = PointCloud(scene.xyz, columns)
    found = object_classes(spoilt, objects, scheme=SCHEME, parameters=WANTED)
    detections = {"label": np.array([0, 1, 1, 0], np.int16), "score": np.full(4, 0.5, np.float32)}
    detections["scores"] = np.full((4, 2), 0.5, np.float32)
    counted = count_detections_of_scene(spoilt, objects, detections, scheme=SCHEME, parameters=WANTED)
    if silence == "ignored label":  # the tree is neither a counterexample nor a false car
        assert found["own"].tolist() == [True, True, False, False]
        assert counted["n_objects"].tolist() == [1, 1] and counted["right"].tolist() == [True, True]
    elif silence == "car of no instance":
        assert found["own"].tolist() == [True, False, True, False]
        assert counted["n_objects"].tolist() == [1, 0] and counted["right"].tolist() == [True, False]
    else:  # what is not wanted needs no instance
        assert found["own"].tolist() == [True, True, True, False]
        assert counted["n_objects"].tolist() == [1, 1] and counted["right"].tolist() == [True, True, False]


def test_attached_objects_of_another_class_are_objects():
    """Two poles with a car on each, numbered as one instance each; a branch in the first, and points of no label."""
    names = ["light_pole", "car", "tree", "unlabelled", "light_pole", "car", "tree"]
    sizes, numbers = [50, 20, 5, 4, 30, 40, 9], np.array([7, 7, 7, 7, 9, 9, 0])
    labels = np.repeat([TAXONOMY[name] for name in names], sizes).astype(np.uint8)
    scene = PointCloud(
        np.zeros((sum(sizes), 3)), {"label": labels, "instance": np.repeat(numbers, sizes).astype(np.int32)}
    )
    objects, classes = wanted_objects(scene, SCHEME, WANTED.labels_in(SCHEME))
    assert classes.tolist() == [-1, 0, 1, 1, 0]  # a car in the first, and in the second the pole, as it is smaller
    np.testing.assert_array_equal(objects, np.repeat([1, 3, 1, 1, 4, 2, 0], sizes))
    poles_alone, kinds = wanted_objects(scene, SCHEME, np.array([0], np.int16))
    assert kinds.tolist() == [-1, 0, 1, 0]  # nobody looks for cars, so the first stays whole
    np.testing.assert_array_equal(poles_alone, np.repeat([1, 1, 1, 1, 3, 2, 0], sizes))


def test_half_of_an_object_is_enough_to_be_scored():
    scene = PointCloud(
        np.zeros((4, 3)), {"label": np.array([TAXONOMY["unlabelled"], TAXONOMY["tree"]] * 2, np.uint8)}
    )  # fmt: skip
    silent = without_reference(scene, np.array([0, 0, 1, -1]), 3, scheme=SCHEME, wanted=WANTED.labels_in(SCHEME))
    assert silent.tolist() == [False, True, False]


def test_thresholds_are_calibrated_to_the_prevalence_of_a_class(rng):
    labels = np.repeat([0, 1, -1], [200, 30, 400])
    scores = np.round(rng.normal(np.where(labels == 0, 0.6, 0.4), 0.1), 2).clip(0.01)
    weights = object_weights(labels, np.array([0.25, 3.0]))
    assert np.unique(weights[labels == 0]) == 0.25 and np.unique(weights[labels == 1]) == 3.0
    assert (weights[labels < 0] == 1).all() and (object_weights(labels, None) == 1).all()
    reached, threshold = best_threshold(scores, labels == 0, weights)
    best = max(f1_score(labels == 0, scores >= level, sample_weight=weights) for level in np.unique(scores))
    assert reached == pytest.approx(best)
    assert f1_score(labels == 0, scores >= threshold, sample_weight=weights) == pytest.approx(best)
    assert threshold > best_threshold(scores, labels == 0)[1]  # rarer objects need better scores


def test_scenes_of_weight_zero_are_excluded_from_threshold_selection(rng):
    usual = {"label": np.repeat([0, -1], [60, 300]), "own": rng.random(360) < 0.9}
    odd = {"label": np.repeat([0, 1, -1], [20, 10, 200]), "own": rng.random(230) < 0.9, "weight": 0.0}
    weights = training_weights([usual, odd], np.array([0.25, 3.0]))
    n = usual["own"].sum()
    assert weights[:n].tolist() == np.where(usual["label"] == 0, 0.25, 1.0)[usual["own"]].tolist()
    assert len(weights) == n + odd["own"].sum() and (weights[n:] == 0).all()
    labels = np.concatenate([found["label"][found["own"]] for found in (usual, odd)])
    scores = rng.normal(np.where(labels == 0, 0.6, 0.4), 0.1).clip(0.01)
    scores[n:][labels[n:] < 0] += 0.3  # what is rare and looks like an example
    alone = best_threshold(scores[:n], labels[:n] == 0, weights[:n])
    assert best_threshold(scores, labels == 0, weights) == alone
    assert alone != best_threshold(scores, labels == 0, np.where(labels == 0, 0.25, 1.0))
    assert best_threshold(scores, labels == 1, weights) == (0.0, np.inf)  # its examples are excluded too


def test_prevalence_of_an_unwanted_class_is_an_error():
    with pytest.raises(ParameterError, match="prevalence names 'tree', which is not looked for"):
        DetectionParameters(prevalence={"tree": 0.5})
    with pytest.raises(ParameterError, match="detection.prevalence of 'car' must be"):
        DetectionParameters(prevalence={"car": 0})
    assert DetectionParameters(prevalence={"car": 2}).factors.tolist() == [1, 1, 2]


def test_the_scene_of_the_lowest_point_owns_an_object():
    xyz = np.array([[0, 0, 0.0], [1, 0, 5.0], [0, 0, 3.0], [1, 0, 2.0]])
    scene = PointCloud(xyz, {"core": np.array([True, False, True, False])})
    assert owned_by_core(scene, np.array([0, 0, 1, 1]), 3).tolist() == [True, False, False]


def test_segmentation_is_scored_over_what_the_core_owns(rng):
    scene, ground = street(rng)
    objects = segment_scene(scene, ground, PARAMETERS)
    found = measure_segmentation(scene, objects, scheme=SCHEME, min_points=5)
    table = segmentation_table({"train.a": found, "test.b": found, "test.c": found}).set_index("split")
    assert table.loc["test", "n_instances"] == 6 and table.loc["train", "n_segments"] == 3
    assert table.loc["test", "weighted_coverage"] > 0.99 and table.loc["test", "precision"] == 1.0
    clusters = segment_scene(scene, ground, SegmentationParameters("euclidean", min_points=500))
    assert np.unique(clusters["objects"]).tolist() != np.unique(objects["objects"]).tolist()


def test_intensity_is_used_by_the_methods_with_intensity(rng):
    pole = rng.uniform([-0.08, -0.08, 0], [0.08, 0.08, 4], (4000, 3))
    bush = rng.uniform([-0.5, -0.5, 0], [0.5, 0.5, 1.5], (8000, 3))
    xyz = np.concatenate([pole, bush[np.abs(bush[:, :2]).max(axis=1) > 0.08]])
    intensity = np.where(np.arange(len(xyz)) < 4000, 0.9, 0.15).astype(np.float32)
    scene, ground = PointCloud(xyz, {"intensity": intensity}), {"ground": np.zeros(len(xyz), bool)}
    cut = NormalizedCutParameters(sigma_i=0.2, tall_smoothing=0.2, pole_length=0)  # or its shape would tell the pole
    both = [
        segment_scene(scene, ground, SegmentationParameters(method, cut))["objects"].max() + 1
        for method in ("normalized_cut", "normalized_cut_geometry")
    ]
    assert both[0] == 2 and both[1] != 2


def test_the_published_cut_does_not_separate_poles(rng):
    pole = rng.uniform([-0.06, -0.06, 0], [0.06, 0.06, 6], (6000, 3))
    bush = rng.uniform([-0.5, -0.5, 0], [0.5, 0.5, 1.5], (8000, 3))
    xyz = np.concatenate([pole, bush[np.abs(bush[:, :2]).max(axis=1) > 0.06]])
    scene, ground = PointCloud(xyz, {}), {"ground": np.zeros(len(xyz), bool)}
    truth = np.arange(len(xyz)) < 6000
    ours, published = (
        segment_scene(scene, ground, SegmentationParameters(method))["objects"]
        for method in ("normalized_cut_geometry", "normalized_cut_plain")
    )
    assert adjusted_rand_score(truth, ours) > 0.8
    assert published.max() == 0


def test_the_cut_as_printed_uses_intensity_and_nothing_else(rng):
    xyz = np.concatenate([rng.uniform([x, 0, 0], [x + 3, 1, 2], (8000, 3)) for x in (0, 3)])
    dark_and_bright = np.repeat([0.0, 1.0], 8000).astype(np.float32)
    scene, ground = PointCloud(xyz, {"intensity": dark_and_bright}), {"ground": np.zeros(len(xyz), bool)}
    printed, blind = (
        segment_scene(scene, ground, SegmentationParameters(method))["objects"]
        for method in ("normalized_cut_printed", "normalized_cut_plain")
    )
    assert adjusted_rand_score(dark_and_bright, printed) == 1.0
    assert blind.max() == 0
    assert SegmentationParameters().printed_cut == replace(
        SegmentationParameters().plain_cut, sigma_i=1.0, smoothing=0.0, tall_smoothing=0.0
    )


def test_threshold_has_the_best_f_score(rng):
    scores = np.round(rng.random(60), 2) * (rng.random(60) < 0.8)
    truth = rng.random(60) < 0.2 + 0.6 * scores
    reached, threshold = best_threshold(scores, truth)
    every = [f1_score(truth, (scores >= t) & (scores > 0)) for t in np.unique(scores)]
    assert reached == pytest.approx(max(every)) == pytest.approx(f1_score(truth, scores >= threshold))
    assert not np.isin(threshold, scores)
    assert best_threshold(np.ones(4), np.zeros(4, bool)) == (0.0, np.inf)
    nothing = best_threshold(np.zeros(4), np.array([True, False, False, True]))
    assert nothing == (0.0, np.nextafter(0.0, 1.0))


def test_class_exceeds_its_threshold_by_the_largest_factor():
    scores = np.array([[0.5, 0.3], [0.2, 0.19], [0.0, 0.0], [0.3, 0.9]])
    label, score = detect_by_thresholds(scores, np.array([0.4, 0.2]))
    assert label.tolist() == [1, -1, -1, 1]
    np.testing.assert_allclose(score, [0.3, 0, 0, 0.9], rtol=1e-6)


def test_bad_input(rng):
    scene, ground = street(rng)
    objects = segment_scene(scene, ground, PARAMETERS)
    with pytest.raises(DataError, match="1 detections for 4 objects"):
        one = {"label": np.zeros(1, np.int16), "score": np.zeros(1), "scores": np.zeros((1, 2))}
        count_detections_of_scene(scene, objects, one, scheme=SCHEME, parameters=WANTED)
    with pytest.raises(DataError, match=r"scores \(4, 3\) for 4 objects and 2 wanted classes"):
        wide = {"label": np.full(4, -1), "score": np.zeros(4), "scores": np.zeros((4, 3))}
        count_detections_of_scene(scene, objects, wide, scheme=SCHEME, parameters=WANTED)
    with pytest.raises(ParameterError, match="scheme 'test' has no tram"):
        DetectionParameters(classes=("tram",)).labels_in(SCHEME)
    with pytest.raises(ParameterError, match="detection.classes must name at least one class"):
        DetectionParameters(classes=())
    with pytest.raises(ParameterError, match=r"iou_threshold .*got 1"):
        DetectionParameters(iou_threshold=1)
    with pytest.raises(ParameterError, match=r"segmentation.method .*got 'magic'"):
        SegmentationParameters("magic")


def share_of(picture, colour):
    """Return the share of pixels with the hue of a colour in any shade."""
    flat = picture.reshape(-1, 3).astype(float)
    tone = np.array(colour) / np.linalg.norm(colour)
    return float(((flat @ tone) / np.linalg.norm(flat, axis=1).clip(1) > 0.985).mean())


def test_points_of_detected_missed_and_false_objects(rng):
    scene, ground = street(rng)
    objects = segment_scene(scene, ground, PARAMETERS)
    pole, tree = (objects["objects"][scene["instance"] == k].max() for k in (11, 13))
    label, score = np.full(4, -1, np.int16), np.zeros(4, np.float32)
    label[[pole, tree]], score[[pole, tree]] = [0, 1], [0.9, 0.8]  # the tree is taken for a car, the far pole is missed
    truth, outcomes = detection_outcomes(
        scene, objects, {"label": label, "score": score}, scheme=SCHEME, parameters=WANTED
    )
    of = {k: (truth[scene["instance"] == k], outcomes[scene["instance"] == k]) for k in (0, 11, 12, 13, 99)}
    expected = {0: (-1, -1), 11: (0, RIGHT), 12: (1, MISSED), 13: (-1, FALSE), 99: (0, MISSED)}
    for k, (kind, outcome) in expected.items():
        assert (of[k][0] == kind).all() and (of[k][1] == outcome).mean() > 0.99, k
    large = DetectionParameters(scheme="test", classes=("pole", "car"), min_points=300)
    truth, outcomes = detection_outcomes(
        scene, objects, {"label": label, "score": score}, scheme=SCHEME, parameters=large
    )
    assert (truth[scene["instance"] == 11] == 0).all()  # found all the same, though nobody looked for it
    assert (truth[scene["instance"] == 99] == -1).all() and (outcomes[scene["instance"] == 99] == -1).all()


def test_a_scene_without_objects_or_detections_has_a_picture(rng):
    scene, _ = street(rng)
    bare = {"objects": np.full(len(scene), -1, np.int32)}
    nothing = {"label": np.empty(0, np.int16), "score": np.empty(0, np.float32)}
    _, outcomes = detection_outcomes(scene, bare, nothing, scheme=SCHEME, parameters=WANTED)
    assert (outcomes[np.isin(scene["instance"], [11, 12, 99])] == MISSED).all()
    figure = detection_figure([scene], [bare], [nothing], scheme=SCHEME, parameters=WANTED, title="none")
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["Truth", "Detections"]
    picture = figure.axes[1].images[0].get_array()
    assert share_of(picture, MISSED_COLOUR) > 0.002
    assert share_of(picture, HIT_COLOUR) == share_of(picture, WRONG_COLOUR) == 0
