"""Pool of trained labellers with one weight each."""

import dataclasses

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import SoftLabels, label_cloud, label_softly
from mlsroad_pipeline.algorithms.models.pool import labeller as pool
from mlsroad_pipeline.algorithms.models.pool.labeller import FLOOR, NETWORK, TREES, members_of, pool_bundle, with_trees

HALVES, THIRDS = "tests_halves", "tests_thirds"


def member(slug, classes=("a", "b", "c"), **metadata):
    metadata = {"classes": list(classes), "attributes": ["intensity"], **metadata}
    return ModelBundle(slug, {"values": np.arange(3.0)}, metadata)


@pytest.fixture
def cloud():
    return PointCloud(np.arange(18, dtype=np.float32).reshape(6, 3))


@pytest.fixture
def planted(monkeypatch):
    """Two members with voxels of their own: rows of probabilities, and the row of each point."""
    tables = {
        HALVES: (np.array([[0.6, 0.3, 0.1], [0.0, 0.5, 0.5]]), np.array([0, 0, 0, 1, 1, -1])),
        THIRDS: (np.array([[0.2, 0.7, 0.1], [0.9, 0.1, 0.0], [0.1, 0.1, 0.8]]), np.array([0, 0, 1, 1, 2, 2])),
    }

    def softly(bundle, cloud):
        probabilities, owner = tables[bundle.slug]
        best = np.where(owner < 0, -1, probabilities[owner].argmax(axis=1)).astype(np.int16)
        return SoftLabels(best, np.ones(len(cloud), np.float32), probabilities.astype(np.float32), owner)

    monkeypatch.setattr(pool, "label_softly", softly)
    return tables


def test_probabilities_are_weighted_products(cloud, planted):
    bundle = pool_bundle({"one": member(HALVES), "two": member(THIRDS)}, {"one": 0.7, "two": 0.3})
    soft = label_softly(bundle, cloud)
    assert soft.owner.tolist()[-1] == -1 and soft.labels[-1] == -1  # one member does not label this point
    assert len(soft.probabilities) == 4  # combinations of both that have points
    for point in range(5):
        parts = [np.maximum(table[owner[point]], FLOOR) for table, owner in planted.values()]
        wanted = parts[0] ** 0.7 * parts[1] ** 0.3
        np.testing.assert_allclose(soft.probabilities[soft.owner[point]], wanted / wanted.sum(), rtol=1e-5)
    assert soft.labels[:5].tolist() == [soft.probabilities[row].argmax() for row in soft.owner[:5]]
    labels, confidence = label_cloud(bundle, cloud)
    np.testing.assert_array_equal(labels, soft.labels)
    assert confidence[-1] == 0 and (confidence[:5] > 1 / 3).all()


def test_the_weight_of_one_member_alone_gives_its_labels(cloud, planted):
    bundle = pool_bundle({"one": member(HALVES), "two": member(THIRDS)}, {"one": 0.0, "two": 1.0})
    table, owner = planted[THIRDS]
    assert label_softly(bundle, cloud).labels[:5].tolist() == table[owner[:5]].argmax(axis=1).tolist()


def test_members_come_back_as_they_were():
    first = member(HALVES, scheme={"name": "own"}, training_facts={"density": [1.0, 2.0]})
    bundle = pool_bundle({"one": first, "two": member(THIRDS)}, {"one": 0.5, "two": 0.5})
    found = members_of(bundle)
    assert list(found) == ["one", "two"] and found["one"].slug == HALVES
    np.testing.assert_array_equal(found["two"].arrays["values"], np.arange(3.0))
    assert dict(found["one"].metadata) == dict(first.metadata)
    assert bundle.metadata["training_facts"] == {"density": [1.0, 2.0]}


def scheme(name, **members):
    config = {"classes": {c: {"members": taxa, "asprs": 1} for c, taxa in members.items()}, "ignore": ["outlier"]}
    return dataclasses.asdict(ClassScheme.from_config(name, config))


GROUND, PLANTS = ["road", "sidewalk"], ["tree", "hedge"]
COARSE = scheme("coarse", ground=GROUND, plant=PLANTS)
FINE = scheme("fine", hedge=["hedge"], ground=GROUND, tree=["tree"])


def test_probabilities_of_finer_classes_are_summed(cloud, planted):
    planted[HALVES] = (np.array([[0.6, 0.4], [0.1, 0.9]]), np.array([0, 0, 0, 1, 1, -1]))
    trees = member(HALVES, ("ground", "plant"), scheme=COARSE)
    network = member(THIRDS, ("hedge", "ground", "tree"), scheme=FINE)
    soft = label_softly(pool_bundle({"one": trees, "two": network}, {"one": 0.5, "two": 0.5}), cloud)
    table, owner = planted[THIRDS]
    for point in range(5):
        hedge, ground, tree = table[owner[point]]
        wanted = np.sqrt(planted[HALVES][0][planted[HALVES][1][point]] * [ground, hedge + tree])
        np.testing.assert_allclose(soft.probabilities[soft.owner[point]], wanted / wanted.sum(), rtol=1e-5)
    assert soft.labels[-1] == -1
    with pytest.raises(ParameterError, match="'two' has other classes than the first member: class 'plant'"):
        pool_bundle({"one": network, "two": trees}, {"one": 0.5, "two": 0.5})
    ignoring = {**COARSE, "ignored": [*COARSE["ignored"], "hedge"], "members": [GROUND, ["tree"]]}
    with pytest.raises(ParameterError, match="'two' has classes that the first member ignores"):
        pool_bundle({"one": member(HALVES, ("ground", "plant"), scheme=ignoring), "two": network}, {"one": 1, "two": 0})


def test_merged_classes_of_another_member_are_an_error(cloud, planted):
    planted[HALVES] = (np.array([[0.6, 0.4]]), np.zeros(6, int))
    trees = member(HALVES, ("ground", "plant"), scheme=COARSE)
    network = member(THIRDS, ("hedge", "ground", "tree"), scheme=FINE)
    bundle = pool_bundle({"one": trees, "two": network}, {"one": 0.5, "two": 0.5})
    bundle.metadata["merged"]["two"].pop()
    with pytest.raises(DataError, match="2 merged classes for 3 of the member"):
        label_softly(bundle, cloud)


def test_other_trees_keep_network_and_weights():
    bundle = pool_bundle({TREES: member(HALVES), NETWORK: member(THIRDS)}, {TREES: 0.7, NETWORK: 0.3})
    changed = with_trees(bundle, member(HALVES, trained_on={"survey": "own"}))
    assert list(members_of(changed)) == [TREES, NETWORK] and members_of(changed)[NETWORK].slug == THIRDS
    assert changed.metadata["weights"] == {TREES: 0.7, NETWORK: 0.3}
    assert changed.metadata["trained_on"] == {"survey": "own"}
    arrays, told = {**bundle.arrays, "familiarity/leaf": np.ones(2)}, {**bundle.metadata, "familiarity": {"kinds": []}}
    carried = with_trees(dataclasses.replace(bundle, arrays=arrays, metadata=told), member(HALVES))
    assert carried.metadata["familiarity"] == {"kinds": []} and "familiarity/leaf" in carried.arrays


def test_members_that_do_not_fit_are_refused(cloud, planted):
    one, other = member(HALVES), member(THIRDS, classes=("a", "b", "d"))
    with pytest.raises(ParameterError, match="'two' has other classes"):
        pool_bundle({"one": one, "two": other}, {"one": 0.5, "two": 0.5})
    for weights in ({"one": 0.5, "two": 0.6}, {"one": 1.0}, {"one": 1.5, "two": -0.5}):
        with pytest.raises(ParameterError, match="must be from 0 to 1 with the sum 1"):
            pool_bundle({"one": one, "two": member(THIRDS)}, weights)
    bundle = pool_bundle({"one": one, "two": member(THIRDS)}, {"one": 0.5, "two": 0.5})
    damaged = ModelBundle(bundle.slug, bundle.arrays, {**bundle.metadata, "weights": {"one": 1.0}})
    with pytest.raises(DataError, match="members and weights do not agree"):
        label_softly(damaged, cloud)
