"""Models as plain files."""

import json

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, missing_attributes
from mlsroad_pipeline.model_store.bundle_files import load_bundle, save_bundle

METADATA = {
    "classes": ["ground", "object"],
    "trained_on": "a street",
}


@pytest.fixture
def bundle():
    arrays = {
        "threshold": np.array([0.5]),
        "trees": np.arange(6, dtype=np.int16).reshape(2, 3),
        "none": np.zeros((0, 4)),
    }
    return ModelBundle("planted", arrays, METADATA)


def test_files_give_back_the_model(bundle, tmp_path):
    save_bundle(bundle, tmp_path / "new" / "folder")
    back = load_bundle(tmp_path / "new" / "folder")
    assert back.slug == "planted"
    assert back.metadata == METADATA
    assert sorted(back.arrays) == sorted(bundle.arrays)
    for name, values in bundle.arrays.items():
        assert back.arrays[name].dtype == values.dtype
        np.testing.assert_array_equal(back.arrays[name], values)


def test_the_same_model_gives_the_same_bytes(bundle, tmp_path):
    again = ModelBundle("planted", dict(reversed(bundle.arrays.items())), METADATA)
    for name, model in (("a", bundle), ("b", again)):
        save_bundle(model, tmp_path / name)
    for file in ("arrays.npz", "model.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


@pytest.mark.parametrize(
    ("slug", "arrays", "metadata", "error", "message"),
    [
        ("Planted Model", {}, METADATA, ParameterError, "small letters, digits and _"),
        ("planted", {}, {**METADATA, "classes": []}, ParameterError, "classes must be a list of names"),
        ("planted", {"a": np.array([None])}, METADATA, DataError, "array 'a' holds Python objects"),
        ("planted", {}, {**METADATA, "when": object()}, DataError, "metadata must be JSON values"),
        ("planted", {}, {**METADATA, "oob": float("nan")}, DataError, "metadata must be JSON values"),
    ],
)
def test_what_is_no_model_is_named(slug, arrays, metadata, error, message):
    with pytest.raises(error, match=message):
        ModelBundle(slug, arrays, metadata)


def test_a_changed_byte_is_found(bundle, tmp_path):
    save_bundle(bundle, tmp_path)
    content = bytearray((tmp_path / "arrays.npz").read_bytes())
    at = content.index(np.arange(6, dtype=np.int16).tobytes())
    content[at] ^= 1
    (tmp_path / "arrays.npz").write_bytes(content)
    with pytest.raises(ReadError, match=r"trees.npy"):
        load_bundle(tmp_path)


def test_attributes_that_a_survey_lacks_are_told(bundle):
    both = ModelBundle("planted", {}, {**METADATA, "attributes": ["rgb", "intensity"]})
    assert missing_attributes(both, {"rgb", "gps_time"}) == ["intensity"]
    assert missing_attributes(both, ["intensity", "rgb"]) == []
    assert missing_attributes(bundle, []) == []


def test_damaged_files_are_named(bundle, tmp_path):
    with pytest.raises(ReadError, match=r"is not a model: model.json is missing"):
        load_bundle(tmp_path)
    save_bundle(bundle, tmp_path)
    arrays, content = (tmp_path / "arrays.npz").read_bytes(), json.loads((tmp_path / "model.json").read_text())
    (tmp_path / "arrays.npz").write_bytes(arrays[: len(arrays) // 2])
    with pytest.raises(ReadError, match="files are damaged"):
        load_bundle(tmp_path)
    np.savez(tmp_path / "arrays.npz", other=np.zeros(1))
    with pytest.raises(ReadError, match=r"arrays \['other'\] where"):
        load_bundle(tmp_path)
    (tmp_path / "arrays.npz").write_bytes(arrays)
    (tmp_path / "model.json").write_text(json.dumps({**content, "format": 2}))
    with pytest.raises(ReadError, match="model format 2, this version reads 1"):
        load_bundle(tmp_path)
    (tmp_path / "model.json").write_text("{")
    with pytest.raises(ReadError, match="files are damaged"):
        load_bundle(tmp_path)
    with pytest.raises(ReadError, match="files are damaged"):
        np.savez(tmp_path / "arrays.npz", none=np.array([None]))
        (tmp_path / "model.json").write_text(json.dumps(content))
        load_bundle(tmp_path)
