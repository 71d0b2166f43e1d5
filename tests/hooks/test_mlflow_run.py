"""Records of a tracked run: one small Kedro project runs once, and each test reads its store."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import mlflow
import pytest
import yaml
from helpers.tracked_project import write_and_run
from kedro_mlflow.config.kedro_mlflow_config import KedroMlflowConfig

from mlsroad_pipeline.hooks import mlflow_run
from mlsroad_pipeline.hooks.mlflow_run import MlflowDetailsHooks, resolve_store
from mlsroad_pipeline.hooks.run_details import fingerprint_files

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return write_and_run(tmp_path_factory.mktemp("project") / "small")


@pytest.fixture(scope="module")
def client(project):
    return mlflow.MlflowClient(f"sqlite:///{project / 'mlflow.db'}")


@pytest.fixture(scope="module")
def runs(client):
    experiment = client.get_experiment_by_name("mlsroad")
    found = client.search_runs([experiment.experiment_id])
    return {run.info.run_name: run for run in found}, found


@pytest.fixture(scope="module")
def run(runs):
    return runs[0]["compare"]


@pytest.fixture(scope="module")
def child(runs):
    return runs[0]["demo"]


def artifact(run, *parts):
    path = Path(run.info.artifact_uri.removeprefix("file://")).joinpath(*parts)
    return path.read_text() if path.suffix != ".png" else path.read_bytes()


def test_one_run_per_command_with_one_per_method_and_none_where_tracking_is_off(runs, run, child):
    named, found = runs
    assert len(found) == 3
    statuses = {name: run.info.status for name, run in named.items()}
    assert statuses == {"compare": "FINISHED", "demo": "FINISHED", "bad": "FAILED"}
    assert child.data.tags["mlflow.parentRunId"] == run.info.run_id
    assert child.data.tags["mlsroad.method"] == "demo"
    assert run.data.tags["runner"] == "SequentialRunner"


def test_every_parameter_is_recorded_flat_and_once(run, project):
    note = run.data.params.pop("note")
    assert run.data.params == {
        "execution.backend": "loky",
        "execution.n_workers": "2",
        "files": str([str(project / "raw" / name) for name in ("a.laz", "b.laz")]),
        "forest.n_trees": "100",
        "forest.depth": "None",
    }
    assert len(note) == 6000
    assert note.endswith("x…")


def test_parameters_are_kept_in_full_beside(run):
    assert json.loads(artifact(run, "parameters.json"))["note"] == "x" * 7000


def test_scores_become_metrics_of_the_method_and_undefined_ones_are_left_out(run, child):
    assert child.data.metrics["test/recall/road"] == 0.8
    assert child.data.metrics["test/overall_accuracy"] == 0.8
    assert child.data.metrics["test/f1/car"] == 0.0
    assert "test/recall/car" not in child.data.metrics
    assert not any(name.startswith("test/") for name in run.data.metrics)


def test_the_data_set_of_the_scores_is_an_input_with_its_digest(run, child, project):
    (found,) = child.inputs.dataset_inputs
    digest = fingerprint_files([project / "raw" / name for name in ("a.laz", "b.laz")])["digest"]
    assert (found.dataset.name, found.dataset.digest) == ("test", digest)
    assert [(tag.key, tag.value) for tag in found.tags] == [("mlflow.data.context", "testing")]
    assert [found.dataset.digest for found in run.inputs.dataset_inputs] == [digest]
    assert mlflow.data.get_source(found.dataset).load() == str(project / "raw")


def test_figures_and_reports_become_artifacts(run, project):
    assert artifact(run, "figures", "demo_birds_eye.png") == (project / "data" / "demo_birds_eye.png").read_bytes()
    assert artifact(run, "reports", "report.html").startswith("<!DOCTYPE html>")


def test_the_data_are_fingerprinted(run):
    table = json.loads(artifact(run, "data_fingerprint.json"))
    assert [entry["path"] for entry in table["files"]] == ["a.laz", "b.laz"]
    assert run.data.tags["data.fingerprint"] == table["digest"]


def test_the_commit_and_the_environment_are_recorded(run, project):
    head = subprocess.run(["git", "-C", str(project), "rev-parse", "HEAD"], capture_output=True, text=True, check=True)
    assert run.data.tags["git.commit"] == run.data.tags["mlflow.source.git.commit"] == head.stdout.strip()
    assert run.data.tags["git.dirty"] == "true"
    assert run.data.tags["python"].startswith("3.")
    assert "numpy==" in artifact(run, "environment", "pip_freeze.txt")


def test_a_model_is_registered_by_the_run_of_its_method_and_has_its_metrics(child, client):
    (version,) = client.search_model_versions("name='mlsroad-demo'")
    assert (version.version, version.run_id) == (1, child.info.run_id)
    assert version.description.startswith("Trained on unknown data.\n\nClasses: road, car.\n\nScores: test: ")
    assert client.get_model_version_by_alias("mlsroad-demo", "challenger").version == 1
    model = client.get_logged_model(version.source.removeprefix("models:/"))
    assert {metric.key: metric.value for metric in model.metrics} == child.data.metrics
    assert {metric.dataset_name for metric in model.metrics} == {"test"}


def test_a_failed_run_keeps_its_parameters(runs):
    assert runs[0]["bad"].data.params == {"forest.n_trees": "100", "forest.depth": "None"}


def test_the_store_lies_in_the_project_wherever_the_command_starts(project):
    assert (project / "mlflow.db").is_file()
    assert (project / "mlartifacts").is_dir()


def test_node_inputs_are_left_alone_while_nothing_is_tracked():
    inputs = {"params:a": 1, "scores": 2}
    MlflowDetailsHooks().before_node_run(inputs=inputs)
    assert inputs == {"params:a": 1, "scores": 2}


@pytest.mark.parametrize(
    ("uri", "expected"),
    [
        ("sqlite:///mlflow.db", "sqlite:////project/mlflow.db"),
        ("sqlite:///sub/mlflow.db", "sqlite:////project/sub/mlflow.db"),
        ("sqlite:////tmp/mlflow.db", "sqlite:////tmp/mlflow.db"),
        ("sqlite:///:memory:", "sqlite:///:memory:"),
        ("https://host", "https://host"),
        (None, None),
    ],
)
def test_only_relative_databases_are_moved_below_the_project(uri, expected, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    monkeypatch.setattr(mlflow_run, "_check_server", lambda uri, wait: None)  # there is none
    loader = SimpleNamespace(config_patterns={"mlflow": []})

    class Loader(dict):
        config_patterns = loader.config_patterns

    context = SimpleNamespace(
        config_loader=Loader(mlflow={"server": {"mlflow_tracking_uri": uri}}), project_path="/project"
    )
    MlflowDetailsHooks().after_context_created(context)
    assert context.config_loader["mlflow"]["server"]["mlflow_tracking_uri"] == expected


@pytest.mark.parametrize(
    ("given", "expected"), [("https://host", "https://host"), ("sqlite:///a.db", "sqlite:///{}/a.db")]
)
def test_the_environment_variable_has_precedence_over_the_configuration(given, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", given)
    own = {"experiment": {"name": "mlsroad", "create_experiment_kwargs": {"artifact_location": "mlartifacts"}}}
    config = {"server": {"mlflow_tracking_uri": "sqlite:///mlflow.db"}, "tracking": own}
    resolved = resolve_store(config, Path("/project"))
    assert resolved["server"]["mlflow_tracking_uri"] == expected.format(tmp_path)
    place = resolved["tracking"]["experiment"]["create_experiment_kwargs"]["artifact_location"]
    assert place == ((tmp_path / "mlartifacts").as_uri() if given.startswith("sqlite") else None)
    assert own["experiment"]["create_experiment_kwargs"]["artifact_location"] == "mlartifacts"


def test_an_address_that_mlflow_copied_to_the_environment_is_no_wish_of_the_user(monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    config = {"server": {"mlflow_tracking_uri": "sqlite:///mlflow.db"}}
    first = resolve_store(config, Path("/first"))["server"]["mlflow_tracking_uri"]
    monkeypatch.setenv("MLFLOW_TRACKING_URI", first)  # as `mlflow.set_tracking_uri` does
    assert resolve_store(config, Path("/second"))["server"]["mlflow_tracking_uri"] == "sqlite:////second/mlflow.db"


def test_the_settings_import_neither_mlflow_nor_its_hooks():
    code = "import sys, mlsroad_pipeline.settings; print({'mlflow', 'kedro_mlflow', 'matplotlib'} & set(sys.modules))"
    environment = {"PYTHONPATH": str(REPOSITORY / "src")}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_a_project_without_configuration_is_left_alone():
    context = SimpleNamespace(config_loader={}, project_path="/project")
    MlflowDetailsHooks().after_context_created(context)
    assert context.config_loader == {}


def test_the_configuration_shown_is_the_whole_schema_and_explains_what_differs():
    path = REPOSITORY / "conf" / "base" / "mlflow.yml"
    shown = yaml.safe_load(path.read_text())
    default = KedroMlflowConfig().model_dump()
    assert KedroMlflowConfig.model_validate(shown).model_dump() == shown

    def leaves(tree, prefix=""):
        for key, value in tree.items():
            if isinstance(value, dict) and value and key != "tags":  # names of tags are no part of the schema
                yield from leaves(value, f"{prefix}{key}.")
            else:
                yield f"{prefix}{key}", value

    ours, theirs = dict(leaves(shown)), dict(leaves(default))
    assert set(ours) == set(theirs)
    differing = {key for key in ours if ours[key] != theirs[key]}
    lines = path.read_text().splitlines()
    for key in differing:
        name = key.rsplit(".", 1)[-1]
        row = next(
            k
            for k, line in enumerate(lines)
            if line.strip().startswith(f"{name}:") and (key.endswith(".tags") or str(ours[key]).lower() in line.lower())
        )
        assert "#" in lines[row] or lines[row - 1].strip().startswith("#"), f"{key} differs without a reason"
    assert "server.mlflow_tracking_uri" in differing
