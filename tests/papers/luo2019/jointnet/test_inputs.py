"""Outliers of objects, and the regression on the measures."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mlsroad_pipeline.papers.luo2019.jointnet.inputs import isolated_points
from mlsroad_pipeline.papers.luo2019.jointnet.network import train_regression
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import JointNetParameters, TrainingParameters
from mlsroad_pipeline.papers.luo2019.jointnet.recogniser import JointNetRecogniser, _points


def dense(rng, n):
    """A pole whose points are some centimetres apart."""
    return np.column_stack([rng.normal(0, 0.02, n), rng.normal(0, 0.02, n), np.linspace(0, 3, n)])


def test_stray_points_are_isolated_and_objects_do_not_touch_each_other(rng):
    stray = rng.uniform(-2, 2, (12, 3)) + [[4, 0, 0]]
    objects = [dense(rng, 200), np.concatenate([dense(rng, 150), stray]), dense(rng, 5)]  # all at the same place
    xyz, indptr = np.concatenate(objects), np.cumsum([0, *map(len, objects)])
    alone = isolated_points(xyz, indptr, factor=3.0, least=8)
    assert alone[350:362].sum() >= 10 and alone[:350].sum() <= 3 and not alone[362:].any()
    single = isolated_points(objects[1], np.array([0, 162]), factor=3.0, least=8)
    assert np.array_equal(single, alone[200:362])


def test_isolated_points_have_several_times_the_spacing_of_the_others(rng):
    xyz = rng.normal(size=(300, 3)) + [400_000.0, 5_800_000.0, 30.0]
    spacing = cKDTree(xyz).query(xyz, k=5)[0][:, 1:].mean(axis=1)
    alone = isolated_points(xyz, np.array([0, 300]), factor=3.0, least=8)
    far = spacing > 3.0 * np.median(spacing)
    assert far.any() and alone[far].all() and not alone[spacing < np.median(spacing)].any()


def test_later_passes_give_what_a_full_search_gives(rng):
    """Reference: neighbours of all remaining points, searched anew in each pass."""
    removed = []
    for _ in range(20):
        xyz = rng.standard_t(2, (120, 3))  # sparser and sparser outwards
        keep, passes = np.ones(len(xyz), dtype=bool), 0
        for _ in range(3):
            rest = xyz[keep]
            spacing = np.sort(np.linalg.norm(rest[:, None] - rest, axis=2), axis=1)[:, 1:5].mean(axis=1)
            alone = spacing > 2.5 * np.median(spacing)
            if not alone.any() or len(rest) - alone.sum() < 0.5 * len(xyz):
                break
            keep[np.flatnonzero(keep)[alone]] = False
            passes += 1
        removed.append(passes)
        assert np.array_equal(isolated_points(xyz, np.array([0, len(xyz)]), factor=2.5, least=8), ~keep)
    assert max(removed) > 1


def test_an_object_keeps_half_of_its_points(rng):
    close, wide = rng.normal(0, 0.01, (40, 3)), rng.uniform(-5, 5, (60, 3))
    alone = isolated_points(np.concatenate([close, wide]), np.array([0, 100]), factor=1.01, least=8)
    assert alone.sum() <= 50


def test_the_regression_counts_beside_the_networks_and_is_stored(rng):
    objects = [dense(rng, 60) * ([1, 1, 1] if k % 2 else [40, 40, 0.1]) for k in range(20)]
    classes = np.array(["plate", "pole"])[np.arange(20) % 2]
    parameters = JointNetParameters(training=TrainingParameters(epochs=1, n_members=1, n_turns=1, regression_copies=1))
    fitted = JointNetRecogniser(parameters).fit(objects, classes)
    assert (fitted.predict(objects) == classes).all()  # after one epoch the regression decides this
    arrays = fitted.to_arrays()
    again = JointNetRecogniser.from_arrays(arrays, parameters)
    assert np.array_equal(again.predict_proba(objects), fitted.predict_proba(objects))
    bare = {name: value for name, value in arrays.items() if not name.startswith("machine/")}
    older = JointNetRecogniser.from_arrays(bare, parameters)  # a model of an earlier version
    assert older.regression_ is None and older.predict_proba(objects).sum(axis=1) == pytest.approx(np.ones(20))
    none = JointNetParameters(training=TrainingParameters(regression_share=0.0))
    assert train_regression(_points(objects, None), np.arange(20) % 2, none) is None
