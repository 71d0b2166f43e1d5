"""Styles: well-formed, of the right symbols, and with expressions over fields that are there."""

import re
from xml.etree import ElementTree

import pytest

from mlsroad_pipeline.algorithms.inventory_table import FIELDS
from mlsroad_pipeline.algorithms.object_rules import KINDS
from mlsroad_pipeline.datasets.qgis_styles import COLOURS, LAYERS, qml

SYMBOLS = {"vehicles": "fill", "footprints": "fill", "trajectory": "line"}


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
    if layer != "trajectory":
        assert {alias.get("field"): alias.get("name") for alias in root.iter("alias")} == {
            name: field.alias for name, field in FIELDS.items()
        }


def test_objects_are_told_apart_by_their_kind():
    renderer = ElementTree.fromstring(qml("objects")).find("renderer-v2")
    assert renderer.get("attr") == "kind"
    assert {category.get("value") for category in renderer.iter("category")} == set(KINDS) == set(COLOURS)
