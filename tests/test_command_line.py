"""Parameters from the command line: what `--params` changes, and errors before anything runs."""

import dataclasses
import re
from pathlib import Path

import click
import pytest
import yaml
from helpers.conf import base, context_of, from_command_line, parameters_of
from helpers.wiring import last_line, make_project
from kedro.io import DatasetError

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.cli import _with_one_line_errors
from mlsroad_pipeline.surveys.plan import plan_comparison, plan_labelling


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return make_project(tmp_path_factory.mktemp("conf"), tiny=False)


@pytest.fixture(autouse=True)
def _some_data(monkeypatch, tmp_path):
    monkeypatch.setenv("MLSROAD_DATA", str(tmp_path))


def test_command_line_changes_the_survey(project, tmp_path):
    given = from_command_line("survey.root=2019,survey.splits.train=a/*,survey.splits.test=b/*")
    for name in ("a", "b"):
        (tmp_path / "2019" / name).mkdir(parents=True)
        (tmp_path / "2019" / name / "x.las").touch()
    parameters = parameters_of(project, **given)
    survey = dataclasses.replace(parameters["survey"], root=tmp_path / str(parameters["survey"].root))
    plan = plan_comparison(survey, parameters["ingest"], parameters["classes"]["codings"])
    assert [(file.split, file.source.name) for file in plan.files] == [("train", "a/x.las"), ("test", "b/x.las")]


@pytest.mark.parametrize("value", ["a.las", ["a.las"], {"files": ["a.las"], "along": [0, 0.5]}])
def test_split_of_the_base_can_be_a_string_a_list_or_a_mapping(project, value):
    parameters = parameters_of(project, survey={"splits": {"train": value}})
    assert parameters["survey"].splits == {**base("survey")["splits"], "train": value}


def test_split_of_the_base_can_be_left_out(project, tmp_path):
    given = {"survey": {"root": str(tmp_path), "splits": {"train": "*.las", "test": None}}}
    (tmp_path / "x.las").touch()
    parameters = parameters_of(project, **given)
    plan = plan_comparison(parameters["survey"], parameters["ingest"], parameters["classes"]["codings"])
    assert [file.split for file in plan.files] == ["train"]


def test_command_line_changes_execution_of_every_store(project):
    given = from_command_line("execution.backend=threading,execution.n_workers=3")
    catalog = context_of(project, "base", **given).catalog
    for name in ("scenes", "ground", "detrended_forest.labels", "label_results_store", "simulated_surveys"):
        execution = catalog.get(name)._describe()["execution"]
        assert (execution.backend, execution.n_workers) == ("threading", 3), name


def test_command_line_says_where_results_of_label_go(project, tmp_path):
    given = from_command_line(f"label.survey=12,label.output={tmp_path / 'out'},label.model=3,label.method=other")
    context = context_of(project, "base", **given)
    catalog, parameters = context.catalog, context.params["label"]
    assert Path(catalog.get("label_inventory")._describe()["filepath"]) == tmp_path / "out" / "inventory.gpkg"
    table = catalog.get("label_inventory_table")._describe()["filepath"]
    assert Path(table) == tmp_path / "out" / "inventory.parquet"
    assert str(tmp_path / "out" / "report.html") in str(catalog.get("label_report")._describe())
    assert (parameters.method, parameters.model) == ("other", 3)
    with pytest.raises(Exception, match="12 does not exist"):
        plan_labelling(parameters, IngestParameters())


def test_environment_says_where_results_of_label_go_and_the_command_line_overrules_it(tmp_path):
    project = make_project(tmp_path / "project", tiny=False)
    own = {"label": {"output": str(tmp_path / "out"), "method": "other", "model": 4}}
    (project / "conf/local/parameters_label.yml").write_text(yaml.safe_dump(own), encoding="utf-8")
    context = context_of(project, "local")
    catalog = context.catalog
    assert Path(catalog.get("label_inventory")._describe()["filepath"]) == tmp_path / "out/inventory.gpkg"
    assert str(tmp_path / "out/report.html") in str(catalog.get("label_report")._describe())
    assert (context.params["label"].method, context.params["label"].model) == ("other", 4)
    overruled = context_of(project, "local", label={"output": str(tmp_path / "here")})
    path = overruled.catalog.get("label_inventory")._describe()["filepath"]
    assert Path(path) == tmp_path / "here/inventory.gpkg"
    assert overruled.params["label"].method == "other"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("supervoxelise.voxel_sise=0.1", "voxel_sise"),
        ("supervoxelise.voxel_size=0", "supervoxelise.voxel_size must be a finite number > 0, got 0"),
        ("supervoxelise.distance=far", "distance.*'far'"),
        ("ingest.cut=across", "ingest.cut must be 'along' or 'file', got 'across'"),
        ("detrended_forest.n_trees=0", "n_trees must be at least 1, got 0"),
        ("features.region=mine", "region.*mine"),
        ("features.column_size=-1", "column_size.*-1"),
        ("label.model=-1", "label.model must be a version.*got -1"),
        ("ingest.outliers.k=0", "outliers.k must be at least 1, got 0"),
        ("ground_removal.voxel_size=wide", "voxel_size.*'wide'"),
    ],
)
def test_wrong_parameters_are_named_before_anything_runs(project, text, message):
    with pytest.raises(Exception) as caught:  # Kedro wraps them in errors of its own
        assert parameters_of(project, **from_command_line(text))
    assert re.search(message, last_line(caught.value)), last_line(caught.value)


def test_wrong_execution_is_named_before_anything_runs(project):
    given = from_command_line("execution.n_workers=0")
    with pytest.raises(DatasetError, match=r"n_workers .*got 0"):
        context_of(project, "base", **given).catalog.get("scenes")


def test_kedro_run_ends_with_one_line_for_an_error_of_known_cause_and_a_traceback_for_others():
    def failing(error, cause=None):
        raise error from cause

    run = _with_one_line_errors(failing)
    with pytest.raises(click.ClickException, match=r"^a\.laz is damaged$"):
        run(DatasetError("Failed while loading data"), ReadError("a.laz is damaged"))
    with pytest.raises(click.ClickException, match="^wide$"):
        run(ValueError("Failed to instantiate GroundParameters for parameter 'ground_removal': wide"))
    with pytest.raises(ZeroDivisionError):
        run(ZeroDivisionError("division by zero"))
