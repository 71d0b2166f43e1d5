"""Models of the package: registry, hashes, cards, sizes, and stored labels of a part of a street."""

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from helpers.wiring import REPOSITORY
from helpers.yaml_files import read_yaml

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import model_source
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.model_store import shipped_models as module
from mlsroad_pipeline.model_store.shipped_entry import ShippedParameters
from mlsroad_pipeline.model_store.shipped_models import (
    CARD,
    FOLDER,
    load_shipped,
    model_card,
    save_entry,
    save_shipped,
    shipped_models,
)
from mlsroad_pipeline.simulation.parameters.presets import expanded_surveys

MODELS = shipped_models()
STORED = Path(__file__).with_name("predictions")
LARGEST = 3_000_000
RIGHT = 0.8
"""Least share of right labels."""


@pytest.fixture
def copy(tmp_path):
    shutil.copytree(FOLDER, tmp_path / "shipped")
    return tmp_path / "shipped"


def test_package_has_two_models_of_at_most_3_megabytes_and_nothing_else():
    assert list(MODELS) == ["general", "pool"]
    files = {path for path in FOLDER.rglob("*") if path.is_file()}
    named = {FOLDER / name / file for name, model in MODELS.items() for file in (*model.files, CARD)}
    assert files == named | {FOLDER / module.REGISTRY}
    assert sum(path.stat().st_size for path in files) <= LARGEST
    assert {path.suffix for path in files} == {".npz", ".json", ".md"}


@pytest.mark.parametrize("name", MODELS)
def test_arrays_are_plain_and_entry_agrees_with_the_files(name):
    model, bundle = MODELS[name], load_shipped(name)
    assert all(
        not values.dtype.hasobject for values in np.load(FOLDER / name / "arrays.npz", allow_pickle=False).values()
    )
    assert (bundle.slug, bundle.classes) == (model.method, model.classes)
    assert model_source(bundle) == {"name": name, "version": model.version, "source": "shipped"}
    assert all(row.points > 0 and 0.2 < row.overall_accuracy <= 1 for row in model.scores) and len(model.scores) >= 6


@pytest.mark.parametrize("name", MODELS)
def test_card_is_generated_from_the_entry(name):
    assert (FOLDER / name / CARD).read_text(encoding="utf-8") == model_card(asdict(MODELS[name]))


@pytest.mark.parametrize("name", MODELS)
def test_entry_is_that_of_the_environment_that_trains_the_model(name):
    environment = "general"
    config = read_yaml(REPOSITORY / "conf/general/parameters.yml")
    own = config["shipped"]
    assert own["name"] == environment and MODELS[name].summary.startswith(own["summary"])
    recorded = {key: (r["title"], r["licence"], r["sha256"]) for key, r in own.get("recordings", {}).items()}
    of_entry = MODELS[name].recordings
    assert {key: (r["title"], r["licence"], r["sha256"]) for key, r in of_entry.items()} == recorded
    assert MODELS[name].command == ShippedParameters(environment).command() == f"kedro run --env={environment}"
    surveys = {key: value for key, value in config["simulation"]["surveys"].items() if value is not None}
    own = {key: value for key, value in expanded_surveys(surveys).items() if key.startswith("train")}
    stored = {key: MODELS[name].training[key] for key in own}
    assert json.dumps(stored, sort_keys=True) == json.dumps(own, sort_keys=True)


@pytest.mark.parametrize("variant", ["geometry", "geometry+intensity", "geometry+rgb+intensity"])
@pytest.mark.parametrize("name", MODELS)
def test_labels_of_a_street_are_those_that_were_stored_with_the_model(name, variant):
    stored = np.load(STORED / f"{name}.npz")
    columns = {"rgb": stored["rgb"], "intensity": stored["intensity"].astype(np.float32) / 255}
    chosen = {key: columns[key] for key in variant.split("+")[1:]}
    cloud = PointCloud(stored["xyz"] / 1000, {**chosen, "core": np.ones(len(stored["xyz"]), bool)}, source="a street")
    labels, confidence = label_cloud(load_shipped(name), cloud)
    np.testing.assert_array_equal(labels, stored[variant])
    assert (labels == stored["truth"])[stored["truth"] >= 0].mean() > RIGHT and confidence.min() >= 0


@pytest.mark.parametrize("file", ["arrays.npz", "model.json"])
def test_damaged_or_missing_file_is_named(copy, file):
    path = copy / "pool" / file
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(ReadError, match=rf"{path} is damaged \(wrong SHA256\): install mlsroad_pipeline again"):
        load_shipped("pool", copy)
    path.unlink()
    with pytest.raises(ReadError, match=f"{path} is missing"):
        load_shipped("pool", copy)
    load_shipped("general", copy)


def test_unknown_name_lists_the_models():
    with pytest.raises(ParameterError, match=r"'urban' \(models: general, pool\)"):
        load_shipped("urban")
    with pytest.raises(ParameterError, match=r"shipped.name is not set: kedro run --env=general"):
        ShippedParameters().command()


def test_saving_again_gives_the_same_bytes_and_a_new_entry_keeps_the_other(copy):
    before = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()}
    bundle = load_shipped("pool", copy)
    plain = replace(bundle, metadata={k: v for k, v in bundle.metadata.items() if k != "shipped"})
    save_shipped(plain, replace(MODELS["pool"], files={}), copy)
    assert {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()} == before
    save_entry(replace(MODELS["general"], summary="Another"), copy)
    assert shipped_models(copy)["pool"] == MODELS["pool"]
    assert "Another. Method" in (copy / "general" / CARD).read_text(encoding="utf-8")
    assert list(json.loads((copy / module.REGISTRY).read_text(encoding="utf-8"))["models"]) == ["general", "pool"]
