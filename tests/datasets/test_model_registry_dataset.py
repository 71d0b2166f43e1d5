"""Models through a registry in SQLite, and out of it in a process that knows nothing."""

import shutil
import subprocess
import sys
import textwrap
import types
from pathlib import Path

import mlflow
import numpy as np
import pandas as pd
import pytest
from helpers.wiring import empty_store
from kedro.io import DatasetError

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MissingColumnError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS, Method
from mlsroad_pipeline.datasets.model_registry_dataset import RegisteredModelDataset
from mlsroad_pipeline.model_store.point_labeller import table_to_cloud
from mlsroad_pipeline.model_store.registration import example_points

SOURCE = Path(__file__).resolve().parents[2] / "src"
NAME = "mlsroad-planted"
MODULE = "mlsroad_pipeline.algorithms.planted_for_registry"
PLACE = "algorithms.planted_for_registry:label"
LABELLER = """
import numpy as np


def label(cloud, bundle):
    above = cloud.xyz[:, 2] + cloud.origin[2] > bundle.arrays["height"][0]
    return np.where(above, 1, 0), np.full(len(cloud), 0.75)
"""


def planted(height):
    metadata = {
        "classes": ["ground", "object"],
        "parameters": {"height": height},
        "trained_on": "a planted street",
        "feature_names": ["z"],
    }
    return ModelBundle("planted", {"height": np.array([height])}, metadata)


@pytest.fixture(scope="module")
def registry(tmp_path_factory):
    """Two versions in one store."""
    folder = tmp_path_factory.mktemp("registry")
    (folder / "mlflow.db").write_bytes(empty_store())
    before = mlflow.get_tracking_uri()
    module = types.ModuleType(MODULE)
    exec(LABELLER, module.__dict__)
    sys.modules[MODULE] = module
    METHODS["planted"] = Method("planted", "labelling", "", label_cloud=PLACE)
    mlflow.set_tracking_uri(f"sqlite:///{folder / 'mlflow.db'}")
    experiment = mlflow.create_experiment("registry", artifact_location=(folder / "artifacts").as_uri())
    mlflow.set_experiment(experiment_id=experiment)
    try:
        dataset = RegisteredModelDataset(name=NAME)
        assert not dataset.exists()
        with pytest.raises(DatasetError, match=f"no model '{NAME}' is registered in sqlite:.*run the comparison"):
            dataset.load()
        dataset.save(planted(0.5))
        assert mlflow.active_run() is None
        with mlflow.start_run() as run:
            dataset.save(planted(9.0))
        yield folder, run.info.run_id
    finally:
        mlflow.set_tracking_uri(before)
        del sys.modules[MODULE], METHODS["planted"]


def test_loading_takes_the_highest_version_or_the_one_asked_for(registry):
    _, run_id = registry
    highest = RegisteredModelDataset(name=NAME).load()
    assert highest.arrays["height"] == [9.0]
    assert highest.metadata["registered"] == {"name": NAME, "version": 2, "run_id": run_id}
    first = RegisteredModelDataset(name=NAME, model_version="1").load()
    assert first.arrays["height"] == [0.5]
    assert first.metadata["parameters"] == {"height": 0.5}
    with pytest.raises(DatasetError, match=f"model '{NAME}' version 7 cannot be read"):
        RegisteredModelDataset(name=NAME, model_version=7).load()
    exists = [RegisteredModelDataset(name=NAME, model_version=v).exists() for v in (None, 1, 2, 3)]
    assert exists == [True, True, True, False]


def test_model_that_has_not_changed_gets_no_new_version(registry, caplog):
    folder, _ = registry
    name = "mlsroad-still"
    dataset = RegisteredModelDataset(name=name)
    with caplog.at_level("INFO", logger="mlsroad_pipeline"):
        for height in (1.0, 1.0, 2.0, 1.0):  # the last differs from the highest version, which counts
            dataset.save(planted(height))
    told = [m for m in caplog.messages if name in m]
    assert told == [
        f"Registered {name} version 1",
        f"Unchanged: {name} version 1",
        f"Registered {name} version 2",
        f"Registered {name} version 3",
    ]
    dataset.save(dataset.load())  # what loading adds to the metadata is not part of the model
    assert len(mlflow.MlflowClient().search_model_versions(f"name='{name}'")) == 3
    source = mlflow.artifacts.download_artifacts(f"models:/{name}/3")
    assert Path(source).is_relative_to(folder / "artifacts")
    shutil.rmtree(source)
    dataset.save(planted(1.0))  # the files are gone: a version that can be read is needed
    assert dataset.load().metadata["registered"]["version"] == 4


def test_registered_model_tells_its_signature_example_and_origin(registry):
    info = mlflow.models.get_model_info(f"models:/{NAME}/1")
    assert info.signature.inputs.input_names() == ["x", "y", "z", "red", "green", "blue", "intensity"]
    assert info.signature.inputs.required_input_names() == ["x", "y", "z"]
    assert info.signature.outputs.input_names() == ["label", "class", "confidence"]
    assert info.metadata["slug"] == "planted"
    assert info.metadata["trained_on"] == "a planted street"
    assert info.metadata["classes"] == ["ground", "object"]
    model = mlflow.pyfunc.load_model(f"models:/{NAME}/1")
    pd.testing.assert_frame_equal(model.input_example, example_points(), check_dtype=False)
    assert mlflow.MlflowClient().get_model_version(NAME, "1").tags["trained_on"] == "a planted street"


def test_nothing_is_pickled(registry):
    folder, _ = registry
    files = {path.name for path in (folder / "artifacts").rglob("*") if path.is_file()}
    assert {"arrays.npz", "model.json", "registered_model_code.py", "MLmodel", "requirements.txt"} <= files
    assert not any(name.endswith((".pkl", ".pickle", ".joblib")) for name in files)


def test_files_that_are_not_those_registered_are_refused(registry):
    folder, _ = registry
    name = "mlsroad-exchanged"
    dataset = RegisteredModelDataset(name=name)
    dataset.save(planted(3.0))
    for file in folder.rglob("model.json"):
        file.write_text(file.read_text().replace('"height": 3.0', '"height": 3.5'))
    with pytest.raises(DatasetError, match=f"model '{name}' version 1: .*bundle differs from the files that were regi"):
        dataset.load()


def test_a_fresh_process_loads_and_predicts_with_this_package_alone(registry, tmp_path):
    folder, _ = registry
    (tmp_path / f"{MODULE.rsplit('.', 1)[1]}.py").write_text(LABELLER)
    script = f"""
        import mlsroad_pipeline.algorithms
        mlsroad_pipeline.algorithms.__path__.append({str(tmp_path)!r})
        from mlsroad_pipeline.algorithms.models.methods import METHODS, Method
        METHODS["planted"] = Method("planted", "labelling", "", label_cloud={PLACE!r})
        import mlflow, pandas
        mlflow.set_tracking_uri("sqlite:///{folder / "mlflow.db"}")
        model = mlflow.pyfunc.load_model("models:/{NAME}/1")
        columns = {{"x": [431000.5, 431001.0], "y": [4583000.0, 4583001.0], "z": [0.25, 60.0]}}
        points = pandas.DataFrame(columns, index=[7, 3])
        print(model.predict(points).to_csv())
    """
    command = [sys.executable, "-c", textwrap.dedent(script)]
    alone = {"PYTHONPATH": str(SOURCE), "PATH": "/usr/bin:/bin"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, env=alone)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [",label,class,confidence", "7,0,ground,0.75", "3,1,object,0.75"]


def test_the_table_becomes_a_cloud_that_keeps_millimetres():
    points = pd.DataFrame(
        {"x": [431000.001], "y": [4583000.002], "z": [70.003], "red": [1], "green": [2], "blue": [255]}
    )
    cloud = table_to_cloud(points)
    np.testing.assert_array_equal(cloud.origin, [431000, 4583000, 70])
    np.testing.assert_allclose(cloud.xyz, [[0.001, 0.002, 0.003]], atol=1e-8)
    np.testing.assert_array_equal(cloud["rgb"], [[1, 2, 255]])
    assert cloud.get("intensity") is None
    assert len(table_to_cloud(points.head(0))) == 0
    assert table_to_cloud(points.assign(intensity=0.5))["intensity"].dtype == np.float32


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda t: t.drop(columns="y"), MissingColumnError, r"no column 'y' \(columns: x, z"),
        (lambda t: t.drop(columns="blue"), MissingColumnError, "no column 'blue'"),
        (lambda t: t.assign(z=[0.0, np.nan]), DataError, "z is nan in row 1"),
        (lambda t: t.assign(red=[0, 256]), DataError, "red is 256.0 in row 1"),
        (lambda t: t.assign(intensity=[1.5, 0]), DataError, "intensity is 1.5 in row 0"),
    ],
)
def test_points_that_cannot_be_labelled_are_named(change, error, message):
    points = pd.DataFrame({name: [0.0, 1.0] for name in ("x", "y", "z", "red", "green", "blue")})
    with pytest.raises(error, match=message):
        table_to_cloud(change(points))
