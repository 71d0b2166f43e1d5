"""Model folders that are damaged or none: refused by name before anything is labelled."""

import json
import os
import shutil

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.model_store.bundle_files import load_bundle, save_bundle
from mlsroad_pipeline.model_store.shipped_models import FOLDER, load_shipped


@pytest.fixture(scope="module")
def general(tmp_path_factory):
    folder = tmp_path_factory.mktemp("model") / "general"
    save_bundle(load_shipped("general"), folder)
    return folder


@pytest.fixture
def folder(general, tmp_path):
    return shutil.copytree(general, tmp_path / "model")


@pytest.mark.parametrize("name", ["model.json", "arrays.npz"])
@pytest.mark.parametrize("kind", ["fifo", "zero", "folder"])
def test_what_is_no_file_is_named(folder, name, kind):
    path = folder / name
    path.unlink()
    {"fifo": lambda: os.mkfifo(path), "zero": lambda: path.symlink_to("/dev/zero"), "folder": path.mkdir}[kind]()
    with pytest.raises(ReadError, match=f"{name} is not a file: the model is damaged"):
        load_bundle(folder)


def test_an_empty_array_is_named_when_the_model_is_read(folder):
    with np.load(folder / "arrays.npz") as stored:
        arrays = dict(stored)
    for name, values in arrays.items():
        np.savez(folder / "arrays.npz", **{**arrays, name: values.reshape(-1)[:0]})
        with pytest.raises(ReadError, match=f"{folder}.*(damaged|need one class each)"):
            load_bundle(folder)


@pytest.mark.parametrize(
    ("ground", "message"),
    [
        ({"voxel": 0.1}, "unexpected keyword argument 'voxel'"),
        ({"voxel_size": "wide"}, "ground"),
        ({"voxel_size": -1.0}, "voxel_size"),
        ([], "not a mapping"),
    ],
)
def test_wrong_parameters_of_the_ground_are_named_when_the_model_is_read(folder, ground, message):
    content = json.loads((folder / "model.json").read_text(encoding="utf-8"))
    content["metadata"]["parameters"]["ground"] = ground
    (folder / "model.json").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ReadError, match=message) as refused:
        load_bundle(folder)
    assert "metadata.parameters.ground" in str(refused.value)


def test_the_shipped_models_are_whole():
    assert all(len(load_shipped(path.name).arrays) for path in FOLDER.iterdir() if (path / "model.json").exists())
