"""Objects cut from scenes, sets of them, and models of recognisers from training to labelled points."""

import numpy as np
import pytest
from helpers.recognisers import MACHINE, PARAMETERS, RECOGNITION, SCHEME, car, pole, trained, training_set
from sklearn.metrics import f1_score

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.model_store.bundle_files import load_bundle, save_bundle
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import JointNetParameters
from mlsroad_pipeline.papers.shared.recognition import cutting as recognition_objects
from mlsroad_pipeline.papers.shared.recognition import recogniser as recognisers
from mlsroad_pipeline.papers.shared.recognition.object_set import ObjectSet
from mlsroad_pipeline.papers.shared.recognition.recogniser import score_recognitions


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


def prepared(*objects):
    """A cloud whose objects are known to stand off the ground, metres apart."""
    xyz = np.concatenate([np.asarray(points, dtype=np.float64) + [20.0 * i, 0, 0] for i, points in enumerate(objects)])
    return PointCloud(xyz, {"ground": np.zeros(len(xyz), bool), "height": np.zeros(len(xyz), np.float32)})


@pytest.mark.parametrize("slug", PARAMETERS)
def test_objects_of_hardly_any_points_are_labelled_or_left_out(rng, slug):
    bundle = trained(rng, slug, min_points=1)
    few = [np.zeros((1, 3)), np.zeros((2, 3)), rng.normal(size=(2, 3)), np.full((200, 3), 7.0), pole(rng, [0, 0, 0])]
    labels, confidence = label_cloud(bundle, prepared(*few))
    assert set(np.unique(labels)) <= {0, 1} and np.isfinite(confidence).all()  # every object is a pole or a car
    assert ((confidence > 0) & (confidence <= 1)).all()
    stored = bundle.metadata["parameters"]
    asking = {**stored, "recognition": {**stored["recognition"], "min_points": 20}}
    choosy = ModelBundle(bundle.slug, bundle.arrays, {**bundle.metadata, "parameters": asking})
    small, score = label_cloud(choosy, prepared(*few))
    assert (small[:5] == -1).all() and (score[:5] == 0).all()  # below `min_points`
    assert np.array_equal(small[5:], labels[5:])
    empty, _ = label_cloud(bundle, PointCloud(np.zeros((0, 3))))
    assert len(empty) == 0
    broken = prepared(*few)
    broken.xyz[3, 1] = np.nan
    with pytest.raises(DataError, match="NaN"):
        label_cloud(bundle, broken)


@pytest.mark.parametrize("slug", PARAMETERS)
def test_models_that_are_damaged_or_of_other_classes_are_named(rng, slug, tmp_path):
    bundle = trained(rng, slug)
    other = {**bundle.arrays, "classes": np.array([0, 9])}
    with pytest.raises(DataError, match=rf"model '{slug}' has the labels \[0, 9\], of 4 classes"):
        recognisers.load_recogniser(ModelBundle(bundle.slug, other, bundle.metadata))
    swapped = {**bundle.arrays, "classes": np.array([0, 2])}
    with pytest.raises(DataError, match=rf"model '{slug}' was trained on pole, car; its arrays are of pole, bin"):
        recognisers.load_recogniser(ModelBundle(bundle.slug, swapped, bundle.metadata))
    third = {**bundle.arrays, "classes": np.array([0, 1, 2])}
    with pytest.raises(DataError, match="3 classes|not 3"):
        recognisers.load_recogniser(ModelBundle(bundle.slug, third, bundle.metadata))
    lacking = {k: v for k, v in bundle.arrays.items() if k == "classes"}
    with pytest.raises(DataError, match="lack|do not fit"):
        recognisers.load_recogniser(ModelBundle(bundle.slug, lacking, bundle.metadata))
    save_bundle(bundle, tmp_path)
    file = tmp_path / "arrays.npz"
    whole = file.read_bytes()
    for damaged in (whole[:-100], whole[: len(whole) // 2] + b"\0\1\2\3" + whole[len(whole) // 2 + 4 :], b""):
        file.write_bytes(damaged)
        with pytest.raises(ReadError, match=rf"{tmp_path.name}.*damaged"):
            load_bundle(tmp_path)


def test_methods_and_parameters_that_do_not_exist_are_named(rng):
    bundle = trained(rng)
    with pytest.raises(ParameterError, match="unknown recogniser 'mystery'"):
        recognisers.load_recogniser(ModelBundle("mystery", bundle.arrays, bundle.metadata))
    with pytest.raises(ParameterError, match="unknown recogniser 'mystery'"):
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
