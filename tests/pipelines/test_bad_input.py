"""Malformed and unusual surveys in `label` and a comparison: a clear error, or a documented result."""

import re

import laspy
import numpy as np
import pandas as pd
import pytest
from helpers.wiring import TINY, joined, label, last_line, make_project, run, shared_run, stored_records, with_models

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.formats.base import WriteOptions
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.ply.format import PlyFormat
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import plan_comparison

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

UTM = np.array([389_300.0, 5_819_700.0, 34.0])


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return with_models(shared_run(tmp_path_factory), tmp_path_factory.mktemp("bad"))


def street(rng, n=4000):
    """A flat road 12 m long with a wall beside it and a pole on it."""
    road = np.column_stack([rng.uniform(0, 12, n), rng.uniform(0, 6, n), rng.normal(0, 0.01, n)])
    wall = np.column_stack([rng.uniform(0, 12, n // 2), np.full(n // 2, 6.5), rng.uniform(0, 5, n // 2)])
    pole = np.column_stack([np.full(200, 6.0), np.full(200, 5.0), np.linspace(0, 4, 200)]) + rng.normal(
        0, 0.02, (200, 3)
    )
    labels = np.repeat([TAXONOMY["road"], TAXONOMY["building"], TAXONOMY["light_pole"]], [n, n // 2, 200])
    return np.concatenate([road, wall, pole]), labels.astype(np.uint8)


def las(path, xyz, **columns):
    path.parent.mkdir(parents=True, exist_ok=True)
    cloud = PointCloud(np.asarray(xyz, dtype=np.float64), columns, UTM, source=str(path))
    LasFormat().write(path, cloud, WriteOptions(like="none"))
    return path


def failure(function, *arguments, **parameters):
    """Return the last line of the error that a command ends with."""
    with pytest.raises(Exception) as caught:  # what the user reads last is what counts
        function(*arguments, **parameters)
    return last_line(caught.value)


@pytest.mark.parametrize("name", ["empty.laz", "empty.txt", "empty.bin"])
def test_empty_file_is_named(project, tmp_path, name):
    (tmp_path / name).write_bytes(b"")
    said = failure(label, project, tmp_path / name, tmp_path / "out")
    assert name in said and re.search("empty|no points|0 bytes", said), said


def test_file_without_points_is_named(project, tmp_path):
    laspy.LasData(laspy.LasHeader(version="1.4", point_format=6)).write(tmp_path / "none.laz")
    said = failure(label, project, tmp_path / "none.laz", tmp_path / "out")
    assert "none.laz" in said and re.search("empty|no points|0 points", said), said


@pytest.mark.parametrize("n_points", [1, 2, 3])
def test_a_handful_of_points_is_labelled_like_any_other_survey(project, tmp_path, n_points):
    path = las(tmp_path / "few.laz", np.arange(3 * n_points).reshape(n_points, 3))
    out = label(project, path, tmp_path / "out")
    found = laspy.read(out / "few.laz")
    assert np.array_equal(found.xyz, laspy.read(path).xyz)
    assert np.isfinite(found["confidence"]).all()


def test_the_same_point_a_thousand_times_is_labelled_and_reported(project, tmp_path):
    path = las(tmp_path / "same.laz", np.zeros((1000, 3)))
    out = label(project, path, tmp_path / "out")
    found = laspy.read(out / "same.laz")
    assert len(found.points) == 1000 and len(np.unique(found.classification)) == 1
    report = (out / "report.html").read_text(encoding="utf-8")
    assert 0 < report.index("999 points repeat another exactly") < report.index(">Map</h2>")


def test_duplicates_of_every_point_get_the_class_of_their_twin(project, tmp_path, rng):
    xyz, _ = street(rng)
    out = label(project, las(tmp_path / "twice.laz", np.concatenate([xyz, xyz])), tmp_path / "out")
    codes = np.asarray(laspy.read(out / "twice.laz").classification)
    assert np.array_equal(codes[: len(xyz)], codes[len(xyz) :])


@pytest.mark.parametrize(("value", "form"), [(np.nan, "ply"), (-np.inf, "ply"), (np.nan, "txt"), (np.inf, "txt")])
def test_coordinates_that_are_no_numbers_are_named_with_their_row(project, tmp_path, rng, value, form):
    xyz, _ = street(rng)
    xyz[17, 1] = value
    path = tmp_path / f"broken.{form}"
    if form == "ply":
        PlyFormat().write(path, PointCloud(xyz), WriteOptions())
    else:
        np.savetxt(path, xyz, fmt="%.3f")
    said = failure(label, project, path, tmp_path / "out")
    assert path.name in said and re.search(r"\b(17|18)\b", said) and re.search("nan|inf", said), said


def test_truncated_laz_is_named(project, tmp_path, rng):
    path = las(tmp_path / "cut.laz", street(rng)[0])
    path.write_bytes(path.read_bytes()[:-2000])
    said = failure(label, project, path, tmp_path / "out")
    assert "cut.laz" in said and re.search("truncated|damaged|ends|bytes", said), said
    assert not (tmp_path / "out" / "cut.laz").exists()


@pytest.mark.parametrize(("source", "name"), [("a.laz", "a.ply"), ("a.laz", "a.txt"), ("a.ply", "a.las")])
def test_wrong_extension_names_what_the_file_is_called_and_what_it_holds(project, tmp_path, rng, source, name):
    folder = tmp_path / "in"
    folder.mkdir()
    cloud = PointCloud(street(rng)[0], {}, UTM)
    (LasFormat() if source.endswith("laz") else PlyFormat()).write(folder / source, cloud, WriteOptions(like="none"))
    (folder / source).rename(folder / name)
    said = failure(label, project, folder / name, tmp_path / "out")
    held, called = ("LAS" if source.endswith("laz") else "PLY"), name.rpartition(".")[2].upper().replace("TXT", "text")
    assert name in said and f"named as {called}" in said and f"holds {held}" in said, said


def test_text_that_is_no_table_is_named_with_its_line(project, tmp_path):
    (tmp_path / "letter.txt").write_text("1 2 3\n4 5 6\nDear Sir or Madam\n", encoding="utf-8")
    said = failure(label, project, tmp_path / "letter.txt", tmp_path / "out")
    assert "letter.txt" in said and "line 3" in said, said


def test_one_bad_file_among_good_ones_is_named_and_the_good_ones_are_read_first(project, tmp_path, rng):
    xyz, _ = street(rng)
    las(tmp_path / "in" / "a.laz", xyz)
    (tmp_path / "in" / "b.laz").write_bytes(b"LASF and no more")
    las(tmp_path / "in" / "c.laz", xyz)
    said = failure(label, project, tmp_path / "in", tmp_path / "out")
    assert "b.laz" in said and "a.laz" not in said
    assert {path.parent.name for path in stored_records(tmp_path / "out", "files")} >= {"survey.a_laz", "survey.c_laz"}


def test_survey_without_any_ground_is_labelled_all_the_same(project, tmp_path, rng):
    wire = np.column_stack([np.linspace(0, 20, 3000), np.zeros(3000), 8 + rng.normal(0, 0.01, 3000)])
    out = label(project, las(tmp_path / "wire.laz", wire), tmp_path / "out")
    found = laspy.read(out / "wire.laz")
    assert len(found.points) == 3000 and np.isfinite(found["confidence"]).all()


def test_files_of_different_systems_are_named(project, tmp_path, rng):
    xyz, _ = street(rng)
    for name, crs in (("a.laz", "EPSG:25832"), ("b.laz", "EPSG:25833")):
        from pyproj import CRS

        (tmp_path / "in" / name[0]).mkdir(parents=True)
        cloud = PointCloud(xyz, {}, UTM, CRS(crs).to_wkt())
        LasFormat().write(tmp_path / "in" / name[0] / name, cloud, WriteOptions(like="none"))
    said = failure(label, project, tmp_path / "in", tmp_path / "out")
    assert "a/a.laz" in said and "b/b.laz" in said and "coordinate reference system" in said, said


# ---- a comparison on a survey of one's own


def compared(tmp_path, train, test, *, to_nodes=None, **changes):
    """Run a comparison on two labelled clouds, whole or up to some nodes, and return the project's folder."""
    for split, (xyz, labels) in {"train": train, "test": test}.items():
        columns = {} if labels is None else {"label": labels}
        las(tmp_path / "survey" / split / f"{split}.laz", xyz, **columns)
    project = tmp_path / "project"
    project.mkdir()
    make_project(project)
    fixed = {"simulation": {"enabled": False}, "survey": {"root": str(tmp_path / "survey"), "trajectory": None}}
    run(project, to_nodes=to_nodes, **joined(TINY, fixed, changes))
    return project


def test_class_with_one_sample_and_classes_with_none_are_scored_as_documented(tmp_path, rng):
    xyz, labels = street(rng)
    labels[0] = TAXONOMY["car"]  # one point of a class, within the road
    nodes = [f"score_{method}" for method in (*methods_of("labelling"), *methods_of("detection"))]
    nodes += ["compare_methods", "compare_detectors", "picture_detrended_forest", "picture_hough_forest"]
    project = compared(tmp_path, (xyz, labels), (xyz + 0.001, labels), to_nodes=nodes)
    table = pd.read_csv(project / "data/08_reporting/scores/detrended_forest.csv").set_index(["class", "metric"])
    assert table.loc[("vehicle", "recall"), "support"] == 1
    assert table.loc[("human", "recall"), "support"] == 0 and np.isnan(table.loc[("human", "recall"), "value"])
    assert table.loc[("all", "overall_accuracy"), "value"] > 0.9
    defined = table.xs("f1", level="metric")
    assert table.loc[("all", "mean_f1"), "value"] == pytest.approx(defined["value"][defined["support"] > 0].mean())


def test_unknown_class_is_named_with_its_count_and_file(tmp_path, rng):
    xyz, labels = street(rng)
    labels[:3] = 99
    said = failure(compared, tmp_path, (xyz, labels), (xyz, labels))
    assert "train.laz" in said and "99 (3 points)" in said, said


def test_class_that_the_scheme_does_not_name_is_named_with_its_count_and_file(tmp_path, rng):
    xyz, labels = street(rng)
    labels[:5] = TAXONOMY["train"]
    said = failure(compared, tmp_path, (xyz, labels), (xyz, labels), survey={"scheme": "oakland_objects"})
    assert "train.laz" in said and f"{TAXONOMY['train']} (5 points)" in said and "oakland_objects" in said, said


def test_survey_without_labels_is_named(tmp_path, rng):
    xyz, labels = street(rng)
    said = failure(compared, tmp_path, (xyz, None), (xyz, labels))
    assert "train.laz" in said and "label" in said, said


def test_training_files_without_a_labelled_point_end_with_what_is_missing(tmp_path, rng):
    xyz, labels = street(rng)
    said = failure(compared, tmp_path, (xyz, np.zeros_like(labels)), (xyz, labels), to_nodes=["score_detrended_forest"])
    assert "labelled" in said and "train" in said, said


def test_test_files_without_a_labelled_point_have_empty_scores(tmp_path, rng):
    xyz, labels = street(rng)
    unlabelled = (xyz, np.zeros_like(labels))
    project = compared(tmp_path, (xyz, labels), unlabelled, to_nodes=["score_detrended_forest"])
    table = pd.read_csv(project / "data/08_reporting/scores/detrended_forest.csv")
    assert table["value"].isna().all() and (table["support"] == 0).all()


@pytest.mark.parametrize(
    ("splits", "message"),
    [
        ({"train": "train/*.laz", "test": "*/*.laz"}, r"splits 'train' and 'test' share train/train\.laz"),
        ({"test": "test/*.laz", "train": None}, r"no training scenes: the split 'train' is empty"),
    ],
)
def test_splits_that_cannot_be_are_named(tmp_path, rng, splits, message):
    xyz, labels = street(rng)
    said = failure(compared, tmp_path, (xyz, labels), (xyz, labels), survey={"splits": splits})
    assert re.search(message, said), said


@pytest.mark.parametrize(
    ("splits", "message"),
    [
        ({"train": "train/*.laz", "test": "nothing/*.laz"}, r"split 'test' matches nothing"),
        ({"train": "train/*.laz", "te st": "test/*.laz"}, r"'te st'"),
        ({"other": {"files": ["train/*"], "part": 1}}, r"unknown keys of a split: part"),
        ({"other": 3}, r"a split must be a glob, a list of globs or a mapping with files, got 3"),
    ],
)
def test_splits_that_the_plan_refuses_are_named(tmp_path, rng, splits, message):
    for split in ("train", "test"):
        las(tmp_path / split / f"{split}.laz", street(rng, 100)[0])
    with pytest.raises(MlsRoadError, match=message):
        plan_comparison(SurveyParameters(str(tmp_path), splits, "tomic2019"), IngestParameters(), {"taxonomy": None})


def test_root_that_does_not_exist_is_named(tmp_path, rng):
    xyz, labels = street(rng)
    said = failure(compared, tmp_path, (xyz, labels), (xyz, labels), survey={"root": str(tmp_path / "nowhere")})
    assert "nowhere is not a folder" in said, said
