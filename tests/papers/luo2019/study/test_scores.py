"""Study of luo2019: metrics by hand and by scikit-learn, sets split by street, disturbed training."""

from dataclasses import replace

import numpy as np
import pytest
from sklearn.metrics import f1_score, precision_score, recall_score

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters
from mlsroad_pipeline.papers.luo2019.study import scores as luo2019
from mlsroad_pipeline.papers.luo2019.study import sets as luo2019_sets
from mlsroad_pipeline.papers.luo2019.study.plan import StudyScale
from mlsroad_pipeline.papers.luo2019.study.runs import disturb_objects, mislabel
from mlsroad_pipeline.papers.luo2019.study.sets import (
    CutParameters,
    ObjectSetParameters,
    SimulatedObjectsParameters,
    SplitKey,
    composition_table,
    draw_split,
    name_segments,
    thin,
    wanted_objects,
)
from mlsroad_pipeline.papers.shared.recognition.disturbances import Disturbance
from mlsroad_pipeline.papers.shared.recognition.object_set import ObjectSet
from mlsroad_pipeline.papers.shared.studies.study import paper_table
from mlsroad_pipeline.simulation.parameters.presets import PRESETS

CUT = CutParameters(min_points=5, purity=0.8, completeness=0.5, max_points=40, segmentation="yang_dong", reach=25.0)


def objects_of(rng, sizes, labels):
    return ObjectSet.from_objects([rng.normal(size=(n, 3)) for n in sizes], labels, [rng.random(n) for n in sizes])


def test_a_precision_recall_curve_is_that_of_the_papers_equations(rng):
    label = rng.integers(0, 3, 60)
    scores = rng.dirichlet(np.ones(4), 60).astype(np.float32)
    threshold, precision, recall = luo2019.precision_recall(scores, label)
    assert recall[-1] == 1.0 and (np.diff(recall) >= 0).all()
    for at in (40, 100, 150):
        k = int(np.flatnonzero(np.isclose(threshold, at / 200))[0])
        rows = []
        for i in range(3):
            taken = [n for n in range(60) if abs(1 - float(scores[n, i])) <= at / 200]
            hits = sum(label[n] == i for n in taken)
            rows.append((hits / len(taken) if taken else np.nan, hits / (label == i).sum()))
        np.testing.assert_allclose((precision[k], recall[k]), np.nanmean(rows, axis=0))


def test_perfect_scores_have_an_area_of_one():
    label = np.array([0, 1, 1, 2])
    _, precision, recall = luo2019.precision_recall(np.eye(3)[label], label)
    assert luo2019.area_under(precision, recall) == 1.0
    assert np.isnan(luo2019.area_under(np.zeros(0), np.zeros(0)))


def test_means_over_classes_agree_with_scikit_learn(rng):
    label, predicted = rng.integers(0, 5, 200), rng.integers(0, 6, 200)
    label[label == 3] = 2  # a class without objects is in no mean
    found = luo2019.mean_figures(confusion_matrix(label, predicted, 6)[:, :6])
    given = {"labels": np.unique(label), "average": "macro", "zero_division": 0}
    assert found["f1"] == pytest.approx(f1_score(label, predicted, **given))
    assert found["precision"] == pytest.approx(precision_score(label, predicted, **given))
    assert found["recall"] == pytest.approx(recall_score(label, predicted, **given))
    assert found["accuracy"] == pytest.approx((label == predicted).mean())
    assert np.isnan(luo2019.mean_figures(np.zeros((2, 2)))["f1"])
    weighted = luo2019.weighted_f1(confusion_matrix(label, predicted, 6)[:, :6])
    assert weighted == pytest.approx(f1_score(label, predicted, average="weighted", zero_division=0))
    assert np.isnan(luo2019.weighted_f1(np.zeros((2, 2))))


def test_an_interval_draws_the_same_streets_for_both_methods(rng):
    one = [rng.integers(0, 9, (3, 3)) for _ in range(6)]
    same = luo2019.paired_interval(one, one, seed=1)
    assert same == (0.0, 0.0, 0.0)
    better = [m + 40 * np.eye(3, dtype=np.int64) for m in one]
    apart, low, high = luo2019.paired_interval(better, one, seed=1, n_draws=400)
    assert 0 < low < apart < high
    drawn = np.random.default_rng(1).multinomial(6, np.full(6, 1 / 6), size=400)
    slow = [
        luo2019.mean_f1(sum(n * m for n, m in zip(row, better, strict=True)))
        - luo2019.mean_f1(sum(n * m for n, m in zip(row, one, strict=True)))
        for row in drawn
    ]
    np.testing.assert_allclose((low, high), np.quantile(slow, [0.025, 0.975]))


def test_streets_are_in_one_split_alone():
    given = ObjectSetParameters(0.05, {}, 100, 40).seeds_of_splits()
    assert {name: len(seeds) for name, seeds in given.items()} == {"train": 28, "validation": 4, "test": 8}
    every = [seed for seeds in given.values() for seed in seeds]
    assert every == list(range(100, 140))
    assert [len(s) for s in ObjectSetParameters(0.05, {}, 0, 3).seeds_of_splits().values()] == [1, 1, 1]


def test_a_split_has_the_papers_imbalance_as_far_as_there_are_objects(rng):
    members = ("car", "light_pole", "person", "gantry", "traffic_sign", "tree")
    classes = zip(luo2019_sets.OBJECTS["smd6"], members, strict=True)
    scheme = ClassScheme("smd6", tuple(luo2019_sets.OBJECTS["smd6"]), tuple((m,) for _, m in classes), (), (1,) * 6)
    wanted = wanted_objects("smd6", ObjectSetParameters(0.01, {}, 1, 3), scheme)["train"]
    assert wanted == {0: 9, 1: 17, 2: 5, 3: 6, 4: 21, 5: 8}
    streets = {}
    for seed in (7, 8):
        label = rng.permutation(np.repeat(np.arange(5), 10))
        given = objects_of(rng, rng.integers(5, 9, 50), label)
        streets[f"seed_{seed}"] = {**given.to_arrays(), "street": np.full(50, seed)}
    found = draw_split(streets, limits=wanted, seed=3)
    assert np.bincount(found["label"], minlength=6).tolist() == [9, 17, 5, 6, 20, 0]
    assert found["found"].tolist() == [20] * 5 + [0]
    assert set(found["street"]) == {7, 8}
    joined = ObjectSet.join([ObjectSet.from_arrays(streets[key]) for key in streets])
    every = {points.tobytes(): label for points, label in zip(joined.objects, joined.label, strict=True)}
    drawn = ObjectSet.from_arrays(found)
    assert [every[points.tobytes()] for points in drawn.objects] == drawn.label.tolist()
    key = SplitKey("smd6", "train")
    table = composition_table({key: found}, {key: wanted}, {"smd6": scheme}).set_index("class")
    assert table.loc["traffic sign", ["paper", "wanted", "found", "objects"]].tolist() == [2930, 21, 20, 20]
    assert np.isnan(table.loc["tree", "median_points"])


def test_a_segment_is_named_by_its_instance_unless_it_is_a_piece_or_mixed():
    classes = np.array([-1, 4, 2, 2, 7], dtype=np.int16)
    parts = [  # segment, instance, points
        (0, 1, 12), (1, 1, 8),  # an instance in two pieces
        (2, 2, 10), (2, 3, 9), (2, 0, 1),  # two instances of a class
        (3, 4, 10), (3, 0, 6),  # too much of something else
        (5, 0, 7), (-1, 4, 3),
    ]  # fmt: skip
    segments, instances = (np.repeat([part[i] for part in parts], [part[2] for part in parts]) for i in (0, 1))
    found = name_segments(instances, classes, segments, purity=0.8, completeness=0.5)
    assert found.tolist() == [4, -1, 2, -1, -1, -1]
    found = name_segments(instances, classes, segments, purity=0.6, completeness=0.4)
    assert found.tolist() == [4, 4, 2, 7, -1, -1]
    assert not len(name_segments(instances, classes, np.full(len(instances), -1), purity=0.8, completeness=0.5))


def test_objects_cut_by_hand_are_the_simulators_instances(rng, monkeypatch):
    scheme = ClassScheme("two", ("light pole", "car", "other"), (("light_pole",), ("car",), ("road",)), (), (64, 66, 1))
    instance = rng.permutation(np.repeat([0, 17, 4, 9], [50, 20, 30, 3]))
    label = np.select([instance == 17, instance > 0], [TAXONOMY["car"], TAXONOMY["light_pole"]], TAXONOMY["road"])
    columns = {"label": label.astype(np.uint8), "instance": instance, "ground": instance == 0}
    street = PointCloud(rng.normal(size=(103, 3)), {**columns, "intensity": np.full(103, 0.5, np.float32)})
    monkeypatch.setattr(luo2019_sets, "make_street", lambda **_: street)
    found = luo2019_sets.cut_street(
        simulation=PRESETS["tiny"],
        ground=GroundParameters(),
        segmentation=SegmentationParameters(),
        scheme=scheme,
        wanted=["light pole", "car"],
        parameters=replace(CUT, segmentation="by_hand"),
    )
    assert found["label"].tolist() == [0, 1]  # numbered by instance; the one of three points is too small
    for points, number in zip(ObjectSet.from_arrays(found).objects, (4, 17), strict=True):
        np.testing.assert_array_equal(points, street.xyz[instance == number])


def test_large_objects_are_thinned_to_points_of_their_own(rng):
    given = objects_of(rng, [100, 7, 40], [0, 1, 2])
    found = thin(given, 40, seed=5)
    assert np.diff(found.indptr).tolist() == [40, 7, 40]
    np.testing.assert_array_equal(found.objects[1], given.objects[1])
    own = {tuple(p): i for p, i in zip(given.objects[0], given.intensities[0], strict=True)}
    assert [own[tuple(p)] for p in found.objects[0]] == found.intensities[0].tolist()


def test_wrong_classes_are_as_many_as_asked_for(rng):
    given = objects_of(rng, [5] * 64, rng.integers(0, 3, 64) * 2)
    found = mislabel(given, 0.25, seed=1)
    assert (found.label != given.label).sum() == 16
    assert set(found.label) <= {0, 2, 4}
    np.testing.assert_array_equal(mislabel(given, 0.0, seed=1).label, given.label)


def test_an_object_is_disturbed_the_same_whatever_stands_behind_it(rng):
    given = objects_of(rng, [50, 60, 70], [0, 1, 2])
    level = Disturbance(keep=0.5, noise=0.05, outliers=0.2, occlusion=0.1)
    every, two = disturb_objects(given, level, 4), disturb_objects(given.take([0, 1]), level, 4)
    np.testing.assert_array_equal(every.objects[1], two.objects[1])
    np.testing.assert_array_equal(every.intensities[1], two.intensities[1])
    assert disturb_objects(given, Disturbance(), 4) is given


def test_the_papers_sets_have_the_sizes_that_it_tells():
    assert sum(luo2019_sets.OBJECTS["hdr9"].values()) == 22652
    assert sum(luo2019_sets.OBJECTS["smd6"].values()) == 9493
    two = paper_table("luo2019", "table_2")
    assert two.loc[two["method"] == "jointnet", "paper_f1"].round(3).tolist() == [0.958, 0.923, 0.707]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seeds": []}, "seeds must not be empty"),
        ({"methods": {"voxnet": {}}}, "unknown methods"),
        ({"training": {"rain": [1]}}, "unknown"),
        ({"training": {"labels": [1.5]}}, "labels"),
        ({"combined": [[0.1]]}, "four numbers"),
        ({"keep": [0.0]}, "keep must be above 0"),
    ],
)
def test_a_wrong_scale_is_named(changes, message):
    given = {"seeds": [1], "sizes": [8], "noise": [], "keep": [], "outliers": [], "occlusion": [], "training": {},
             "combined": [], "variants": {}, "images_alone": {}, "grid": [], "methods": {}, "tuning": {}}  # fmt: skip
    with pytest.raises(ParameterError, match=message):
        StudyScale(**{**given, **changes})


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"hdr9": {"share": 2.0}}, "share must be"),
        ({"hdr9": {"streets": 2}}, "streets must be at least 3"),
        ({"hdr9": {"survey": {"seed": 1}}}, "survey must not have a seed; the seeds of the streets"),
        ({"hdr9": {"speed": 1}}, "must have"),
        ({"kitti": {}}, "no such set"),
    ],
)
def test_a_wrong_set_is_named(given, message):
    base = {"share": 0.1, "survey": {}, "first_seed": 1, "streets": 3}
    with pytest.raises(ParameterError, match=message):
        SimulatedObjectsParameters("a", {"a": {name: {**base, **changes} for name, changes in given.items()}}, CUT, 1)
