"""Classifier of scenes unlike the training data, on planted streets."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models import familiarity
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.familiarity import (
    FACTS,
    FAMILIAR,
    KINDS,
    changes,
    facts_of_changes,
    familiarity_of,
    kind_probabilities,
    simulated_rooms,
    trust,
    with_familiarity,
)

NAMES = list(KINDS)


def street(seed):
    """Return a road of 40 m with a wall, poles and boxes."""
    rng = np.random.default_rng(seed)
    road = np.column_stack([rng.uniform(0, 40, 12_000), rng.uniform(0, 16, 12_000), rng.normal(0, 0.01, 12_000)])
    wall = np.column_stack(
        [rng.uniform(0, 40, 6_000), rng.normal(16, 0.01, 6_000), rng.uniform(0, rng.uniform(5, 9), 6_000)]
    )
    poles = [
        np.column_stack([rng.normal(x, 0.05, 200), rng.normal(3, 0.05, 200), rng.uniform(0, 6, 200)])
        for x in (5, 20, 35)
    ]
    boxes = [rng.uniform([x, 6, 0], [x + 4, 7.8, 1.5], (600, 3)) for x in rng.uniform(0, 36, 4)]
    return PointCloud(np.concatenate([road, wall, *poles, *boxes]).astype(np.float32))


@pytest.fixture(scope="module")
def model():
    tables = [facts_of_changes(street(seed), GroundParameters(), seed=1) for seed in range(9)]
    plain = ModelBundle("tests_trees", {"values": np.arange(3.0)}, {"classes": ["a"]})
    return with_familiarity(plain, tables, ["one"] * 9)


def test_changes_have_their_kinds_and_every_kind_occurs():
    table = facts_of_changes(street(3), GroundParameters(), seed=5)
    assert table["values"].shape == (len(table["kinds"]), len(FACTS)) and table["values"].dtype == np.float32
    assert set(table["kinds"].tolist()) == set(range(len(KINDS)))
    again = facts_of_changes(street(3), GroundParameters(), seed=5)
    np.testing.assert_array_equal(again["values"], table["values"])
    assert {kind for kind, _ in changes(np.random.default_rng(0))} == set(KINDS)


def test_changed_copies_are_what_their_kind_says():
    scene = street(0)
    height = scene.xyz[:, 2]
    made = {}
    for kind, change in changes(np.random.default_rng(2)):
        made.setdefault(kind, []).append(change(scene, height))
    assert all(cloud.xyz[:, 2].min() > 0.09 for cloud in made["no ground"])
    assert all(cloud.xyz[:, 2].max() < 1.4 for cloud in made["low"])
    assert all(cloud.xyz[:, 2].min() > 1.4 for cloud in made["no lower part"])
    (above,) = made["from above"]
    cells = np.unique(np.round(above.xyz[:, :2], 1), axis=0)
    assert len(above) < len(scene) / 2 and len(cells) > 0.9 * len(above)
    assert len(made[FAMILIAR]) == 4 and len(made[FAMILIAR][0]) == len(scene)


def test_rooms_have_ceilings():
    rooms = simulated_rooms(np.random.default_rng(4)).xyz
    top = rooms[:, 2].max()
    assert 2.2 < top < 4.2 and np.mean(rooms[:, 2] > top - 0.1) > 0.02


def test_a_new_street_is_familiar_and_changed_ones_are_not(model):
    unseen = street(99)
    usual = kind_probabilities(model, unseen)
    assert usual.sum() == pytest.approx(1.0) and usual[0] > 0.7 and trust(usual) == 1.0
    upside_down = kind_probabilities(model, PointCloud(unseen.xyz * np.float32([1, 1, -1])))
    assert NAMES[upside_down.argmax()] == "turned" and trust(upside_down) < 0.65
    no_ground = kind_probabilities(model, unseen.select(np.flatnonzero(unseen.xyz[:, 2] > 0.3)))
    assert NAMES[no_ground.argmax()] == "no ground" and trust(no_ground) < 0.65


def test_a_street_on_a_hill_is_familiar(model):
    xyz = street(99).xyz
    hill = kind_probabilities(model, PointCloud(xyz + xyz[:, :1] * np.float32([0.0, 0.0, 0.1])))
    assert hill[0] > 0.5


def test_models_without_a_classifier_trust_all_scenes(model):
    plain = ModelBundle("tests_trees", {}, {"classes": ["a"]})
    assert kind_probabilities(plain, street(1)) is None and trust(None) == 1.0
    carried = familiarity_of(model, plain)
    np.testing.assert_array_equal(kind_probabilities(carried, street(1)), kind_probabilities(model, street(1)))
    assert familiarity_of(plain, plain) is plain
    assert kind_probabilities(model, PointCloud(np.zeros((5, 3)))) is None


def test_other_facts_than_those_of_this_version_are_named(model, monkeypatch):
    monkeypatch.setattr(familiarity, "FACTS", FACTS[:-1])
    with pytest.raises(DataError, match="'tests_trees' describes scenes by other facts"):
        kind_probabilities(model, street(1))
