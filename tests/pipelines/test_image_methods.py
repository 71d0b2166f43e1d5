"""Labels through images and their fusion, from a tiny survey to scores and registered models."""

import logging
import shutil

import numpy as np
import pandas as pd
import pytest
from references_wiring import TINY, label, run, session_of, shared_run

from mlsroad_pipeline.algorithms.evaluation import find_scheme
from mlsroad_pipeline.algorithms.exceptions import ReadError
from mlsroad_pipeline.algorithms.fusion.two_methods import TwoMethodFusion
from mlsroad_pipeline.algorithms.ingest import IngestParameters
from mlsroad_pipeline.datasets.image_work import LabelledImages, images_of_drives
from mlsroad_pipeline.datasets.model_registry_dataset import load_registered_bundle
from mlsroad_pipeline.datasets.survey_parameters import SurveyParameters
from mlsroad_pipeline.datasets.survey_plan import plan_comparison

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

METHODS = ["image_labels", "fusion"]


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """Run both pipelines on what the whole comparison has stored, in a folder of their own."""
    folder = tmp_path_factory.mktemp("images")
    tracked = shutil.ignore_patterns("mlflow.db", "mlartifacts", "mlruns")
    shutil.copytree(shared_run(tmp_path_factory), folder, dirs_exist_ok=True, ignore=tracked)
    with session_of(folder, **TINY) as session:
        session.run(pipeline_names=METHODS)
    return folder


@pytest.fixture(scope="module")
def stored(project):
    """Everything that is compared below, read once."""
    names = ("scenes", "detrended_forest.labels", "image_labels.labels", "fusion.labels")
    with session_of(project, **TINY) as session:
        context = session.load_context()
        found = {name: context.catalog.load(name).load_all() for name in names}
        classes = context.params["classes"]
        models = {name: load_registered_bundle(f"mlsroad-{name}") for name in METHODS}
    schemes = [find_scheme(classes["schemes"], name) for name in ("road_inventory", "tomic2019")]
    return found, models, schemes


def scores_of(project, slug):
    table = pd.read_csv(project / f"data/08_reporting/scores/{slug}.csv")
    assert list(table.columns) == ["method", "split", "class", "metric", "value", "support"]
    return table.set_index(["method", "split", "class", "metric"])


def accuracy(scene, label, schemes, rows):
    """Share of the core points among `rows` whose class, in the scheme of the scores, is the true one."""
    trained, scored = schemes
    coarse = np.append(trained.coarsen(scored), -1)[label]
    truth = scored.encode(scene["label"])
    rows = rows & scene["core"] & (truth >= 0)
    return int((coarse[rows] == truth[rows]).sum()), int(rows.sum())


def test_scores_over_all_and_over_visible_points_are_those_of_the_stored_labels(project, stored):
    found, _, schemes = stored
    table = scores_of(project, "image_labels")
    total = np.zeros((2, 2))
    for key, labels in found["image_labels.labels"].items():
        scene = found["scenes"][key]
        assert np.array_equal(labels["label"] >= 0, labels["seen"])
        assert np.array_equal(labels["n_images"].sum(axis=1) > 0, labels["seen"])
        total[0] += accuracy(scene, labels["label"], schemes, np.ones(len(scene), bool))
        total[1] += accuracy(scene, labels["label"], schemes, labels["seen"])
    assert 0.2 < total[1, 1] / total[0, 1] < 0.95  # some points are in no image
    for split, (right, count) in zip(("test", "test_visible"), total, strict=True):
        row = table.loc["image_labels", split, "all", "overall_accuracy"]
        assert row["support"] == count and row["value"] == pytest.approx(right / count)
    assert total[1, 0] / total[1, 1] > 0.3  # a dozen steps teach that most of it is road


def test_fusion_is_learned_on_the_first_scenes_and_scored_on_the_others(project, stored):
    found, _, schemes = stored
    keys = list(found["image_labels.labels"])
    assert list(found["fusion.labels"]) == keys[len(keys) // 2 :] and len(keys) >= 2
    table = scores_of(project, "fusion")
    assert set(table.index.get_level_values("split")) == {"test2", "test2_visible"}
    names = {"fusion": "label", "fusion_pool": "pool_label", "image_labels": "image_label"}
    for method, name in (*names.items(), ("detrended_forest", "feature_label")):
        total = np.zeros(2)
        for key, labels in found["fusion.labels"].items():
            total += accuracy(found["scenes"][key], labels[name], schemes, np.ones(len(labels["label"]), bool))
        value = table.loc[method, "test2", "all", "overall_accuracy"]
        assert value["support"] == total[1] and value["value"] == pytest.approx(total[0] / total[1])


def test_registered_model_holds_what_gives_the_stored_labels(stored):
    found, models, _ = stored
    bundle = models["fusion"]
    assert (
        bundle.metadata["cameras"] == models["image_labels"].metadata["cameras"]
        and len(bundle.metadata["cameras"]) == 3
    )
    fusion = TwoMethodFusion.from_arrays(dict(bundle.arrays))
    assert fusion.cameras.f1.shape == (3, len(bundle.classes)) and fusion.methods.f1.shape == (2, len(bundle.classes))
    for key, labels in found["fusion.labels"].items():
        features = found["detrended_forest.labels"][key]
        cameras = found["image_labels.labels"][key]["probabilities"].transpose(1, 0, 2).astype(np.float32)
        again = fusion.fuse(features["label"], features["confidence"], cameras)
        assert np.array_equal(again.rule, labels["label"]) and np.array_equal(again.pool, labels["pool_label"])
        unseen = ~labels["seen"]
        assert unseen.any() and np.array_equal(labels["label"][unseen], features["label"][unseen])


def test_a_second_run_finds_everything_valid_and_registers_nothing_new(project, caplog):
    with caplog.at_level(logging.INFO):
        run(project, "image_labels", **TINY)
    told = " ".join(caplog.messages)
    assert "Unchanged: mlsroad-image_labels version 1" in told and "no camera sees" in told


def copied(project, folder, *, drives):
    """Copy the points of both drives and the images of some."""
    for path in (project / "data/01_raw").rglob("*.laz"):
        if path.parent.name in drives:
            shutil.copytree(path.parent, folder / path.parent.name)
        else:
            (folder / path.parent.name).mkdir(parents=True)
            shutil.copy(path, folder / path.parent.name)
    splits = {"train": "train/*.laz", "test": "test/*.laz"}
    return plan_comparison(SurveyParameters(str(folder), splits, "tomic2019"), IngestParameters(), {"taxonomy": None})


def test_drives_without_images_are_named(project, tmp_path, caplog):
    with pytest.raises(ReadError, match=r"need images: no drive of the survey has a calibration\.json.*bare/"):
        images_of_drives(copied(project, tmp_path / "bare", drives=[]), "calibration.json")
    with pytest.raises(ReadError, match=r"no training drive of the survey"):
        images_of_drives(copied(project, tmp_path / "test", drives=["test"]), "calibration.json")
    found = images_of_drives(copied(project, tmp_path / "train", drives=["train"]), "calibration.json")
    assert list(found) == ["train.train"] and "no camera sees: test.test" in caplog.text


def test_picture_and_labels_that_are_lost_are_named(project, stored, tmp_path):
    plan = copied(project, tmp_path / "survey", drives=["train"])
    drives = list(images_of_drives(plan, "calibration.json").values())
    samples = LabelledImages(drives, "labels", stored[2][0])
    image, labels = samples[0]
    assert image.shape == (180, 240, 3) and labels.shape == (180, 240) and len(samples) == len(drives[0].images)
    for kind, broken in (("images", 0), ("labels", 1)):
        name = drives[0].images[broken].name
        (tmp_path / f"survey/train/{kind}/{name}.png").unlink()
        with pytest.raises(ReadError, match=rf"{kind}/{name}\.png: no such picture"):
            LabelledImages(drives, "labels", stored[2][0])[broken]  # nothing of it has been read yet


@pytest.mark.parametrize("method", METHODS)
def test_label_refuses_methods_that_need_images(project, tmp_path, method):
    with pytest.raises(Exception, match=rf"label\.method '{method}' needs camera images"):
        label(project, project / "data/01_raw", tmp_path / "out", method=method)
