"""Methods that label patches one by one: on planted classes, on bad input, and from raw coordinates on."""

import numpy as np
import pytest
from references.patches import SCHEME, prepare, street
from sklearn.ensemble import RandomForestClassifier

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.model_store.bundle_files import load_bundle, save_bundle
from mlsroad_pipeline.papers.luo2016.patch_forest import classifier as patch_forest
from mlsroad_pipeline.papers.luo2016.patch_forest.classifier import PatchForest, PatchForestParameters
from mlsroad_pipeline.papers.luo2016.patch_svm import classifier as patch_svm
from mlsroad_pipeline.papers.luo2016.patch_svm.classifier import PatchSvm, PatchSvmParameters
from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters, PatchStages
from mlsroad_pipeline.papers.shared.patches.features import COLOURED, GEOMETRY, draw_training_patches, patch_features
from mlsroad_pipeline.papers.shared.patches.labelling import build_patches, label_patch_scene, label_patches
from mlsroad_pipeline.papers.shared.patches.table import Patches
from mlsroad_pipeline.papers.shared.patches.training import PatchTraining, bundle_model, join_training_scenes

SVM = PatchSvmParameters(costs=[1.0, 10.0], gammas=[0.1], cv_per_class=60, max_per_class=100)
NO_EDGES = np.empty((0, 2), np.int32)


def fit_forest(patches, **changes):
    return PatchForest.fit(patches, parameters=PatchForestParameters(**changes), n_classes=4)


def fit_svm(patches, parameters=SVM):
    return PatchSvm.fit(patches, parameters=parameters, n_classes=4)


METHODS = pytest.mark.parametrize("fit", [fit_forest, fit_svm], ids=["forest", "svm"])


def planted(rng, n=300, *, scenes=4, classes=(0, 1, 3), colour=True):
    """Patches whose class is in their histogram and, more clearly, in their colour; class 2 is never seen."""
    label = rng.choice(classes, n)
    fpfh = rng.dirichlet(np.ones(8), n) + 1.5 * np.eye(8)[label]
    rgb = np.clip(np.eye(4)[label][:, :3] * 0.6 + rng.normal(0.2, 0.1, (n, 3)), 0, 1) if colour else None
    centroid = rng.random((n, 3)) * [40, 5, 3]
    return Patches(fpfh / 2.5, rgb, rng.random(n), centroid, rng.integers(0, scenes, n), label)


@pytest.fixture(scope="module")
def training():
    scenes = {f"train.{seed}": street(seed) for seed in range(3)}
    patches = {key: prepare(scene) for key, scene in scenes.items()}
    labels = {key: label_patches(scene, patches[key], SCHEME) for key, scene in scenes.items()}
    return scenes, patches, labels


def bundled(fit, patches, module, parameters):
    stages = PatchStages(GroundParameters(), PatchParameters())
    training = PatchTraining(patches, NO_EDGES, stages, SCHEME, {"survey": "planted"})
    return bundle_model(module.SLUG, fit(patches), training, parameters=parameters)


@METHODS
def test_planted_classes_are_found_with_and_without_colour(fit, rng):
    model, unseen = fit(planted(rng, 600)), planted(rng, 300)
    with_colour, without = model.predict_proba(unseen), model.predict_proba(unseen.with_columns(rgb=None))
    assert with_colour.shape == (300, 4) and with_colour.dtype == np.float32
    assert np.allclose(with_colour.sum(axis=1), 1, atol=1e-5) and not with_colour[:, 2].any()
    assert (with_colour.argmax(axis=1) == unseen.label).mean() > 0.97
    assert (without.argmax(axis=1) == unseen.label).mean() > 0.9
    assert not np.array_equal(with_colour, without)
    alone = fit(planted(np.random.default_rng(3), 600).with_columns(rgb=None))
    assert (
        alone.predict_proba(unseen).argmax(axis=1).tolist()
        == alone.predict_proba(unseen.with_columns(rgb=None)).argmax(axis=1).tolist()
    )


@METHODS
def test_same_seed_gives_the_same_bytes_and_arrays_give_the_same_model(fit, rng):
    patches, unseen = planted(rng, 300), planted(rng, 100)
    one, other = fit(patches), fit(patches)
    arrays = one.to_arrays()
    assert {name: array.tobytes() for name, array in arrays.items()} == {
        name: array.tobytes() for name, array in other.to_arrays().items()
    }
    assert not any(np.asarray(array).dtype.hasobject for array in arrays.values())
    again = type(one).from_arrays(arrays)
    assert again.predict_proba(unseen).tobytes() == one.predict_proba(unseen).tobytes()
    assert len(one.predict_proba(unseen.take(np.arange(1)))) == 1
    with pytest.raises(DataError, match="lack n_classes"):
        type(one).from_arrays({name: array for name, array in arrays.items() if name != "n_classes"})
    wide = Patches(np.zeros((2, 5)), None, *(np.zeros((2, *shape)) for shape in ((), (3,), (), ())))
    with pytest.raises(DataError, match=r"features .*got \(2, 6\)"):
        one.predict_proba(wide)


def test_forest_is_scikit_learns(rng):
    patches, unseen = planted(rng, 300), planted(rng, 100)
    model = RandomForestClassifier(10, max_depth=15, random_state=2016).fit(
        patch_features(patches, COLOURED), patches.label
    )
    found = fit_forest(patches).predict_proba(unseen)
    assert np.abs(found[:, model.classes_] - model.predict_proba(patch_features(unseen, COLOURED))).max() < 1e-6


def test_sample_is_balanced(rng):
    patches = planted(rng, 500)
    counts = np.bincount(draw_training_patches(patches, 40, seed=1).label)
    assert counts.tolist() == [40, 40, 0, 40]
    with pytest.raises(DataError, match="no labelled patches"):
        draw_training_patches(patches.with_columns(label=np.full(500, -1)), 40, seed=1)
    with pytest.raises(DataError, match="have no colour"):
        patch_features(patches.with_columns(rgb=None), COLOURED)
    assert patch_features(patches, GEOMETRY).shape == (500, 9)


def test_cross_validation_takes_the_better_parameters_and_holds_scenes_out(rng):
    patches = planted(rng, 400, colour=False)
    choice = PatchSvm.fit(
        patches, parameters=PatchSvmParameters(costs=[1e-6, 10.0], gammas=[0.1], cv_per_class=60), n_classes=4
    ).choice
    assert choice.cost == 10.0 and choice.mean_f1 > 0.9
    # A machine that only knows the scene cannot be rewarded for it: classes that differ from scene to scene by noise.
    noise = patches.with_columns(label=rng.integers(0, 2, 400))
    assert PatchSvm.fit(noise, parameters=SVM, n_classes=4).choice.mean_f1 < 0.62


def test_one_scene_is_cut_into_folds_with_a_warning(rng, caplog):
    patches = planted(rng, 200, scenes=1)
    assert isinstance(fit_svm(patches), PatchSvm)
    assert "1 training scenes are fewer than 3 folds" in caplog.text


def test_too_little_to_train_a_machine_is_named(rng):
    with pytest.raises(DataError, match="at least two classes, got only class 3"):
        fit_svm(planted(rng, 50, classes=(3,)))
    with pytest.raises(DataError, match="2 labelled patches are too few for 3 folds"):
        fit_svm(planted(rng, 50).take(np.array([0, 1])).with_columns(label=[0, 1]))
    one = fit_forest(planted(rng, 50, classes=(3,)))  # a forest of one class gives that class
    assert (one.predict_proba(planted(rng, 10)) == np.eye(4)[3]).all()


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        (PatchForestParameters, {"max_depth": 0}, "patch_forest.max_depth must be at least 1, got 0"),
        (PatchSvmParameters, {"costs": []}, r"patch_svm.costs must be numbers > 0, got \[\]"),
        (PatchSvmParameters, {"gammas": [0.1, -1]}, "patch_svm.gammas must be numbers > 0"),
        (PatchSvmParameters, {"n_folds": 1}, "patch_svm.n_folds must be at least 2, got 1"),
    ],
)
def test_parameters_out_of_range_are_named(kind, values, message):
    with pytest.raises(ParameterError, match=message):
        kind(**values)


def test_training_set_has_the_labelled_patches_of_the_cores_and_the_edges_between_them(training):
    scenes, stored, labels = training
    patches, edges = join_training_scenes(stored, labels)
    assert len(patches) == sum((found["label"] >= 0).sum() for found in labels.values())
    assert set(np.unique(patches.label)) == {0, 1, 2} and np.unique(patches.scene).tolist() == [0, 1, 2]
    assert (patches.scene[edges[:, 0]] == patches.scene[edges[:, 1]]).all() and (edges[:, 0] < edges[:, 1]).all()
    gaps = np.linalg.norm(patches.centroid[edges[:, 0]] - patches.centroid[edges[:, 1]], axis=1)
    assert gaps.max() < 0.4 * np.sqrt(3) and len(edges) > len(patches)
    assert (patches.centroid[:, 0] < 5.8).all()  # patches of the buffer have no labelled core points
    first = labels["train.0"]["label"]
    owner, truth = stored["train.0"]["patch_of_point"], SCHEME.encode(scenes["train.0"]["label"])
    core = scenes["train.0"]["core"]
    for p in range(0, len(first), 11):
        votes = np.bincount(truth[core & (owner == p)], minlength=4)
        assert first[p] == (votes.argmax() if votes.any() else -1)
    with pytest.raises(DataError, match="the split 'train' is empty"):
        join_training_scenes(stored, {})
    nothing = {key: {**found, "label": np.full_like(found["label"], -1)} for key, found in labels.items()}
    with pytest.raises(DataError, match="no patch of the training scenes is labelled"):
        join_training_scenes(stored, nothing)
    earlier = {key: {"label": found["label"]} for key, found in labels.items()}  # a store of an earlier version
    with pytest.raises(DataError, match=r"patch labels of scene train\.0 .* lack station"):
        join_training_scenes(stored, earlier)


@pytest.mark.parametrize(
    ("fit", "module", "parameters"),
    [(fit_forest, patch_forest, PatchForestParameters()), (fit_svm, patch_svm, SVM)],
    ids=["forest", "svm"],
)
def test_model_labels_a_cloud_from_raw_coordinates_on(fit, module, parameters, training, tmp_path, caplog):
    patches, _ = join_training_scenes(*training[1:])
    save_bundle(bundled(fit, patches, module, parameters), tmp_path)
    assert f"{module.SLUG}: no training patches of vehicle" in caplog.text
    bundle = load_bundle(tmp_path)
    cloud = street(9)
    outlier = np.arange(len(cloud)) % 50 == 0
    cloud = cloud.with_columns(outlier=outlier)
    label, confidence = label_cloud(bundle, cloud)
    truth = SCHEME.encode(cloud["label"])
    assert (label[outlier] == -1).all() and not confidence[outlier].any()
    assert (label[~outlier] == truth[~outlier]).mean() > 0.95
    assert 0.5 < confidence[~outlier].mean() <= 1
    kind = PatchForest if module is patch_forest else PatchSvm
    stored = label_patch_scene(cloud, prepare(cloud), bundle, kind)  # as in a comparison
    assert np.array_equal(stored["label"], label)
    bare = street(9, colour=False).without_columns(["core"])
    label, _ = label_cloud(bundle, bare)
    assert "has no rgb: it is labelled without" in caplog.text and (label == truth).mean() > 0.9
    assert len(label_cloud(bundle, bare.select(np.zeros(len(bare), bool)))[0]) == 0
    assert len(label_cloud(bundle, bare.select(np.arange(1)))[0]) == 1
    ground = bare.select(truth == 0)
    label, _ = label_cloud(bundle, ground)  # a scene of ground only
    assert (label == 0).mean() > 0.95


def test_model_says_which_histograms_it_needs(training):
    patches, _ = join_training_scenes(*training[1:])
    bundle = bundled(fit_forest, patches, patch_forest, PatchForestParameters())
    cloud = street(9, n=400)
    other = build_patches(cloud, find_ground(cloud, GroundParameters()), PatchParameters(n_bins=11))
    with pytest.raises(DataError, match=r"street 9: the model .*got 44"):
        label_patch_scene(cloud, other, bundle, PatchForest)
