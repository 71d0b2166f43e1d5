"""Bags and their similarity by hand, and detection of planted kinds of objects."""

from dataclasses import replace

import numpy as np
import pytest
from references.words import planted
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.papers.yu2016.visual_words.appearance import (
    count_words,
    inverse_document_frequency,
    measure_sizes,
    similarity,
    size_similarity,
    weigh_words,
    within_sizes,
)
from mlsroad_pipeline.papers.yu2016.visual_words.detector import VisualWordsDetector
from mlsroad_pipeline.papers.yu2016.visual_words.queries import DetectorParameters
from mlsroad_pipeline.papers.yu2016.visual_words.training import bag_objects


def test_bags_are_equations_21_and_22():
    words, objects = np.array([0, 0, 1, 2, 1, 3]), np.array([0, 0, 0, 1, 1, 1])
    counts = count_words(words, objects, n_objects=3, stopped=np.array([False, False, False, True]))
    np.testing.assert_array_equal(counts.toarray(), [[2, 1, 0, 0], [0, 1, 1, 0], [0, 0, 0, 0]])
    inverse = inverse_document_frequency(counts)
    np.testing.assert_allclose(inverse, [np.log(3), np.log(1.5), np.log(3), 0])
    bags = weigh_words(counts, inverse).toarray()
    np.testing.assert_allclose(bags[0], [2 / 3 * np.log(3), 1 / 3 * np.log(1.5), 0, 0])
    np.testing.assert_allclose(bags[2], 0)


def test_similarity_is_equation_23(rng):
    queries, bags = (csr_array(rng.random((n, 30)) * (rng.random((n, 30)) < 0.3)) for n in (4, 9))
    least = np.minimum(queries.toarray()[:, None], bags.toarray()[None]).sum(axis=2)
    most = np.maximum(queries.toarray()[:, None], bags.toarray()[None]).sum(axis=2)
    np.testing.assert_allclose(similarity(queries, bags), least / most)
    empty = csr_array((2, 30))
    assert (similarity(empty, bags) == 0).all() and (similarity(empty, empty) == 0).all()
    np.testing.assert_allclose(np.diag(similarity(bags, bags)), 1.0)


NEAREST = DetectorParameters(decision="nearest", size_share=0.0, profile_share=0.0, size_margin=0.0)  # as printed


def test_planted_classes_are_found_in_all_their_kinds(rng):
    counts, labels = planted(rng, 200)
    detector = VisualWordsDetector(["pole", "car"], parameters=NEAREST).fit(counts, labels)
    unseen, truth = planted(rng, 150)
    found, scores = detector.detect(unseen)
    np.testing.assert_array_equal(found, truth)
    assert found.dtype == np.int16 and scores.dtype == np.float32
    assert (scores[truth >= 0] > 0).all() and (scores[truth < 0] == 0).all()
    assert all(2 <= len(q.appearance) <= 12 for q in detector.queries_.values())  # a query for each kind of the class


def test_one_query_finds_less_than_several(rng):
    counts, labels = planted(rng, 200)
    unseen, truth = planted(rng, 200)
    right = []
    for n in (1, 12):
        parameters = replace(NEAREST, max_queries=n)
        detector = VisualWordsDetector(["pole", "car"], parameters=parameters).fit(counts, labels)
        assert all(len(q.appearance) <= n for q in detector.queries_.values())
        right.append((detector.detect(unseen)[0] == truth).mean())
    assert right[0] < 0.9 < right[1]


def test_a_class_with_one_example_is_detected_of_any_similarity(rng):
    counts = csr_array(np.array([[3.0, 0, 1], [0, 5, 0], [0, 4, 1]]))
    detector = VisualWordsDetector(["pole"], parameters=NEAREST).fit(counts, [0, -1, -1])
    assert len(detector.queries_["pole"].appearance) == 1
    assert detector.queries_["pole"].threshold > 0
    assert detector.detect(counts)[0][0] == 0


def sized(rng, labels):
    """Sizes of poles (7 m high), cars (4 m long), and others, of which half are small."""
    table = np.array([[0, 1.5, 4.2, 1.8], [0, 7, 0.8, 0.2], [0, 1.5, 4.2, 1.8]])[labels + 1]
    table[(labels < 0) & (rng.random(len(labels)) < 0.5)] = [0, 0.4, 0.3, 0.3]
    return table * rng.uniform(0.9, 1.1, table.shape)


def test_weighted_queries_find_planted_classes_in_scenes_of_their_own(rng):
    counts, labels = planted(rng, 300)
    unseen, truth = planted(rng, 150)
    sizes, others = sized(rng, labels), sized(rng, truth)
    detector = VisualWordsDetector(["pole", "car"]).fit(counts, labels, sizes=sizes, scenes=np.arange(300) % 7)
    found, _ = detector.detect(unseen, others)
    assert (found == truth).mean() > 0.97
    assert min(detector.f_scores_.values()) > 0.95
    assert all(0.2 < t < 0.8 for t in detector.thresholds)
    assert all((q.weights < 0).any() and (q.weights > 0).any() for q in detector.queries_.values())
    again = VisualWordsDetector.from_arrays(detector.to_arrays())
    assert again.score(unseen, others).tobytes() == detector.score(unseen, others).tobytes()
    # No example is as small as the small ones: they have no score at all.
    small = others[:, 1] < 1
    assert small.any() and (detector.score(unseen, others)[small] == 0).all()


@pytest.mark.parametrize("decision", ["weighted", "nearest"])
def test_sizes_separate_objects_of_the_same_words(rng, decision):
    counts = csr_array(rng.poisson(np.full((200, 30), 1.0)).astype(np.float64))
    labels = np.repeat([0, -1], 100)
    sizes = np.where(labels[:, None] == 0, [0, 7, 0.8, 0.2], [0, 4, 3.0, 3.0]) * rng.uniform(0.8, 1.2, (200, 4))
    right = []
    for share in (0.0, 0.5):
        parameters = DetectorParameters(decision=decision, size_share=share, profile_share=0.0, size_margin=0.0)
        half = np.arange(200) % 2 == 0
        detector = VisualWordsDetector(["pole"], parameters=parameters).fit(
            counts[half], labels[half], sizes=sizes[half]
        )
        right.append((detector.detect(counts[~half], sizes[~half])[0] == labels[~half]).mean())
    assert right[0] < 0.7 and right[1] > 0.95


def test_others_most_like_an_example_vote(rng):
    counts, labels = planted(rng, 400)
    appearance = np.full((400, 4), 0.25)
    near = np.flatnonzero(labels < 0)[:6]
    counts = counts.tolil()
    counts[near] = counts[np.flatnonzero(labels == 0)[:6]]
    parameters = DetectorParameters(max_others=12, size_share=0.0, profile_share=0.0, size_margin=0.0)
    detector = VisualWordsDetector(["pole", "car"], parameters=parameters)
    detector.fit(csr_array(counts), labels, profiles=appearance, scenes=np.arange(400) % 5)
    against = detector.queries_["pole"]
    twins = weigh_words(csr_array(counts[near]), detector.inverse_frequency_).toarray()
    known = against.appearance.bags.toarray()[against.weights < 0]
    assert all((np.abs(known - twin).max(axis=1) < 1e-12).any() for twin in twins)


@pytest.mark.parametrize("decision", ["weighted", "nearest"])
def test_profiles_separate_objects_of_the_same_words_and_size(rng, decision):
    counts = csr_array(rng.poisson(np.full((200, 30), 1.0)).astype(np.float64))
    labels = np.repeat([0, -1], 100)
    profiles = rng.dirichlet(np.full(8, 5.0), 200) * np.where(
        labels[:, None] == 0, [[1] * 4 + [0] * 4], [[0] * 4 + [1] * 4]
    )
    half = np.arange(200) % 2 == 0
    right = []
    for share in (0.0, 0.5):
        parameters = DetectorParameters(decision=decision, size_share=0.0, profile_share=share, size_margin=0.0)
        detector = VisualWordsDetector(["pole"], parameters=parameters).fit(
            counts[half], labels[half], profiles=profiles[half]
        )
        again = VisualWordsDetector.from_arrays(detector.to_arrays())
        right.append((again.detect(counts[~half], profiles=profiles[~half])[0] == labels[~half]).mean())
    assert right[0] < 0.7 and right[1] > 0.95
    with pytest.raises(DataError, match="one profile each"):
        detector.score(counts, profiles=profiles[:3])
    with pytest.raises(ParameterError, match="must not exceed 1 together, got 0.7 and 0.4"):
        DetectorParameters(size_share=0.7, profile_share=0.4)


def test_counterexamples_are_sampled_and_a_single_scene_has_threshold_one_half(rng):
    counts, labels = planted(rng, 300)
    parameters = DetectorParameters(max_others=20)
    detector = VisualWordsDetector(["pole", "car"], parameters=parameters).fit(counts, labels, scenes=np.zeros(300))
    assert (detector.thresholds == 0.5).all()
    assert all((q.weights < 0).sum() <= 20 + (labels >= 0).sum() for q in detector.queries_.values())
    unseen, truth = planted(rng, 150)
    assert (detector.detect(unseen)[0] == truth).mean() > 0.9
    with pytest.raises(DataError, match="all training objects are a pole"):
        VisualWordsDetector(["pole"]).fit(counts[labels == 0], labels[labels == 0])


def test_sizes_are_heights_above_the_ground_and_extents(rng):
    road = rng.uniform([0, 0, 9.98], [20, 10, 10.0], (20000, 3))
    slab = rng.uniform([5, 4, 12.0], [9, 6, 13.0], (9000, 3))
    turned = slab.copy()
    turned[:, :2] = (slab[:, :2] - [7, 5]) @ np.array([[0.8, 0.6], [-0.6, 0.8]]) + [14, 5]
    owner = np.repeat([-1, 0, 2], [20000, 9000, 9000])
    sizes = measure_sizes(np.concatenate([road, slab, turned]), owner)
    for k in (0, 2):
        np.testing.assert_allclose(sizes[k], [2.0, 3.0, 4.0, 2.0], atol=0.15)
    assert (sizes[1] == 0).all()
    lone = measure_sizes(slab, np.zeros(9000, int))  # no ground anywhere: the object's own lowest point
    np.testing.assert_allclose(lone[0, :2], [0.0, 1.0], atol=0.05)
    assert measure_sizes(road, np.full(20000, -1)).shape == (0, 4)


def test_similarity_of_sizes_by_hand():
    one, other = np.array([[0.0, 7.5, 0.7, 0.2]]), np.array([[0.5, 3.5, 0.7, 0.2], [0.0, 7.5, 0.7, 0.2]])
    np.testing.assert_allclose(size_similarity(one, other), [[np.sqrt(0.5 * 0.5), 1.0]])
    np.testing.assert_array_equal(within_sizes(other, one, 1.5), [False, True])
    np.testing.assert_array_equal(within_sizes(other, one, 2.01), [True, True])
    assert not within_sizes(other, one[:0], 2.0).any()
    with pytest.raises(DataError, match="sizes need 4 columns"):
        size_similarity(one[:, :2], other)


def test_a_class_without_training_objects_gives_a_warning_and_is_never_detected(rng, caplog):
    counts, labels = planted(rng, 60)
    detector = VisualWordsDetector(["pole", "car", "tram"]).fit(counts, labels)
    assert "No training object is a tram" in caplog.text
    again = VisualWordsDetector.from_arrays(detector.to_arrays())
    for each in (detector, again):
        assert set(each.detect(counts)[0].tolist()) == {-1, 0, 1}
        assert (each.score(counts)[:, 2] == 0).all()


def test_detector_is_rebuilt_from_its_arrays(rng):
    counts, labels = planted(rng, 100)
    detector = VisualWordsDetector(["pole", "car"]).fit(counts, labels)
    again = VisualWordsDetector.from_arrays(detector.to_arrays())
    assert again.score(counts).tobytes() == detector.score(counts).tobytes()
    np.testing.assert_array_equal(again.detect(counts)[0], detector.detect(counts)[0])


def test_bad_input(rng):
    counts, labels = planted(rng, 30)
    with pytest.raises(DataError, match=r"\(29,\) labels for 30 objects"):
        VisualWordsDetector(["pole"]).fit(counts, labels[:-1])
    with pytest.raises(DataError, match="2 words for the objects of 1 groups"):
        count_words(np.array([0, 1]), np.array([0]), n_objects=1, stopped=np.zeros(2, bool))
    with pytest.raises(DataError, match="bags of 60 and 3 words cannot be compared"):
        similarity(counts, csr_array((1, 3)))
    with pytest.raises(ParameterError, match=r"max_queries .*got 0"):
        DetectorParameters(max_queries=0)
    with pytest.raises(ParameterError, match=r"decision .*got 'best'"):
        DetectorParameters(decision="best")
    with pytest.raises(ParameterError, match=r"size_share .*got 2"):
        DetectorParameters(size_share=2)
    with pytest.raises(ParameterError, match=r"size_margin .*got 0\.5"):
        DetectorParameters(size_margin=0.5)
    with pytest.raises(ParameterError, match="penalty must be above 0, got 0"):
        DetectorParameters(penalty=0)
    with pytest.raises(DataError, match=r"30 objects .*got \(30, 3\)"):
        VisualWordsDetector(["pole"]).fit(counts, labels, sizes=np.zeros((30, 3)))


def test_a_scene_without_objects_and_a_cloud_without_any(rng):
    from mlsroad_pipeline.algorithms.core.classes import ClassScheme
    from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
    from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
    from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters, segment_scene
    from mlsroad_pipeline.papers.shared.detection.detector import DetectionStages, detect_objects, label_cloud
    from mlsroad_pipeline.papers.shared.detection.scoring import DetectionParameters, object_classes
    from mlsroad_pipeline.papers.shared.detection.training import DetectorTraining
    from mlsroad_pipeline.papers.yu2016.visual_words.groups import describe_objects
    from mlsroad_pipeline.papers.yu2016.visual_words.training import VisualWordsParameters, train_detector

    members = (("light_pole",), ("road", "tree"))
    scheme = ClassScheme("test", ("pole", "other"), members, ("unlabelled",), (64, 1))
    detection = DetectionParameters("test", ("pole",), min_points=5)
    parameters = VisualWordsParameters(regions={"voxel_size": 0.1, "seed_resolution": 0.3})
    road = rng.uniform([0, 0, 0], [20, 6, 0.03], (9000, 3))
    poles = [rng.uniform([x, 3, 0.1], [x + 0.1, 3.1, 5], (700, 3)) for x in (4, 10, 16)]
    bush = rng.uniform([12.5, 1, 0.1], [14, 2, 1], (3000, 3))
    xyz = np.concatenate([road, *poles, bush])
    label = np.repeat(np.array([1, 41, 31], np.uint8), [9000, 2100, 3000])
    intensity = rng.random(len(xyz)).astype(np.float32)
    columns = {"label": label, "core": np.ones(len(xyz), bool), "intensity": intensity}
    scene = PointCloud(xyz, columns, source="street")
    stages = DetectionStages(GroundParameters(), SegmentationParameters())
    ground = {"ground": label == 1}
    objects = segment_scene(scene, ground, stages.segmentation)
    groups = describe_objects(scene, objects, parameters=parameters.groups)
    named = object_classes(scene, objects, scheme=scheme, parameters=detection)
    assert (named["label"] == 0).sum() == 3
    bare, nothing = scene.select(np.arange(9000)), {"objects": np.full(9000, -1, np.int32)}
    no_groups = describe_objects(bare, nothing, parameters=parameters.groups)
    nameless = object_classes(bare, nothing, scheme=scheme, parameters=detection)
    bundle = train_detector(
        {"train.a": groups, "train.b": no_groups}, {"train.a": named, "train.b": nameless},
        DetectorTraining("visual_words", parameters, stages, detection, scheme, {}),
    )  # fmt: skip
    assert bundle.metadata["variants"] == ["geometry+intensity", "geometry"]
    given = scene.with_columns(ground=ground["ground"], height=xyz[:, 2].astype(np.float32))
    for cloud in (given, given.without_columns(["intensity"])):
        found, confidence = label_cloud(cloud, bundle)
        assert (found[label == 41] == 0).mean() > 0.9 and (found[label == 1] == -1).all()
        assert (confidence[found == -1] == 0).all() and (confidence[found == 0] > 0).all()
    alone = train_detector(
        {"train.a": groups}, {"train.a": named}, DetectorTraining(
            "visual_words", replace(parameters, without_intensity=False), stages, detection, scheme, {}
        ),
    )  # fmt: skip
    assert alone.metadata["variants"] == ["geometry+intensity"]
    assert (detect_objects(groups, alone)["label"] == detect_objects(groups, bundle)["label"]).all()
    with pytest.raises(DataError, match="was trained with intensity alone"):
        label_cloud(given.without_columns(["intensity"]), alone)
    bare = PointCloud(road, {"core": np.ones(9000, bool), "label": label[:9000]}, source="bare road")
    nothing = segment_scene(bare, {"ground": np.ones(9000, bool)}, stages.segmentation)
    described = describe_objects(bare, nothing, parameters=parameters.groups)
    assert detect_objects(described, bundle)["label"].shape == (0,)
    with pytest.raises(DataError, match="the split 'train' is empty"):
        train_detector({}, {}, DetectorTraining("visual_words", parameters, stages, detection, scheme, {}))
    empty = object_classes(bare, nothing, scheme=scheme, parameters=detection)
    with pytest.raises(DataError, match="no groups to make words of"):
        train_detector(
            {"train.a": described}, {"train.a": empty},
            DetectorTraining("visual_words", parameters, stages, detection, scheme, {}),
        )  # fmt: skip


def test_words_are_counted_for_wanted_objects_alone():
    class Words:
        stopped = np.zeros(4, bool)

        def quantise(self, groups):
            return np.asarray(groups.scales[:, 0], dtype=np.int32)

    n = 6
    arrays = {
        "descriptors": np.zeros((n, 1, 20), np.float32), "orientations": np.zeros((n, 1, 3), np.float32),
        "scales": np.array([0, 1, 1, 2, 3, 3], np.float32)[:, None], "objects": np.array([0, 0, 1, 1, 2, 2], np.int32),
        "n_objects": np.array(3),
    }  # fmt: skip
    all_of_them = bag_objects(arrays, Words(), intensity=True)
    some = bag_objects(arrays, Words(), intensity=True, wanted=np.array([True, False, True]))
    assert all_of_them.toarray().tolist() == [[1, 1, 0, 0], [0, 1, 1, 0], [0, 0, 0, 2]]
    assert some.toarray().tolist() == [[1, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 2]]
