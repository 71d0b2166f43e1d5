"""Rules of the inventory: defaults, overrides, bounds."""

import pytest

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS, ObjectRule, rules_for_scheme

SCHEME = ClassScheme.from_config(
    "test",
    {
        "classes": {
            "ground": {"members": ["road"], "asprs": 2},
            "lamps": {"members": ["light_pole", "post"], "asprs": 64},
            "cars": {"members": ["car", "bus"], "asprs": 65},
            "green": {"members": ["tree", "hedge"], "asprs": 5},
        }
    },
)


def test_classes_of_one_kind_get_its_rule():
    rules = rules_for_scheme(SCHEME)
    assert {name: (rule.kind, rule.labels) for name, rule in rules.items()} == {
        "lamps": ("pole", (1,)),
        "cars": ("vehicle", (2,)),
    }
    assert rules["lamps"] == ObjectRule.of_kind("pole", 1)


def test_changes_apply_by_kind_and_by_class():
    changes = {"pole": {"min_points": 5, "min_height": 3.0}, "lamps": {"min_points": 7}, "green": {"kind": "tree"}}
    rules = rules_for_scheme(SCHEME, changes=changes)
    assert (rules["lamps"].min_points, rules["lamps"].min_height) == (7, 3.0)
    assert (rules["green"].kind, rules["green"].labels) == ("tree", (3,))
    with pytest.raises(ParameterError, match="rules name 'lamp', neither a kind"):
        rules_for_scheme(SCHEME, changes={"lamp": {}})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tolerance": 0.0}, "tolerance must be a number > 0, got 0.0"),
        ({"resolution": 0.5}, "resolution must be at most tolerance"),
        ({"min_points": "x"}, "min_points must be a number, got 'x'"),
        ({"min_points": 0}, "min_points must be at least 1, got 0"),
        ({"min_height": 9.0, "max_height": 3.0}, "heights must be 0 <= 9.0"),
        ({"min_width": 9.0, "max_width": 3.0}, "widths must be 0 <= 9.0"),
        ({"min_width": -1.0}, "widths must be 0 <= -1.0"),
        ({"vertical_tolerance": 0.01}, "vertical_tolerance .* must not be below tolerance"),
        ({"split_spacing": -1.0}, "split_spacing must be a number > 0 or None, got -1.0"),
        ({"labels": ()}, "needs at least one label"),
        ({"colour": 3}, "no field 'colour'"),
    ],
)
def test_values_outside_their_domain_are_named(kind, change, message):
    with pytest.raises(ParameterError, match=message):
        ObjectRule.of_kind(kind, **{"labels": 1, **change})


def test_unknown_kind():
    with pytest.raises(ParameterError, match=r"kind .*got 'house'"):
        ObjectRule.of_kind("house", 1)
