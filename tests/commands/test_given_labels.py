"""Commands on a survey that comes with classes: kept, listed without a model, predicted by others."""

import shutil

import geopandas
import laspy
import numpy as np
import pytest
from helpers.forking import ALONE
from helpers.labelled import scheme as configured_scheme
from helpers.labelled import write_true_classes

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.review.corrections import Correction, open_corrections

SCHEME = ClassScheme.from_config("road_inventory", configured_scheme())


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory):
    """A simulated street whose file has the LAS codes of its true classes, and predictions of these."""
    place = tmp_path_factory.mktemp("given")
    done = run(
        *("simulate", "--preset", "tiny", "--seed", "3", "--length", "20", "--params", "with_images=false"), cwd=place
    )
    assert done.returncode == 0, done.stderr
    label = SCHEME.encode(np.asarray(laspy.read(place / "street/survey.laz")["label"]))
    shutil.copy(place / "street/survey.laz", place / "classified.laz")
    write_true_classes(place / "classified.laz")
    shutil.copy(place / "street/trajectory.csv", place)
    (place / "predictions").mkdir()
    p = np.full((len(label), len(SCHEME)), 0.01, np.float32)
    p[np.arange(len(label)), label] = 1 - 0.01 * (len(SCHEME) - 1)
    np.save(place / "predictions/classified.npy", p)
    return place


def test_an_inventory_needs_no_model_and_changes_no_class(run, folder):
    done = run("inventory", "classified.laz", "--workers", 1, cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "with the given classes" in done.stdout and "points keep their class" in done.stdout
    before, after = laspy.read(folder / "classified.laz"), laspy.read(folder / "classified_mlsroad/classified.laz")
    assert np.array_equal(before.classification, after.classification)
    known = np.asarray(before.classification) != 1
    assert (np.asarray(after["confidence"])[known] == 1).all()
    objects = geopandas.read_parquet(folder / "classified_mlsroad/inventory.parquet")
    assert len(objects) and set(objects["kind"]) <= {"pole", "sign", "tree", "vehicle"}
    again = run("inventory", "classified.laz", cwd=folder)
    assert again.stdout.startswith("Already labelled")
    with open_corrections(folder / "classified_mlsroad") as store:
        store.add(Correction("reject", int(objects["object_id"].iloc[0])), who="ann")
    again = run("inventory", "classified.laz", "--export", "csv", cwd=folder)
    assert again.stdout.startswith("Already labelled") and (folder / "classified_mlsroad/inventory.csv").is_file()
    assert "as labelled, without 1 decision: mlsroad export" in " ".join(again.stdout.split())


def test_an_inventory_of_no_classes_is_an_error(run, folder):
    done = run("inventory", "street/survey.laz", "-o", "none", *ALONE, cwd=folder)
    assert done.returncode == 1 and "survey.laz: no point has a class" in done.stderr
    assert done.stderr.count("\n") == 1 and not (folder / "none/survey.laz").exists()


def test_chosen_classes_are_kept_and_the_others_labelled(run, folder):
    done = run("label", "classified.laz", "-o", "kept", "--keep-classes", "--keep", "6,11", *ALONE, cwd=folder)
    assert done.returncode == 0, done.stderr
    before, after = laspy.read(folder / "classified.laz"), laspy.read(folder / "kept/classified.laz")
    kept = np.isin(before.classification, (6, 11))
    assert np.array_equal(before.classification[kept], after.classification[kept])
    assert not np.array_equal(before.classification[~kept], after.classification[~kept])
    assert (np.asarray(after["confidence"])[kept] == 1).all() and np.asarray(after["confidence"])[~kept].max() < 1


def test_probabilities_of_another_network_are_the_labels(run, folder):
    options = ("--labels", "predictions", "--labels-map", "own.csv")
    rows = [f"{k},{name},{name}" for k, name in enumerate(SCHEME.classes)]
    (folder / "own.csv").write_text("\n".join(["number,name,class", *rows]))
    done = run("label", "classified.laz", "-o", "predicted", *options, *ALONE, cwd=folder)
    assert done.returncode == 0, done.stderr
    before, after = laspy.read(folder / "classified.laz"), laspy.read(folder / "predicted/classified.laz")
    free = (np.asarray(before.classification) != 1) & (np.asarray(after["object_id"]) == 0)
    assert np.array_equal(before.classification[free], after.classification[free])
    assert np.asarray(after["confidence"])[free] == pytest.approx(0.88)
    scored = run("score", "predicted", "--truth", "street", cwd=folder)
    assert scored.returncode == 0 and "precision" in scored.stdout


def test_the_weight_of_predictions_is_fitted_on_classified_points(run, folder):
    las, rng = laspy.read(folder / "classified.laz"), np.random.default_rng(1)
    las.classification = np.where(rng.random(len(las.points)) < 0.3, las.classification, 1)  # the labelled part
    las.write(folder / "part.laz")
    shutil.copy(folder / "predictions/classified.npy", folder / "predictions/part.npy")
    rows = [f"{k},{name},{name}" for k, name in enumerate(SCHEME.classes)]
    (folder / "fit.csv").write_text("\n".join(["number,name,class", *rows]))
    options = ("--labels", "predictions", "--labels-map", "fit.csv", "--class-map", "mlsroad", *ALONE)
    done = run("label", "part.laz", "-o", "fit", *options, "--params", "label.given.weight=fit", cwd=folder)
    assert done.returncode == 0, done.stderr
    fitted = " ".join(done.stdout.split()).partition("Weight of the predictions: ")[2]
    assert float(fitted.split(",")[0]) > 0.5, done.stdout  # they are right


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--labels", "nowhere"), "nowhere is not a folder (label.given.labels)"),
        (("--labels", "predictions"), "label.given.labels_classes is not set"),
        (("--labels", "predictions", "--labels-map", "none.csv"), "none.csv: no such class map"),
        (("--keep-classes", "--keep", "2,200"), "label.given.keep: class number 200 is not in class map asprs"),
        (("--method", "given_labels"), "label.method given_labels needs label.given.keep_classes"),
    ],
)
def test_errors_are_one_line(run, folder, options, message):
    done = run("label", "classified.laz", "-o", "wrong", *options, *ALONE, cwd=folder)
    assert done.returncode == 1 and message in done.stderr and done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (lambda n: np.r_[np.zeros(n - 1, np.uint8), 99], "survey_001.npy: class number 99 (1 points) is not in"),
        (lambda n: np.zeros(n - 3, np.uint8), "labels for the"),
        (lambda n: np.full((n, 13), 0.5, np.float32), "survey_001.npy: the probabilities of row 0 sum to 6.5"),
        (lambda n: np.full((n, 4), 0.25, np.float32), "survey_001.npy: has 4 classes"),
    ],
)
def test_every_file_of_predictions_is_checked_before_the_survey_is_read(run, folder, values, message):
    place, predictions = folder / "two", folder / "predictions_of_two"
    shutil.rmtree(predictions, ignore_errors=True)
    for made in (place, predictions):
        made.mkdir(exist_ok=True)
    for number, name in enumerate(("survey_000", "survey_001")):
        shutil.copy(folder / "classified.laz", place / f"{name}.laz")
        n = len(laspy.read(folder / "classified.laz").points)
        np.save(predictions / f"{name}.npy", values(n) if number else np.zeros(n, np.uint8))
    rows = [f"{k},{name},{name}" for k, name in enumerate(SCHEME.classes)]
    (folder / "map.csv").write_text("\n".join(["number,name,class", *rows]))
    done = run("label", "two", "-o", "unread", "--labels", predictions, "--labels-map", "map.csv", *ALONE, cwd=folder)
    line = done.stderr.splitlines()[-1]
    assert done.returncode == 1 and message in line and line.startswith(f"Error: {predictions / 'survey_001.npy'}"), (
        line
    )
    assert not list(folder.glob("unread/**/*.laz"))
    assert not list(folder.glob("unread/**/*.npz"))  # no part of the survey was read
