"""QGIS styles: well-formed, with the right symbols, and with expressions over existing fields."""

import re
import sqlite3
from contextlib import closing
from xml.etree import ElementTree

import pytest

from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_LAYERS
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.algorithms.inventory.objects.table import FIELDS
from mlsroad_pipeline.inventory_files.qgis_styles import COLOURS, LAYERS, qml
from mlsroad_pipeline.inventory_files.road_inventory import fields_of_layer

SYMBOLS = {
    "vehicles": "fill",
    "footprints": "fill",
    "trajectory": "line",
    "sections": "line",
    **dict.fromkeys(LINE_LAYERS, "line"),
}


@pytest.mark.parametrize("layer", LAYERS)
def test_style_of_a_layer(layer):
    text = qml(layer)
    assert text.startswith("<!DOCTYPE qgis")
    root = ElementTree.fromstring(text)
    assert {symbol.get("type") for symbol in root.iter("symbol")} == {SYMBOLS.get(layer, "marker")}
    expressions = [option.get("value") for option in root.iter("Option") if option.get("name") == "expression"]
    expressions += [style.get("fieldName") for style in root.iter("text-style")]
    named = {name for expression in expressions for name in re.findall(r'"(\w+)"', expression)}
    assert named <= set(FIELDS)
    assert (root.get("labelsEnabled") == "1") == (root.find("labeling") is not None)
    if layer not in ("trajectory", "sections"):
        assert {alias.get("field"): alias.get("name") for alias in root.iter("alias")} == {
            name: field.alias for name, field in fields_of_layer(layer).items()
        }


@pytest.mark.parametrize("layer", LAYERS)
def test_every_rule_has_a_symbol_and_a_line_in_the_legend(layer):
    renderer = ElementTree.fromstring(qml(layer)).find("renderer-v2")
    rules = list(renderer.iter("rule"))
    assert [rule.get("symbol") for rule in rules] == [symbol.get("name") for symbol in renderer.iter("symbol")]
    assert all(rule.get("label") for rule in rules)
    assert len({rule.get("key") for rule in rules}) == len(rules)
    named = {name for rule in rules for name in re.findall(r'"(\w+)"', rule.get("filter", ""))}
    assert named <= set(FIELDS)


def test_objects_are_told_apart_by_their_kind():
    rules = ElementTree.fromstring(qml("objects")).iter("rule")
    assert [rule.get("filter") for rule in rules] == [f"\"kind\" = '{kind}'" for kind in COLOURS]
    assert set(COLOURS) == set(KINDS)


@pytest.mark.parametrize("scaled", [True, False])
def test_labels_wait_for_a_scale_where_there_is_one(scaled):
    rendering = ElementTree.fromstring(qml("poles", scaled=scaled)).find("labeling/settings/rendering")
    assert rendering.get("scaleVisibility") == str(int(scaled))


def test_every_sign_has_one_symbol_whatever_is_known_of_its_front():
    rules = [rule.get("filter") for rule in ElementTree.fromstring(qml("signs")).iter("rule")]
    with closing(sqlite3.connect(":memory:")) as base:  # the filters are SQL expressions too
        base.execute("CREATE TABLE signs (facing_from TEXT)")
        base.executemany("INSERT INTO signs VALUES (?)", [("post",), ("pole",), ("unknown",), (None,)])
        drawn = [base.execute(f"SELECT facing_from FROM signs WHERE {rule}").fetchall() for rule in rules]
    assert drawn == [[("post",), ("pole",)], [("unknown",)], [(None,)]]


def test_symbols_that_are_not_drawn_can_be_ticked():
    states = [rule.get("checkstate") for rule in ElementTree.fromstring(qml("objects", drawn=False)).iter("rule")]
    assert states == ["0"] * len(KINDS)
    assert "checkstate" not in qml("objects")
