"""The six methods of luo2016 on odd training scenes and odd clouds: a clear error, or a stated result."""

import re

import numpy as np
import pytest
from references.patches import SCHEME, prepare, street

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.papers.luo2016.max_margin_markov.classifier import MarginParameters
from mlsroad_pipeline.papers.luo2016.patch_forest.classifier import PatchForestParameters
from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import PatchGraphParameters
from mlsroad_pipeline.papers.luo2016.patch_graph.refined_classifier import GridParameters, train_refinement
from mlsroad_pipeline.papers.luo2016.patch_svm.classifier import PatchSvmParameters
from mlsroad_pipeline.papers.luo2016.shape_based import labeller as shape_based
from mlsroad_pipeline.papers.luo2016.shape_based import labeller as shape_training
from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters, PatchStages
from mlsroad_pipeline.papers.shared.patches.labelling import label_patches
from mlsroad_pipeline.papers.shared.patches.models import train as train_classifier
from mlsroad_pipeline.papers.shared.patches.training import PatchTraining, join_training_scenes, number_surveys

STAGES = PatchStages(GroundParameters(), PatchParameters())
SVM = PatchSvmParameters(costs=[10.0], gammas=[0.1], cv_per_class=40, max_per_class=80)
GRAPH = PatchGraphParameters(n_matches=3, scene_length=3.0)
GRID = GridParameters((0.2,), (10.0,))
SHAPES = shape_based.ShapeParameters(n_trees=10)
METHODS = ("patch_svm", "patch_forest", "max_margin_markov", "patch_graph", "patch_graph_mrf", "shape_based")
PATCHWISE = METHODS[:-1]


def train(method, clouds, graph=GRAPH):
    """Train a method on whole clouds, from raw coordinates on."""
    patches = {str(k): prepare(cloud) for k, cloud in enumerate(clouds)}
    if method == "shape_based":
        rows = [
            shape_training.training_objects(c, find_ground(c, STAGES.ground), p, scheme=SCHEME, parameters=SHAPES)
            for c, p in zip(clouds, patches.values(), strict=True)
        ]
        return shape_training.fit(rows, parameters=SHAPES, stages=STAGES, scheme=SCHEME, trained_on={})
    labels = {key: label_patches(clouds[int(key)], found, SCHEME) for key, found in patches.items()}
    training = PatchTraining(*join_training_scenes(patches, labels), STAGES, SCHEME, {})
    if method != "patch_graph_mrf":
        parameters = {
            "patch_svm": SVM, "patch_forest": PatchForestParameters(), "patch_graph": graph,
            "max_margin_markov": MarginParameters(n_rounds=6, fit_rows=1500),
        }  # fmt: skip
        return train_classifier(training, slug=method, parameters=parameters[method])
    transfer = train_classifier(training, slug="patch_graph", parameters=graph)
    return train_refinement(training, transfer, slug=method, graph_parameters=graph, parameters=GRID)


@pytest.fixture(scope="module")
def models():
    """Models of streets that have no vehicle."""
    return {method: train(method, [street(seed, n=1500) for seed in range(2)]) for method in METHODS}


def right(labels, truth, rows):
    return (labels[rows] == truth[rows]).mean()


def test_scenes_of_one_file_or_drive_are_one_survey():
    keys = ["train.b.scene_00001", "train.a.scene_00000", "train.b.scene_00000", "train.a", "train_2.a.scene_00000"]
    assert number_surveys(keys).tolist() == [0, 0, 1, 1, 2]  # in the order of the names
    assert number_surveys(["train.block_2", "train.block_1", "7"]).tolist() == [0, 1, 2]


@pytest.mark.parametrize("method", METHODS)
def test_a_class_missing_from_training_is_warned_of_and_never_predicted(method, models, caplog):
    cloud = street(9, n=1500)
    labels, confidence = label_cloud(models[method], cloud)
    truth, missing = SCHEME.encode(cloud["label"]), SCHEME.classes.index("vehicle")
    given = truth > 0 if method == "shape_based" else truth >= 0  # it leaves the ground without labels
    assert right(labels, truth, given) > 0.85
    assert not (labels == missing).any() and (confidence[labels >= 0] > 0).all()
    train(method, [street(seed, n=300) for seed in range(2)])
    assert re.search(rf"{method}: no training \w+ of .*vehicle: they are never predicted", caplog.text)


@pytest.mark.parametrize("method", METHODS)
def test_colour_may_be_missing_from_the_cloud_or_from_training(method, models, caplog):
    bare = street(9, n=1500, colour=False).without_columns(["core"])
    truth = SCHEME.encode(bare["label"])
    rows = truth > 0 if method == "shape_based" else truth >= 0
    labels, _ = label_cloud(models[method], bare)
    assert "street 9 has no rgb: it is labelled without" in caplog.text
    assert right(labels, truth, rows) > 0.7
    without = train(method, [street(seed, n=1500, colour=False) for seed in range(2)])
    assert right(label_cloud(without, bare)[0], truth, rows) > 0.8
    assert right(label_cloud(without, street(9, n=1500))[0], truth, rows) > 0.8  # colour that it has no use for


@pytest.mark.parametrize("method", METHODS)
def test_no_point_one_point_and_ground_alone_are_labelled(method, models):
    cloud = street(9, n=1500)
    nothing, none = label_cloud(models[method], cloud.select(np.arange(0)))
    assert len(nothing) == len(none) == 0
    one, sure = label_cloud(models[method], cloud.select(np.arange(1)))  # one patch
    assert len(one) == 1 and 0 <= sure[0] <= 1
    ground = cloud.select(cloud["label"] == cloud["label"][0])
    labels, confidence = label_cloud(models[method], ground)
    if method == "shape_based":
        assert (labels == -1).all() and not confidence.any()
    else:
        assert (labels == 0).mean() > 0.95


def flat(seed):
    cloud = street(seed, n=800)
    return cloud.select(cloud["label"] == cloud["label"][0])


@pytest.mark.parametrize(
    ("method", "message"),
    [
        ("patch_svm", "patch_svm needs patches of at least two classes, got only class 0"),
        ("max_margin_markov", "all training patches are of class 0: training needs at least two classes"),
        ("shape_based", "no labelled object in the training scenes: check their labels and the ground filter"),
    ],
)
def test_training_scenes_of_one_class_are_an_error(method, message):
    with pytest.raises(DataError, match=message):
        train(method, [flat(0), flat(1)])


@pytest.mark.parametrize("method", ["patch_forest", "patch_graph", "patch_graph_mrf"])
def test_training_scenes_of_ground_make_a_model_that_predicts_ground(method):
    labels, confidence = label_cloud(train(method, [flat(0), flat(1)]), flat(2))
    assert (labels == 0).all() and np.allclose(confidence, 1, atol=0.05)


@pytest.mark.parametrize("method", ["patch_graph", "patch_graph_mrf"])
def test_too_few_scenes_for_k_say_what_to_change(method):
    few = PatchGraphParameters(n_matches=7, scene_length=3.0)
    with pytest.raises(DataError, match=r"at least 8 scenes, got 4: cut the training survey into shorter scenes"):
        train(method, [street(0, n=500), street(1, n=500)], graph=few)


@pytest.mark.parametrize("method", ["patch_svm", "patch_forest", "max_margin_markov"])
def test_methods_without_a_graph_learn_from_one_scene(method):
    cloud = street(9, n=1500)
    labels, _ = label_cloud(train(method, [street(0, n=1500)]), cloud)
    assert right(labels, SCHEME.encode(cloud["label"]), slice(None)) > 0.85


@pytest.mark.parametrize("method", METHODS)
def test_coordinates_that_are_not_finite_are_an_error(method, models):
    cloud = street(9, n=300)
    xyz = cloud.xyz.copy()
    xyz[7, 2] = np.nan
    with pytest.raises(DataError, match="finite"):
        label_cloud(models[method], PointCloud(xyz, dict(cloud.columns), source="broken"))
