"""Labels through images and their fusion, from a tiny survey to scores and registered models."""

import logging
import re
import shutil

import laspy
import numpy as np
import pandas as pd
import pytest
from helpers.wiring import TINY, contents, copied_run, label, run, session_of, stage_counts, stored_records

from mlsroad_pipeline.algorithms.core.classes import find_scheme
from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.model_store.registration import load_registered_bundle
from mlsroad_pipeline.papers.tomic2019.fusion.two_methods import TwoMethodFusion, spread_confidence
from mlsroad_pipeline.papers.tomic2019.image_labels.drive_images import LabelledImages, images_of_drives
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import plan_comparison

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

METHODS = ["image_labels", "fusion"]


@pytest.fixture(scope="module")
def project(shared, tmp_path_factory):
    """The whole comparison, in a folder of its own."""
    return copied_run(shared, tmp_path_factory.mktemp("images"))


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
    assert total[1, 0] / total[1, 1] > 0.3  # forty steps teach that most of it is road


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
        given = spread_confidence(features["label"], features["confidence"], len(bundle.classes))
        again = fusion.fuse(given, cameras)
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


LONG = {"ingest": {"scene_length": 15.0}}
"""Two or three scenes, so that an image is segmented as seldom as may be."""


@pytest.fixture(scope="module")
def survey(project):
    """A survey with a trajectory, images and their cameras beside the points."""
    return project / "data/01_raw/simulated/test"


@pytest.fixture(scope="module")
def fused(project, survey, tmp_path_factory):
    """That survey, labelled by the fusion."""
    return label(project, survey, tmp_path_factory.mktemp("out"), method="fusion", **LONG)


def text_of(folder):
    return re.sub(r"<[^>]+>|\s+", " ", (folder / "report.html").read_text(encoding="utf-8")).replace(",", "")


def codes_of(folder):
    las = laspy.read(folder / "survey.laz")
    return np.asarray(las.classification), np.asarray(las["confidence"])


def test_label_tells_which_share_of_the_points_cameras_saw(project, survey, fused, stored):
    n_points = len(laspy.read(survey / "survey.laz").points)
    told = re.search(r"seen by cameras +(\d+) points +([\d.]+) %", text_of(fused))
    assert told is not None and len(codes_of(fused)[0]) == n_points
    assert float(told[2]) == pytest.approx(100 * int(told[1]) / n_points, abs=0.06)
    found, _, _ = stored  # the comparison looked with scenes of another length at the same points
    seen = [
        int((part["seen"] & found["scenes"][key]["core"]).sum()) for key, part in found["image_labels.labels"].items()
    ]
    assert int(told[1]) == pytest.approx(sum(seen), rel=0.03)


def test_label_through_images_leaves_points_that_no_camera_sees_without_a_class(project, survey, fused, tmp_path):
    out = label(project, survey, tmp_path / "out", method="image_labels", **LONG)
    codes, confidence = codes_of(out)
    seen = re.search(r"seen by cameras +(\d+) points", text_of(out))
    assert seen is not None and int(seen[1]) == (codes != 1).sum() == (confidence > 0).sum()
    assert re.search(rf"seen by cameras +{seen[1]} points", text_of(fused))
    assert ((codes_of(fused)[0] != codes)[codes == 1]).mean() > 0.9  # there the fusion has the labels of the features


def test_fusion_of_a_survey_without_images_falls_back_on_its_features_and_says_so(project, survey, tmp_path, caplog):
    (tmp_path / "bare").mkdir()
    for name in ("survey.laz", "trajectory.csv"):
        shutil.copy(survey / name, tmp_path / "bare")
    out = label(project, tmp_path / "bare", tmp_path / "fusion", method="fusion", **LONG)
    forest = label(project, tmp_path / "bare", tmp_path / "forest", method="detrended_forest", **LONG)
    assert (out / "survey.laz").read_bytes() == (forest / "survey.laz").read_bytes()
    assert "No images (calibration.json)" in caplog.text
    assert "seen by cameras 0 points" in re.sub(" +", " ", text_of(out))
    assert "its points have the labels of the features alone" in text_of(out)
    with pytest.raises(Exception, match=r"'image_labels' needs images: there is no .*bare/calibration\.json"):
        label(project, tmp_path / "bare", tmp_path / "images", method="image_labels", **LONG)
    assert not contents(tmp_path / "images")


def test_label_with_images_goes_on_where_it_stopped_and_gives_two_workers_the_same_bytes(
    project, survey, fused, tmp_path, caplog
):
    label(project, survey, tmp_path / "out", method="fusion", keep_state=True, **LONG)
    shutil.rmtree(stored_records(tmp_path / "out", "results")[0].parent)
    (tmp_path / "out" / "report.html").unlink()  # an unfinished run
    caplog.clear()
    with caplog.at_level("INFO", logger="mlsroad_pipeline"):
        workers = {"execution": {"backend": "loky", "n_workers": 2}}
        label(project, survey, tmp_path / "out", method="fusion", keep_state=True, **LONG, **workers)
    computed, valid = stage_counts(caplog.messages)["results"]
    assert computed == 1 and valid >= 1
    assert (tmp_path / "out" / "survey.laz").read_bytes() == (fused / "survey.laz").read_bytes()
