"""A damaged object classifier ends in one line, or gives probabilities."""

import io
import os

import numpy as np
import pytest
from helpers.mutations import mutated, mutated_arrays

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import ObjectClassifier
from mlsroad_pipeline.model_store import object_classifiers
from mlsroad_pipeline.model_store.object_classifiers import CLASSIFIER, FOLDER, shipped_classifier

N_CASES = int(os.environ.get("MLSROAD_FUZZ", "20"))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(object_classifiers, "FOLDER", tmp_path)
    yield tmp_path
    shipped_classifier.cache_clear()


@pytest.fixture(scope="module")
def arrays():
    with np.load(FOLDER / CLASSIFIER) as stored:
        return dict(stored)


def test_damaged_files_are_one_line(folder):
    sound = (FOLDER / CLASSIFIER).read_bytes()
    for case in range(N_CASES):
        (folder / CLASSIFIER).write_bytes(mutated(sound, np.random.default_rng(case)))
        shipped_classifier.cache_clear()
        try:
            shipped_classifier()
        except ReadError as error:
            text = str(error)
            assert (
                str(folder / CLASSIFIER) in text and text.isprintable() and text.endswith("install the package again")
            )


def test_damaged_arrays_are_refused_before_they_are_used(folder, arrays):
    refused = 0
    for case in range(2 * N_CASES):
        changed = mutated_arrays(
            {name: values for name, values in arrays.items() if name != "questions"}, np.random.default_rng(case)
        )
        content = io.BytesIO()
        np.savez(content, questions=arrays["questions"], **changed)
        (folder / CLASSIFIER).write_bytes(content.getvalue())
        shipped_classifier.cache_clear()
        try:
            classifier = shipped_classifier()
        except ReadError:
            refused += 1
            continue
        shares = classifier.probabilities("pole", np.zeros((2, len(classifier.features["pole"])), dtype=np.float32))
        assert np.isfinite(shares).all() and shares.min() >= 0 and shares.max() <= 1
    assert refused > N_CASES


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("pole/calibration", np.array([1.0, 1e300]), "array 'pole/calibration' has other values"),
        ("sign/typical", np.zeros(3, np.float32), "array 'sign/typical' has other values"),
        ("tree/features", np.array(["a"]), "array 'tree/features' has other values"),
        ("pole/left", np.zeros(1400, np.float32), "array left of boosted trees is float32"),
        ("stem/n_features", np.array([67]), r"array n_features of boosted trees is int64 \(1,\)"),
        ("stem/leaf", np.full(2849, np.nan, np.float32), "array 'stem/leaf' holds NaN"),
    ],
)
def test_damage_names_the_array(arrays, name, values, message):
    with pytest.raises(DataError, match=message):
        ObjectClassifier.from_arrays({**arrays, name: values})
