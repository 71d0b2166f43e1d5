"""Candidates that decisions are about, and what each decision says about them."""

import pandas as pd
import pytest
from helpers.labelled import scheme

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.inventory.objects.candidate_table import candidate_rules
from mlsroad_pipeline.review.corrections.answers import NamedClasses
from mlsroad_pipeline.review.corrections.decisions import Correction, Decision
from mlsroad_pipeline.review.corrections.object_answers import (
    NOTHING,
    DecidedObject,
    added_candidates,
    answered_candidates,
    decided_objects,
)


@pytest.fixture(scope="module")
def named():
    schemes = {name: scheme(name) for name in ("common", "road_inventory", "asprs")}
    return NamedClasses(ClassScheme.from_config("road_inventory", schemes["road_inventory"]), schemes)


@pytest.fixture
def candidates():
    """Object 1 as pole and as sign, object 2 as tree, and a pole that is no object of the inventory."""
    rows = [
        ("pole", 0.0, 0.0, 100, "pole", 1, 1, 95),
        ("sign", 0.1, 0.0, 100, "pole", 1, 1, 95),
        ("tree", 9.0, 0.0, 900, "tree", 1, 2, 880),
        ("pole", 5.0, 0.0, 40, "pole", 2, 0, 40),
        ("pole", 9.0, 0.2, 30, "pole", 3, 2, 30),
    ]
    return pd.DataFrame(rows, columns=["kind", "x", "y", "point_count", "own_kind", "part", "instance", "shared"])


@pytest.mark.parametrize(
    ("state", "right"),
    [
        ({"status": "accepted", "checked_class": "pole", "checked_kind": "pole"}, "pole"),
        ({"status": "moved", "checked_class": "pole", "checked_kind": "pole"}, "pole"),
        ({"status": "rejected", "checked_class": "", "checked_kind": "pole"}, None),
        ({"status": "rejected", "checked_class": "building", "checked_kind": "pole"}, NOTHING),
        ({"status": "changed", "checked_class": "sign", "checked_kind": "sign"}, "sign"),
        ({"status": "changed", "checked_class": "tree", "checked_kind": "pole"}, "tree"),
        ({"status": "changed", "checked_class": "vegetation", "checked_kind": "tree"}, "tree"),
        ({"status": "changed", "checked_class": "wall or fence", "checked_kind": "pole"}, NOTHING),
    ],
)
def test_decisions_say_which_kind_an_object_is(named, state, right):
    rules = candidate_rules(named.scheme, {})
    assert decided_objects({7: state}, {7: "pole"}, named, rules) == {7: DecidedObject("pole", right)}


def test_parts_of_objects_say_nothing(named):
    rules = candidate_rules(named.scheme, {})
    states = {
        1: {"status": "split", "checked_class": "pole", "checked_kind": "pole"},
        2: {"status": "merged", "checked_class": "pole", "checked_kind": "pole"},
        3: {"status": "merged", "checked_class": "pole", "checked_kind": "pole", "merged_into": 2},
    }
    assert decided_objects(states, dict.fromkeys(states, "pole"), named, rules) == {}


@pytest.mark.parametrize(
    ("decision", "told"),
    [
        (DecidedObject("pole", "pole"), {0: True, 1: False}),
        (DecidedObject("pole", "sign"), {0: False, 1: True}),
        (DecidedObject("pole", NOTHING), {0: False, 1: False}),
        (DecidedObject("pole", None), {0: False}),
    ],
)
def test_alternatives_of_an_object_are_answered_too(candidates, decision, told):
    assert dict(answered_candidates(candidates, {1: decision}, {1: 100})) == told


def test_a_candidate_of_few_points_of_an_object_is_not_it(candidates):
    decided = {2: DecidedObject("tree", "tree")}
    assert dict(answered_candidates(candidates, decided, {2: 900})) == {2: True}  # not the pole of 30 points
    assert dict(answered_candidates(candidates, decided, {2: 5000})) == {}


def test_added_objects_are_the_nearest_candidates_of_their_kind(candidates):
    def added(x, kind):
        return Decision(1, "", "", Correction("add", kind=kind, payload={"x": x, "y": 0.0, "z": 0.0}), {})

    assert list(added_candidates(candidates, [added(5.3, "pole"), added(5.0, "sign"), added(7.0, "pole")])) == [
        (3, True)
    ]
    assert list(added_candidates(candidates.iloc[:0], [added(5.0, "pole")])) == []
