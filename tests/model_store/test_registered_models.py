"""Versions and aliases in a registry in SQLite, and when a registry is asked at all."""

import os
import subprocess
import sys

import mlflow
import numpy as np
import pytest
from helpers.wiring import empty_store

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.label.model_choice import choose_model, load_choice
from mlsroad_pipeline.model_store.registered_models import MlflowStore, configured_store
from mlsroad_pipeline.model_store.registration import register_bundle

CLASSES = {"classes": ["ground", "object"], "trained_on": "a planted street"}


pytestmark = pytest.mark.filterwarnings("ignore:.*An input example was not provided")


def without_example(log_model):
    return lambda **options: log_model(**{**options, "input_example": None})


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """Two versions of one method and one of another, the first of them the champion; other models are registered too."""
    folder = tmp_path_factory.mktemp("registry")
    (folder / "mlflow.db").write_bytes(empty_store())
    before = mlflow.get_tracking_uri()
    uri = f"sqlite:///{folder / 'mlflow.db'}"
    mlflow.set_tracking_uri(uri)
    try:
        mlflow.set_experiment(
            experiment_id=mlflow.create_experiment("registry", artifact_location=(folder / "artifacts").as_uri())
        )
        for slug, number in (("patch_svm", 1), ("patch_svm", 2), ("patch_forest", 1)):
            with pytest.MonkeyPatch.context() as patch:  # the planted models label nothing: no input example is tried
                patch.setattr(mlflow.pyfunc, "log_model", without_example(mlflow.pyfunc.log_model))
                register_bundle(ModelBundle(slug, {"number": np.array([number])}, CLASSES), f"mlsroad-{slug}")
        client = mlflow.MlflowClient()
        client.create_registered_model("someone-else")
        client.set_registered_model_alias("mlsroad-patch_svm", "champion", "1")
        yield MlflowStore(uri)
    finally:
        mlflow.set_tracking_uri(before)


def test_versions_and_aliases_of_the_methods_alone(store):
    found = store.versions()
    assert [(item.method, item.version, item.aliases) for item in found] == [
        ("patch_forest", 1, ("challenger",)),
        ("patch_svm", 1, ("champion",)),
        ("patch_svm", 2, ("challenger",)),
    ]
    assert {item.trained_on for item in found} == {"a planted street"}


def test_champion_is_chosen_and_loaded_with_its_version(store):
    choice = choose_model(store=store)
    assert choice.name == "mlsroad-patch_svm version 1"
    bundle = load_choice(choice, store)
    assert bundle.arrays["number"].tolist() == [1]
    assert (bundle.metadata["registered"]["name"], bundle.metadata["registered"]["version"]) == ("mlsroad-patch_svm", 1)
    named = choose_model(method="patch_svm", model=2, store=store)
    assert load_choice(named, store).arrays["number"].tolist() == [2]


def test_process_without_tracking_has_no_store_and_imports_no_mlflow():
    code = (
        "import sys\n"
        "from mlsroad_pipeline.model_store.registered_models import configured_store\n"
        "from mlsroad_pipeline.label.model_choice import load_choice\n"
        "from mlsroad_pipeline.label.model_choice import choose_model\n"
        "assert configured_store() is None\n"
        "print(load_choice(choose_model()).slug, 'mlflow' in sys.modules)"
    )
    plain = {key: value for key, value in os.environ.items() if not key.startswith("MLFLOW")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=plain)
    assert done.stdout.split() == ["pool", "False"], done.stderr


def test_tracking_uri_of_the_environment_names_a_store(monkeypatch):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "sqlite:////nowhere/mlflow.db")
    assert configured_store() == MlflowStore()
