"""Arrays of models with indices that leave their arrays, cycles, NaN and other shapes are refused when they are loaded."""

import numpy as np
import pytest
from helpers.mutations import mutated_arrays

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.array_checks import check_model_arrays
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import label_cloud

GRAPH = {
    **{"table": np.zeros((4, 6), "f4"), "xyz": np.zeros((4, 3), "f4"), "heights": np.zeros(4, "f4")},
    **{
        "scene": np.array([0, 0, 1, 1], "i4"),
        "scene_starts": np.array([0, 2, 4]),
        "cell": np.array([0, 0, 1, 1], "i4"),
    },
    **{"near": np.array([[[0, 2]], [[2, 4]]], "i4"), "far": np.array([[[0, 2]], [[2, 4]]], "i4")},
    **{
        "by_height": np.array([0, 1, 2, 3], "i4"),
        "rows": np.arange(4),
        "matches": np.array([[2], [3], [0], [1]], "i4"),
    },
    **{"centres": np.zeros((2, 6), "f4"), "cell_starts": np.array([0, 2, 4]), "members": np.arange(4, dtype="i4")},
    **{"n_classes": np.array(2), "labels": np.array([0, 1, 0, 1], "i2"), "weights": np.ones(4), "search": np.ones(10)},
}
HOUGH = {
    **{"feature": np.array([1, -1, -1], "i2"), "left": np.array([1, 0, 1], "i4"), "threshold": np.zeros(3, "f4")},
    **{"roots": np.array([0, 3]), "leaf_roots": np.array([0, 2]), "shares": np.full((2, 2), 0.5, "f4")},
    **{"vote_starts": np.array([0, 1, 1, 2, 2]), "votes": np.ones((2, 2), "f4"), "cells": np.array([0.5, 0.5])},
}
MARKOV = {
    **{"sites_roots": np.array([0, 3]), "sites_column": np.array([2, -1, -1], "i2"), "sites_threshold": np.zeros(3)},
    **{"sites_child": np.array([[1, 2], [-1, -1], [-1, -1]], "i4"), "sites_value": np.zeros((3, 2), "f4")},
}
MACHINE = {
    **{"vectors": np.ones((3, 5), "f4"), "n_vectors": np.array([1, 2]), "coefficients": np.ones((1, 3), "f4")},
    **{
        "intercepts": np.ones(1, "f4"),
        "sigmoids": np.ones((1, 2)),
        "shift": np.zeros(5, "f4"),
        "scale": np.ones(5, "f4"),
    },
    "gamma": np.array(0.5),
}
WORDS = {
    **{"queries.0.indices": np.array([0, 2]), "queries.0.indptr": np.array([0, 1, 2]), "queries.0.data": np.ones(2)},
    "inverse_frequency": np.ones(3),
}
PARTS = {"kinds": np.array([0, 1], "i2"), "objects": np.array([0, 0, 1], "i4"), "thresholds": np.ones(2)}
MODELS = {"graph": GRAPH, "hough": HOUGH, "markov": MARKOV, "machine": MACHINE, "words": WORDS, "parts": PARTS}


@pytest.mark.parametrize("prefix", ["", "geometry+rgb.", "member/geometry."])
@pytest.mark.parametrize("name", MODELS)
def test_sound_models_pass(name, prefix):
    check_model_arrays({prefix + key: values for key, values in MODELS[name].items()})


@pytest.mark.parametrize(
    ("name", "array", "place", "value", "message"),
    [
        ("graph", "matches", (0, 0), 4, "has indices outside 0 to 3"),
        ("graph", "near", (0, 0, 1), 2**31 - 1, "has indices outside 0 to 4"),
        ("graph", "cell", 0, -1, "has indices outside 0 to 1"),
        ("graph", "scene_starts", 1, 9, "does not ascend from 0 to 4"),
        ("graph", "weights", 0, np.nan, "holds NaN or infinity"),
        ("graph", "search", 0, 1e300, "is not within 0 to 1e\\+09"),
        ("graph", "labels", 0, 2, "has indices outside 0 to 1"),
        ("hough", "left", 0, 2, "points outside its tree"),
        ("hough", "left", 0, 0, "points outside its tree"),
        ("hough", "left", 1, 2, "points outside its tree"),
        ("hough", "vote_starts", 2, 7, "does not ascend from 0 to 2"),
        ("hough", "cells", 0, 1e-9, "has cells below 1 mm"),
        ("hough", "votes", (0, 0), 1e30, "has votes farther than 1 km"),
        ("markov", "sites_child", (0, 0), 0, "points outside its tree"),
        ("markov", "sites_child", (0, 1), 2**31 - 1, "has indices outside -1 to 2"),
        ("machine", "n_vectors", 0, 3, "does not add up to 3"),
        ("machine", "scale", 0, 0, "is not positive"),
        ("words", "queries.0.indices", 0, 3, "has indices outside 0 to 2"),
        ("words", "queries.0.indptr", 1, 5, "does not ascend from 0 to 2"),
        ("parts", "objects", 0, 2, "has indices outside 0 to 1"),
    ],
)
def test_damage_names_the_array(name, array, place, value, message):
    arrays = {key: values.copy() for key, values in MODELS[name].items()}
    arrays[array][place] = value
    with pytest.raises(DataError, match=f"the model is damaged: array '{array}' {message}"):
        check_model_arrays(arrays)


@pytest.mark.parametrize("name", MODELS)
def test_mutations_pass_or_are_refused(name):
    refused = 0
    for case in range(500):
        rng = np.random.default_rng(case)
        try:
            check_model_arrays(mutated_arrays(MODELS[name], rng))
        except DataError as error:
            assert "damaged" in str(error) and len(str(error).splitlines()) == 1
            refused += 1
    assert refused > 225


def test_arrays_that_a_method_cannot_use_are_one_line():
    cloud = PointCloud(np.zeros((3, 3)), source="a.laz")
    bundle = ModelBundle("toy", {}, {"classes": ["a"]})

    def fails(*_):
        return np.zeros((3, 2)) @ np.zeros((3, 1))

    with pytest.raises(
        DataError, match=r"a\.laz: model 'toy' fails with ValueError: matmul.*do not fit its method"
    ) as caught:
        label_cloud(bundle, cloud, labeller=fails)
    assert len(str(caught.value).splitlines()) == 1
