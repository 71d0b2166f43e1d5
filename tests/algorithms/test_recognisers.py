"""Objects cut from scenes, sets of them, and models of recognisers from training to labelled points."""

import numpy as np
import pytest
from sklearn.metrics import f1_score

from mlsroad_pipeline.algorithms import recognisers, recognition_objects
from mlsroad_pipeline.algorithms.baselines.descriptor_machine import DescriptorParameters
from mlsroad_pipeline.algorithms.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.jointnet.parameters import JointNetParameters
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle, label_cloud, load_bundle, save_bundle
from mlsroad_pipeline.algorithms.object_detectors import DetectionStages
from mlsroad_pipeline.algorithms.object_segmentation import SegmentationParameters
from mlsroad_pipeline.algorithms.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.recognition import ObjectSet
from mlsroad_pipeline.algorithms.recognition_scores import score_recognitions
from mlsroad_pipeline.algorithms.scene_stages import GroundParameters
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import NormalizedCutParameters

SCHEME = ClassScheme(
    "test", ("pole", "car", "bin", "other"), (("light_pole",), ("car",), ("bin",), ("road", "tree")), ("unlabelled",), (64, 66, 67, 1)
)  # fmt: skip
SEGMENTATION = SegmentationParameters(method="euclidean", normalized_cut=NormalizedCutParameters(tolerance=0.8))
MACHINE = DescriptorParameters(costs=[10.0], gammas=[0.01], n_folds=2)
RECOGNITION = recognition_objects.RecognitionParameters(scheme="test", min_points=20)


def pole(rng, place, n=60):
    return rng.normal(size=(n, 3)) * [0.05, 0.05, 0] + rng.uniform([0, 0, 0.1], [0, 0, 5.0], (n, 3)) + place


def car(rng, place, n=120):
    return rng.uniform([-2, -0.8, 0.2], [2, 0.8, 1.5], (n, 3)) + place


def scene(rng, *, labels=True):
    """Two poles, a car, a blob of two classes and a thing too small; the second pole stands outside of the core."""
    parts = [
        pole(rng, [0, 0, 0]),
        car(rng, [10, 0, 0]),
        pole(rng, [30, 0, 0]),
        car(rng, [20, 0, 0]),
        pole(rng, [5, 5, 0], n=9),
    ]
    names = ["light_pole", "car", "light_pole", "car", "light_pole"]
    objects = np.repeat(np.arange(5), [len(p) for p in parts]).astype(np.int32)
    label = np.repeat([TAXONOMY[n] for n in names], [len(p) for p in parts]).astype(np.uint8)
    label[np.flatnonzero(objects == 3)[:50]] = TAXONOMY["tree"]
    ground = np.column_stack([rng.uniform(-5, 35, 500), rng.uniform(-5, 5, 500), np.zeros(500)])
    order = rng.permutation(len(label) + 500)
    xyz = np.concatenate([*parts, ground])[order]
    columns = {"core": xyz[:, 0] < 25, "intensity": np.full(len(xyz), 0.5, np.float32)}
    if labels:
        columns["label"] = np.append(label, np.full(500, TAXONOMY["road"], np.uint8))[order]
    return PointCloud(xyz, columns), {"objects": np.append(objects, np.full(500, -1, np.int32))[order]}


def training_set(rng, n=8):
    objects = [make(rng, rng.uniform(-40, 40, 3)) for _ in range(n) for make in (pole, car)]
    return ObjectSet.from_objects(objects, [0, 1] * n)


def trained(rng, slug="hierarchy_descriptor", parameters=MACHINE):
    return recognisers.train_recogniser(
        [training_set(rng).to_arrays()],
        slug=slug,
        parameters=parameters,
        recognition=RECOGNITION,
        stages=DetectionStages(GroundParameters(), SEGMENTATION),
        scheme=SCHEME,
        trained_on={"survey": "planted"},
    )


def test_objects_are_cut_with_the_class_of_their_points(rng):
    cloud, objects = scene(rng)
    cut = recognition_objects.cut_objects(cloud, objects, scheme=SCHEME, parameters=RECOGNITION)
    assert cut["object"].tolist() == [0, 1, 3] and cut["label"].tolist() == [0, 1, -1]
    found = ObjectSet.from_arrays(cut)
    for number, points in zip(cut["object"], found.objects, strict=True):
        wanted = cloud.xyz[objects["objects"] == number]
        assert np.array_equal(np.sort(points, axis=0), np.sort(wanted, axis=0))
    assert (found.intensities[0] == 0.5).all()
    unlabelled = recognition_objects.cut_objects(*scene(rng, labels=False), scheme=SCHEME, parameters=RECOGNITION)
    assert unlabelled["label"].tolist() == [-1, -1, -1]
    nothing = {"objects": np.full(len(cloud), -1, np.int32)}
    assert (
        len(
            ObjectSet.from_arrays(
                recognition_objects.cut_objects(cloud, nothing, scheme=SCHEME, parameters=RECOGNITION)
            )
        )
        == 0
    )


def test_sets_are_joined_taken_and_drawn(rng):
    one, other = training_set(rng, 3), training_set(rng, 2)
    joined = ObjectSet.join([one, other])
    assert len(joined) == 10 and joined.intensity is None
    picked = joined.take([7, 0])
    assert np.array_equal(picked.objects[0], other.objects[1]) and picked.label.tolist() == [1, 0]
    assert len(joined.take(joined.label == 1)) == 5 and len(joined.take(np.zeros(0, int)).objects) == 0
    few = recognition_objects.RecognitionParameters(max_per_class=2)
    assert recognition_objects.training_objects([joined.to_arrays()], few).label.tolist().count(0) == 2
    with pytest.raises(DataError, match="none of the 1 training objects has a known class"):
        recognition_objects.training_objects([ObjectSet.from_objects([np.zeros((3, 3))], [-1]).to_arrays()], few)
    with pytest.raises(DataError, match="there are no sets of objects"):
        ObjectSet.join([])
    with pytest.raises(DataError, match="2 classes and 3 points for 1 objects"):
        ObjectSet(np.zeros((3, 3)), np.array([0, 3]), np.zeros(2, np.int16))


@pytest.mark.parametrize("slug", ["hierarchy_descriptor", "hssi_net"])
def test_models_label_points_of_scenes_that_they_have_never_seen(rng, tmp_path, slug):
    small = {"epochs": 25, "n_members": 1, "n_turns": 1}
    bundle = trained(rng, slug, MACHINE if slug == "hierarchy_descriptor" else JointNetParameters(training=small))
    save_bundle(bundle, tmp_path)
    cloud, objects = scene(rng)
    ground = objects["objects"] < 0
    prepared = PointCloud(cloud.xyz, {"ground": ground, "height": np.zeros(len(ground), np.float32)})
    labels, confidence = label_cloud(load_bundle(tmp_path), prepared)
    assert (labels[ground] == -1).all() and (confidence[ground] == 0).all()
    assert (labels[objects["objects"] == 0] == 0).mean() > 0.9 and (labels[objects["objects"] == 1] == 1).mean() > 0.9
    assert (labels[objects["objects"] == 4] == -1).all()  # too small
    assert bundle.metadata["classes_given"] == ["pole", "car"]
    empty, _ = label_cloud(bundle, PointCloud(np.zeros((0, 3))))
    assert len(empty) == 0


def test_models_that_do_not_fit_are_named(rng):
    bundle = trained(rng)
    other = {**bundle.arrays, "classes": np.array([0, 9])}
    with pytest.raises(DataError, match=r"knows the labels \[0, 9\], of 4 classes"):
        recognisers.load_recogniser(ModelBundle(bundle.slug, other, bundle.metadata))
    with pytest.raises(ParameterError, match="'mystery' recognises no objects"):
        recognisers.load_recogniser(ModelBundle("mystery", bundle.arrays, bundle.metadata))
    with pytest.raises(ParameterError, match="'mystery' recognises no objects"):
        recognisers.make_recogniser("mystery", None)
    with pytest.raises(ParameterError, match="recognition.purity must be above 0"):
        recognition_objects.RecognitionParameters(purity=0)


def test_folds_are_scored_alone_and_together(rng):
    truth = {f"fold{k}": rng.integers(0, 4, 30) for k in range(3)}
    found = {name: np.where(rng.random(30) < 0.7, labels, 3 - labels) for name, labels in truth.items()}
    truth["fold0"][:2] = -1
    table, _ = score_recognitions(truth, found, method="shot", scheme=SCHEME, folds=True)
    assert list(dict.fromkeys(table["split"])) == ["fold0", "fold1", "fold2", "test"]
    values = table[table["class"] == "all"].set_index(["split", "metric"])["value"]
    every, named = np.concatenate([*truth.values()]), np.concatenate([*found.values()])
    known = every >= 0
    wanted = f1_score(every[known], named[known], average="weighted")
    assert values["test", "weighted_f1"] == pytest.approx(wanted)
    scenes, _ = score_recognitions(
        {"test.a": truth["fold1"]}, {"test.a": found["fold1"]}, method="shot", scheme=SCHEME, folds=False
    )
    assert set(scenes["split"]) == {"test"}
