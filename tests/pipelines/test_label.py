"""`label` from end to end on a new survey."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace

import geopandas as gpd
import laspy
import numpy as np
import pandas as pd
import pyogrio
import pytest
from helpers.labelled import N_POINTS, check_labels, check_same_points, scheme
from helpers.wiring import REPOSITORY, contents, label, last_line, stage_counts, stored_records, with_models

from mlsroad_pipeline.formats.base import WriteOptions
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.inventory_files.exports import EXPORTS

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


def test_laz_keeps_every_point_and_attribute_and_gains_class_and_confidence(labelled, survey):
    written, original = laspy.read(labelled / "street.laz"), laspy.read(survey)
    check_same_points(written, original)
    codes, confidence = check_labels(written, N_POINTS)
    assert len(np.unique(codes)) >= 4 and confidence.mean() > 0.5
    assert written.header.parse_crs().to_epsg() == original.header.parse_crs().to_epsg() == 25833


def test_classes_are_mostly_those_that_the_simulator_put_there(labelled, shared):
    path = shared / "data/01_raw/simulated/test/survey.laz"
    truth = np.asarray(laspy.read(path)["label"])[:N_POINTS]
    codes = np.asarray(laspy.read(labelled / "street.laz").classification)
    assert (codes[np.isin(truth, range(1, 8))] == 11).mean() > 0.8  # paved ground
    assert (codes[truth == 20] == 6).mean() > 0.5  # building


def test_inventory_opens_in_its_system_and_lies_where_the_points_lie(labelled, survey):
    path = labelled / "inventory.gpkg"
    layers = set(pyogrio.list_layers(path)[:, 0])
    assert {"objects", "poles", "signs", "trees", "vehicles"} <= layers
    objects = gpd.read_file(path, layer="objects")
    assert objects.crs.to_epsg() == 25833
    las = laspy.read(survey)
    assert len(objects) > 0
    assert objects["x"].between(las.x.min(), las.x.max()).all() and objects["y"].between(las.y.min(), las.y.max()).all()
    assert set(objects["method"]) == {"detrended_forest"}
    assert all(re.fullmatch(r"mlsroad-detrended_forest \d+", version) for version in objects["model_version"])
    assert objects["score"].between(0, 1).all() and (objects["point_count"] > 0).all()
    assert objects["station"].notna().all()  # no trajectory lies beside the points: the path comes from their times


def test_geoparquet_holds_the_objects_of_the_geopackage(labelled):
    objects = gpd.read_file(labelled / "inventory.gpkg", layer="objects")
    table = gpd.read_parquet(labelled / "inventory.parquet")
    assert table.crs == objects.crs
    assert table["object_id"].tolist() == objects["object_id"].tolist()
    assert table.geometry.geom_equals(objects.geometry).all()
    np.testing.assert_array_equal(table["height"], objects["height"])


def test_points_and_objects_have_the_same_numbers(labelled):
    table = gpd.read_parquet(labelled / "inventory.parquet").set_index("object_id", drop=False)
    las = laspy.read(labelled / "street.laz")
    number = np.asarray(las["object_id"])
    assert number.dtype == np.uint32 and len(table) > 2
    assert np.bincount(number, minlength=len(table) + 1)[1:].tolist() == table["point_count"].tolist()
    codes = np.asarray(las.classification)
    for row, name in zip(table.itertuples(), table["class"], strict=True):
        mine = number == row.object_id
        assert set(codes[mine]) == {scheme()["classes"][name]["asprs"]}
        sides = [[getattr(row, f"{axis}_{end}") for axis in "xyz"] for end in ("min", "max")]
        np.testing.assert_allclose(sides, [las.xyz[mine].min(axis=0), las.xyz[mine].max(axis=0)], atol=2e-3)
        times = np.floor(las.gps_time[mine])
        assert (row.first_time, row.last_time) == (times.min(), times.max())
    assert set(table["file_count"]) == {1} and (table["scanners"] <= table["scanners_there"]).all()
    assert (table["passes"] >= 1).all() and (table["passes"] <= table["passes_there"]).all()


def test_report_has_points_files_model_and_objects(labelled):
    page = (labelled / "report.html").read_text(encoding="utf-8")
    text = re.sub(r"<[^>]+>", " ", page).replace(",", "").replace("\u202f", "").replace("\u2009", "")
    assert str(N_POINTS) in text.replace(" ", "")
    assert "mlsroad-detrended_forest" in text and "street.laz" in text and "inventory.gpkg" in page
    n_objects = len(gpd.read_file(labelled / "inventory.gpkg", layer="objects"))
    assert re.search(rf"\b{n_objects}\b", text)


def test_labelling_again_says_that_nothing_is_to_do_and_changes_no_byte(label_project, labelled, survey, caplog):
    before = contents(labelled)
    with caplog.at_level("INFO", logger="mlsroad_pipeline"):
        label(label_project, survey, labelled)
    assert [text for text in caplog.messages if text.startswith("Nothing to do: ")]
    assert not stage_counts(caplog.messages)
    assert contents(labelled) == before


def test_a_deleted_result_is_written_again_with_the_same_bytes(label_project, labelled, survey):
    before = (labelled / "street.laz").read_bytes()
    (labelled / "street.laz").unlink()
    label(label_project, survey, labelled)
    assert (labelled / "street.laz").read_bytes() == before


def test_two_workers_give_the_bytes_of_one_and_objects_span_scenes_and_files(shared, label_project, cloud, tmp_path):
    folder = tmp_path / "survey"
    folder.mkdir()
    for number in range(2):
        own = np.arange(len(cloud)) // 500 % 2 == number
        LasFormat().write(folder / f"{number}.laz", cloud.select(own), WriteOptions(like="none"))
    how = {
        "ingest": {"scene_length": 3.0, "buffer": 2.0},
        "export": ["dxf", "shapefile", "flatgeobuf,geojson", "csv", "gml"],
    }
    one = label(label_project, folder, tmp_path / "one", keep_state=True, **how)
    assert len(stored_records(one, "results")) > 3
    project = with_models(shared, tmp_path / "project")
    two = label(project, folder, tmp_path / "two", execution={"backend": "loky", "n_workers": 2}, **how)
    table, numbers = gpd.read_parquet(one / "inventory.parquet"), []
    for name in ("0.laz", "1.laz"):
        assert (two / name).read_bytes() == (one / name).read_bytes()
        numbers.append(np.asarray(laspy.read(one / name)["object_id"]))
    counts = np.array([np.bincount(number, minlength=len(table) + 1)[1:] for number in numbers])
    assert counts.sum(axis=0).tolist() == table["point_count"].tolist()
    assert (counts > 0).sum(axis=0).tolist() == table["file_count"].tolist()
    assert table["file_count"].max() == 2
    pd.testing.assert_frame_equal(gpd.read_parquet(two / "inventory.parquet"), table)
    exports = json.loads(next(one.glob(".mlsroad/*/summary.json")).read_text())["outputs"]["exports"]
    assert set(exports) == {str(one / name) for form in EXPORTS.values() for name in (*form.files, *form.others)}
    for name in (path.removeprefix(f"{one}/") for path in exports):
        assert (two / name).read_bytes() == (one / name).read_bytes(), name
    for name in ("inventory.geojson", "inventory.fgb", "inventory.csv", "inventory_shp/objects.shp"):
        assert len(pyogrio.read_dataframe(one / name, read_geometry=False)) == len(table), name


def test_output_in_a_folder_that_is_no_part_of_the_survey_may_lie_inside_it(label_project, survey, tmp_path):
    folder = tmp_path / "survey"
    (folder / "west").mkdir(parents=True)
    (folder / "west" / "street.laz").write_bytes(survey.read_bytes())
    out = folder / "labelled"
    label(label_project, folder, out)
    first = (out / "west" / "street.laz").read_bytes()
    for copy in ("street.copc.laz", "street_classes.ply"):
        (out / "west" / copy).write_bytes(b"")
    label(label_project, folder, out, overwrite=True)  # files in a folder of results are no survey
    assert (out / "west" / "street.laz").read_bytes() == first
    assert [p.relative_to(out).as_posix() for p in sorted(out.rglob("street.l*"))] == ["west/street.laz"]


def test_subfolders_are_mirrored_and_each_is_a_drive_of_its_own(label_project, survey, cloud, tmp_path):
    folder = tmp_path / "survey"
    for name, part in (("north/a.laz", slice(0, 4000)), ("south/deep/a.laz", slice(4000, N_POINTS))):
        (folder / name).parent.mkdir(parents=True)
        LasFormat().write(folder / name, cloud.select(np.arange(N_POINTS)[part]), WriteOptions(like="none"))
    out = label(label_project, folder, tmp_path / "out")
    for name in ("north/a.laz", "south/deep/a.laz"):
        check_same_points(laspy.read(out / name), laspy.read(folder / name))
    found = gpd.read_file(out / "inventory.gpkg", layer="objects")
    assert found["object_id"].is_unique


def test_what_two_drives_recorded_is_listed_once(shared, label_project, tmp_path):
    street = shared / "data/01_raw/simulated/test/survey.laz"
    for drive in ("morning", "evening"):
        (tmp_path / "survey" / drive).mkdir(parents=True)
        shutil.copy(street, tmp_path / "survey" / drive)
    out = label(label_project, tmp_path / "survey", tmp_path / "out")
    found = gpd.read_file(out / "inventory.gpkg", layer="objects")
    assert len(found) and (found["file_count"] == 2).all() and (found["point_count"] % 2 == 0).all()
    for drive in ("morning", "evening"):
        numbers = laspy.read(out / drive / "survey.laz").object_id
        own = dict(
            zip(*(values.tolist() for values in np.unique(numbers[numbers > 0], return_counts=True)), strict=True)
        )
        assert own == dict(zip(found["object_id"], found["point_count"] // 2, strict=True))


def test_tables_and_pictures_beside_the_points_are_no_points(shared, label_project, tmp_path, caplog):
    folder = shared / "data/01_raw/simulated/test"  # with trajectory.csv, objects.csv, images and calibration
    out = label(label_project, folder, tmp_path / "out")
    inventory = [f"inventory.{ending}" for ending in ("gpkg", "parquet", "qml")]
    assert sorted(contents(out)) == [*inventory, "report.html", "survey.laz"]
    assert not [record for record in caplog.records if "objects.csv" in record.getMessage()]
    objects = gpd.read_file(out / "inventory.gpkg", layer="objects")
    assert objects["station"].notna().all()  # the trajectory was found
    assert "trajectory" in set(pyogrio.list_layers(out / "inventory.gpkg")[:, 0])


def test_survey_without_colour_gets_the_forest_without_it_and_one_warning(label_project, cloud, tmp_path, caplog):
    path = tmp_path / "plain.laz"
    LasFormat().write(path, cloud.without_columns(["rgb"]), WriteOptions(like="none"))
    out = label(label_project, path, tmp_path / "out")
    check_labels(laspy.read(out / "plain.laz"), N_POINTS)
    said = [r.getMessage() for r in caplog.records if r.levelname == "WARNING" and "no rgb" in r.getMessage()]
    assert len(said) == 1, said
    assert "has no rgb" in (out / "report.html").read_text(encoding="utf-8")


def test_survey_unlike_the_training_streets_is_warned_of_with_its_unusual_properties(
    label_project, labelled, cloud, tmp_path, caplog
):
    path = tmp_path / "wide.laz"
    LasFormat().write(path, replace(cloud, xyz=cloud.xyz * (8, 8, 1)), WriteOptions(like="none"))
    out = label(label_project, path, tmp_path / "out", ingest={"scene_length": 120.0})  # as many scenes as before
    sentence = (
        r"The survey differs from the training data: points lie \S+ m apart \(median; training scenes \S+ to \S+ m\)\."
    )
    said = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    assert len([line for line in said if re.fullmatch(sentence, line)]) == 1, said
    assert re.search(sentence, (out / "report.html").read_text(encoding="utf-8"))
    assert not re.search(sentence, (labelled / "report.html").read_text(encoding="utf-8"))


def test_classes_of_a_coarser_scheme_are_written_as_private_codes(label_project, survey, tmp_path):
    out = label(label_project, survey, tmp_path / "out", scheme="tomic2019")
    codes = np.unique(np.asarray(laspy.read(out / "street.laz").classification))
    assert codes.min() >= 64 and codes.max() < 64 + len(scheme("tomic2019")["classes"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"survey": ""}, r"label\.survey is not set: kedro run --pipelines=label --params=label\.survey="),
        ({"output": ""}, r"label\.output is not set"),
        ({"survey": "nowhere.laz"}, r"nowhere\.laz does not exist"),
        (
            {"method": "hough"},
            r"unknown label\.method 'hough' \(known: detrended_forest, patch_graph, .*hough_forest",
        ),
        (
            {"model": 99},
            r"label\.model '99' of detrended_forest is unknown; models: general .*mlsroad-detrended_forest version 1",
        ),
        ({"model": "newest"}, r"label\.model 'newest' of detrended_forest is unknown"),
        ({"scheme": "martian"}, r"label\.scheme 'martian' is not configured"),
        ({"scheme": "luo2016"}, r"class '.*' of scheme 'road_inventory' falls into 2 classes of scheme 'luo2016'"),
        ({"inventory": {"poel": {}}}, r"poel"),
        ({"read": {"colums": {}}}, r"colums"),
    ],
)
def test_wrong_parameters_end_with_a_line_that_names_them(label_project, survey, tmp_path, changes, message):
    given = {"survey": survey, "output": tmp_path / "out", **changes}
    with pytest.raises(Exception) as caught:  # the line that the user reads is what counts
        label(label_project, given.pop("survey"), given.pop("output"), **given)
    assert re.search(message, last_line(caught.value)), last_line(caught.value)
    assert not contents(tmp_path / "out")


def test_output_that_cannot_be_made_is_an_error_before_anything_is_computed(label_project, survey, tmp_path, caplog):
    (tmp_path / "file").write_text("not a folder")
    with caplog.at_level("INFO", logger="mlsroad_pipeline"), pytest.raises(Exception) as caught:
        label(label_project, survey, tmp_path / "file" / "out")
    assert f"label.output: {tmp_path}/file/out cannot be written" in last_line(caught.value)
    assert not stage_counts(caplog.messages)


@pytest.mark.parametrize("given", [".", "./", "../survey"])
def test_output_equal_to_the_input_is_an_error(label_project, survey, tmp_path, given):
    folder = tmp_path / "survey"
    folder.mkdir()
    (folder / "street.laz").write_bytes(survey.read_bytes())
    with pytest.raises(Exception) as caught:
        label(label_project, folder, folder / given)
    assert "label.output is a folder of the survey itself" in last_line(caught.value)
    assert [path.name for path in folder.iterdir()] == ["street.laz"]


def test_killed_labelling_goes_on_where_it_stopped_with_the_bytes_of_an_undisturbed_one(shared, tmp_path, caplog):
    project = with_models(shared, tmp_path / "project")
    survey = shared / "data/01_raw/simulated/test/survey.laz"
    whole = label(with_models(shared, tmp_path / "other"), survey, tmp_path / "whole", ingest={"scene_length": 5.0})
    command = [
        *(sys.executable, "-W", "ignore", "-m", "kedro", "run", "--pipelines=label"),
        f"--params=label.survey={survey},label.output={tmp_path / 'out'},ingest.scene_length=5.0,"
        "label.method=detrended_forest,label.least_score=0,execution.backend=sequential",
    ]
    others = {name: value for name, value in os.environ.items() if not name.startswith("MLFLOW_")}  # other stores
    environment = {**others, "PYTHONPATH": str(REPOSITORY / "src")}
    with (tmp_path / "log").open("wb") as log:
        process = subprocess.Popen(
            command, cwd=project, env=environment, stdout=log, stderr=log, start_new_session=True
        )
        deadline = time.monotonic() + 300
        while (
            len(stored_records(tmp_path / "out", "results")) < 3
            and time.monotonic() < deadline
            and process.poll() is None
        ):
            time.sleep(0.005)
        os.killpg(process.pid, signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL, (tmp_path / "log").read_text()[-2000:]
    done = len(stored_records(tmp_path / "out", "results"))
    assert done >= 3
    assert not (tmp_path / "out" / "survey.laz").exists()
    with caplog.at_level("INFO", logger="mlsroad_pipeline"):
        label(project, survey, tmp_path / "out", ingest={"scene_length": 5.0})
    counts = stage_counts(caplog.messages)
    assert counts["results"][1] >= done and counts["results"][0] > 0
    assert counts["pieces"][0] == 0
    assert (tmp_path / "out" / "survey.laz").read_bytes() == (whole / "survey.laz").read_bytes()
