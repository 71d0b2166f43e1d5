"""The tracked run of `label`: metrics, name, inputs and artifacts, read through MLflow's client."""

import geopandas as gpd
import mlflow
import pytest
from helpers.labelled import N_POINTS
from helpers.wiring import label, tracked_runs

from mlsroad_pipeline.hooks.run_details import fingerprint_files

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.fixture(scope="module")
def output(label_project, survey, tmp_path_factory):
    return label(label_project, survey, tmp_path_factory.mktemp("tracked") / "out", method="detrended_forest")


@pytest.fixture(scope="module")
def tracked(label_project, output):
    return tracked_runs(label_project)["label"]


def test_the_metrics_are_counts_shares_confidences_and_speed(tracked, output):
    metrics = tracked.data.metrics
    assert len([name for name in metrics if not name.startswith("system/")]) >= 15
    assert metrics["points"] == N_POINTS and metrics["files"] == 1
    assert sum(value for name, value in metrics.items() if name.startswith("points/")) == N_POINTS
    assert sum(value for name, value in metrics.items() if name.startswith("share/")) == pytest.approx(1)
    assert metrics["objects"] == len(gpd.read_file(output / "inventory.gpkg", layer="objects"))
    assert metrics["points_per_second"] == pytest.approx(N_POINTS / metrics["seconds"])
    assert 0 <= metrics["confidence/low_share"] < 1 and 0.5 < metrics["confidence/median"] <= 1
    assert 0 < metrics["confidence/median/paved ground"] <= 1


def test_name_tags_and_inputs_say_what_was_labelled_with_which_model(tracked, survey, label_project):
    client = mlflow.MlflowClient(f"sqlite:///{label_project / 'mlflow.db'}")
    assert tracked.info.run_name == "label street.laz with detrended_forest version 1"
    assert tracked.data.tags["mlsroad.method"] == "detrended_forest"
    assert tracked.data.tags["runner"] == "SequentialRunner"
    (data,) = tracked.inputs.dataset_inputs
    assert (data.dataset.name, data.dataset.digest) == ("street.laz", fingerprint_files([survey])["digest"])
    (model,) = client.get_run(tracked.info.run_id).inputs.model_inputs  # a search leaves them out
    version = client.get_model_version("mlsroad-detrended_forest", "1")
    assert version.source == f"models:/{model.model_id}"
    logged = client.get_logged_model(model.model_id)
    assert not any(metric.run_id == tracked.info.run_id for metric in logged.metrics)


def test_the_inventory_and_the_report_are_artifacts_and_clouds_are_not(tracked, output, label_project):
    client = mlflow.MlflowClient(f"sqlite:///{label_project / 'mlflow.db'}")
    folders = [folder.path for folder in client.list_artifacts(tracked.info.run_id) if folder.is_dir]
    found = {file.path for folder in folders for file in client.list_artifacts(tracked.info.run_id, folder)}
    assert found == {
        "environment/pip_freeze.txt",
        "inventory/inventory.gpkg",
        "inventory/inventory.parquet",
        "inventory/objects.json",
        "reports/report.html",
    }
