"""Runs of `label` beside each other and one after the other: nothing is lost, mixed or replaced unasked."""

import json
import os
import signal
import sqlite3
import subprocess
import time

import geopandas as gpd
import laspy
import numpy as np
import pyogrio
import pytest
from helpers.wiring import contents, last_line, make_project, run, stage_counts

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import WriteOptions
from mlsroad_pipeline.formats.las.format import LasFormat

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

UTM = np.array([389_300.0, 5_819_700.0, 34.0])
NAMES = ["inventory.gpkg", "inventory.parquet", "inventory.qml", "report.html", "street.laz"]


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A project without a registered model: the shipped ones label."""
    return make_project(tmp_path_factory.mktemp("runs"))


@pytest.fixture(scope="module")
def surveys(tmp_path_factory):
    """Two streets with a pole, with the same file name in different folders; the first has a line in its intensity."""
    folder = tmp_path_factory.mktemp("surveys")
    return {name: street(folder / name / "street.laz", seed) for name, seed in (("east", 1), ("west", 2))}


def street(path, seed):
    rng = np.random.default_rng(seed)
    road = np.column_stack([rng.uniform(0, 12, 3000), rng.uniform(0, 6, 3000), rng.normal(0, 0.01, 3000)])
    pole = rng.normal(0, 0.03, (300, 3)) + np.column_stack([np.full((300, 2), 5.0), np.linspace(0.1, 4.0, 300)])
    path.parent.mkdir(parents=True, exist_ok=True)
    xyz = np.concatenate([road, pole])
    bright = np.where(np.abs(xyz[:, 1] - 3.0) < 0.1, 0.3, 0.1) + rng.normal(0, 0.005, len(xyz))
    columns = {"intensity": bright.astype(np.float32)} if seed == 1 else {}
    cloud = PointCloud(xyz, columns, UTM, source=str(path))
    LasFormat().write(path, cloud, WriteOptions(like="none"))
    return path


def label(project, survey, output, **changes):
    given = {"survey": str(survey), "output": str(output), **changes}
    run(project, "label", label=given, execution={"backend": "sequential"})
    return output


def refusal(project, survey, output, **changes):
    """Return the last line of the error of a refused run, which changes no result."""
    before = contents(output)
    with pytest.raises(Exception) as caught:
        label(project, survey, output, **changes)
    assert contents(output) == before
    return last_line(caught.value)


@pytest.fixture(scope="module")
def first(project, surveys, tmp_path_factory):
    return label(project, surveys["east"], tmp_path_factory.mktemp("first") / "out")


@pytest.fixture
def out(first, surveys, tmp_path):
    """A copy of a finished output; a record has no absolute path of its output."""
    subprocess.run(["cp", "-r", str(first), str(tmp_path / "out")], check=True)
    return tmp_path / "out"


def test_markings_of_the_intensity_are_layers_of_the_inventory(first):
    lines = gpd.read_file(first / "inventory.gpkg", layer="lane_lines")
    assert lines["length"].sum() == pytest.approx(12.0, abs=1.0)
    assert {"stop_lines", "crossings", "other_markings"} <= set(pyogrio.list_layers(first / "inventory.gpkg")[:, 0])


def test_a_survey_of_the_same_file_name_is_refused_and_overwrite_replaces_all_of_the_first(
    project, surveys, out, caplog
):
    said = refusal(project, surveys["west"], out)
    assert f"{out}/inventory.gpkg is a result of another run: label.survey is " in said
    assert str(surveys["east"]) in said and str(surveys["west"]) in said
    assert "; --overwrite (label.overwrite=true) replaces it" in said
    label(project, surveys["west"], out, overwrite=True)
    assert caplog.messages.count("No road markings are listed: the survey has no intensity") == 1
    assert np.array_equal(laspy.read(out / "street.laz").xyz, laspy.read(surveys["west"]).xyz)
    assert list(contents(out)) == NAMES
    assert "is a result of another run" in refusal(project, surveys["east"], out)  # the first one again


def test_other_settings_are_refused_with_the_one_that_differs(project, surveys, out):
    said = refusal(project, surveys["east"], out, scheme="tomic2019")
    assert "label.scheme is 'asprs' there and 'tomic2019' here" in said


def test_an_input_of_the_same_path_and_other_content_is_refused(project, surveys, tmp_path):
    path = street(tmp_path / "street.laz", 3)
    out = label(project, path, tmp_path / "out")
    street(path, 4)
    assert f"was written from other input: {path} has changed" in refusal(project, path, out)
    label(project, path, out, overwrite=True)
    assert np.array_equal(laspy.read(out / "street.laz").xyz, laspy.read(path).xyz)


def test_an_edited_inventory_stays_unless_overwrite_is_given_and_an_open_one_stays_in_any_case(project, surveys, out):
    with sqlite3.connect(out / "inventory.gpkg") as database:
        database.execute("UPDATE gpkg_contents SET description = 'checked in the field'")
    database.close()
    (out / "inventory.gpkg-wal").touch()
    assert "inventory.gpkg is open in another program" in refusal(project, surveys["east"], out, overwrite=True)
    (out / "inventory.gpkg-wal").unlink()
    assert "inventory.gpkg has been edited since it was written" in refusal(project, surveys["east"], out)
    label(project, surveys["east"], out, overwrite=True)
    assert b"checked in the field" not in contents(out)["inventory.gpkg"]


def test_a_finished_run_is_not_repeated_and_a_missing_result_is_written_again(project, surveys, out, caplog):
    before = contents(out)
    with caplog.at_level("INFO", logger="mlsroad_pipeline"):
        label(project, surveys["east"], out)
    assert [text for text in caplog.messages if text.startswith(f"Nothing to do: {out} holds the results")]
    assert not stage_counts(caplog.messages)
    [summary] = [json.loads(path.read_text()) for path in out.glob(".mlsroad/*/summary.json")]
    assert summary["outputs"]["clouds"] == [str(out / "street.laz")]  # the folder is a copy of the first one
    assert summary["outputs"]["report"] == str(out / "report.html")
    (out / "report.html").unlink()
    label(project, surveys["east"], out)
    after = contents(out)
    assert f"{out}/street.laz".encode() in after.pop("report.html") and before.pop("report.html")
    assert after == before
    assert [path.name for path in (out / ".mlsroad").glob("*/*") if path.name != "summary.json"] == ["run.json"]


def test_exports_and_copies_that_are_ordered_later_are_written_without_labelling(project, surveys, out, caplog):
    orders = {"export": ["csv", "flatgeobuf"], "copc": True}
    before = contents(out)
    (out / "inventory.fgb").write_text("mine")
    assert f"{out}/inventory.fgb exists and was not written by label" in refusal(
        project, surveys["east"], out, **orders
    )
    (out / "inventory.fgb").unlink()
    with caplog.at_level("INFO", logger="mlsroad_pipeline"):
        label(project, surveys["east"], out, **orders)
    assert not stage_counts(caplog.messages)
    later = contents(out)
    assert {name: later[name] for name in before} == before
    added = {name for name in later if name not in before}
    assert added == {"inventory.csv", "inventory.csvt", "inventory.fgb", "lines.csv", "lines.fgb", "street.copc.laz"}
    [summary] = [json.loads(path.read_text()) for path in out.glob(".mlsroad/*/summary.json")]
    assert {*summary["outputs"]["exports"]} == {str(out / name) for name in added if "laz" not in name}
    at_once = contents(label(project, surveys["east"], out.with_name("at_once"), **orders))
    assert {name: at_once[name] for name in added} == {name: later[name] for name in added}
    caplog.clear()
    with caplog.at_level("INFO", logger="mlsroad_pipeline"):
        label(project, surveys["east"], out, **orders)  # nothing is left to do
    assert contents(out) == later and not [text for text in caplog.messages if text.startswith("Wrote ")]


def test_a_file_of_the_users_own_is_refused_before_a_point_is_read(project, surveys, tmp_path, caplog):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.html").write_text("my own report")
    with caplog.at_level("INFO", logger="mlsroad_pipeline"):
        said = refusal(project, surveys["east"], tmp_path / "out")
        assert f"{tmp_path}/out/report.html exists and was not written by label" in said
        (tmp_path / "out" / "report.html").rename(tmp_path / "out" / "inventory.prj")
        said = refusal(project, surveys["east"], tmp_path / "out", export="csv")
    assert f"{tmp_path}/out/inventory.prj exists and was not written by label" in said
    assert not stage_counts(caplog.messages)


def test_two_runs_at_once_share_no_output_and_do_not_disturb_each_other(project, surveys, tmp_path, forked_commands):
    out = tmp_path / "out"
    arguments = ["label", str(surveys["east"]), "-o", str(out), "--params", "execution.backend=sequential"]
    process, deadline = forked_commands.start(arguments, tmp_path), time.monotonic() + 120
    while not list(out.glob(".mlsroad/*/run.json")) and time.monotonic() < deadline:
        time.sleep(0.01)
    try:
        os.kill(process, signal.SIGSTOP)  # it is in the middle of its run until it goes on
        try:
            with pytest.raises(Exception, match=rf"{out} is in use by process {process} on \S+"):
                label(project, surveys["west"], out)
            other = label(project, surveys["west"], tmp_path / "other")
        finally:
            os.kill(process, signal.SIGCONT)
    finally:
        done = forked_commands.end()
    assert done.returncode == 0, done.stderr
    for folder, name in ((out, "east"), (other, "west")):
        assert list(contents(folder)) == NAMES
        assert np.array_equal(laspy.read(folder / "street.laz").xyz, laspy.read(surveys[name]).xyz)


def test_results_below_a_survey_are_no_part_of_it_and_its_stores_may_stay(project, surveys, tmp_path, caplog):
    folder = street(tmp_path / "survey" / "street.laz", 5).parent
    label(project, folder, folder / "first")
    out = label(project, folder, tmp_path / "second", keep_state=True)
    assert list(contents(out)) == NAMES
    said = [text for text in caplog.messages if "is in a folder of labelled results: skipped" in text]
    assert len(said) == 1 and "first/" in said[0]
    assert {path.name for path in out.glob(".mlsroad/*/*")} >= {"files", "pieces", "results", "written", "model"}
    label(project, folder, out)  # the same run, finished, without its stores
    assert sorted(path.name for path in out.glob(".mlsroad/*/*")) == ["run.json", "summary.json"]


def test_a_store_of_mlflow_that_fails_loses_no_result(project, surveys, first, tmp_path, monkeypatch):
    from mlsroad_pipeline.hooks.run_records import RunRecords

    def fails(*_):
        raise sqlite3.OperationalError("database is locked\n[SQL: INSERT INTO metrics]")

    monkeypatch.setattr(RunRecords, "add", fails)
    with pytest.raises(Exception) as caught:
        label(project, surveys["east"], tmp_path / "out")
    said = last_line(caught.value)
    assert "TrackingStoreError: the store of MLflow sqlite:///" in said
    assert "mlflow.db failed: database is locked; the results are written, but this run is not recorded whole" in said
    assert (tmp_path / "out/street.laz").read_bytes() == (first / "street.laz").read_bytes()
    assert list(contents(tmp_path / "out")) == NAMES
    (record,) = tmp_path.glob("out/.mlsroad/*/run.json")
    assert json.loads(record.read_text())["state"] == "finished"
