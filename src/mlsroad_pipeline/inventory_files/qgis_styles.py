"""QGIS 3 styles (QML) of the inventory layers."""

from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as XML

from mlsroad_pipeline.algorithms.core import palette
from mlsroad_pipeline.algorithms.core.palette import hex_to_rgb
from mlsroad_pipeline.inventory_files.road_inventory import fields_of_layer


def _channels(colour: str) -> str:
    return ",".join(map(str, hex_to_rgb(colour)))


COLOURS = {kind: _channels(colour) for kind, colour in palette.KIND_COLOURS.items()}
"""Kind of object to colour (red, green, blue)."""

LINE_COLOURS = {kind: _channels(colour) for kind, colour in palette.LINE_COLOURS.items()}
"""Kind of line to colour."""

_LABEL_SCALE = 1500  # labels are drawn at this scale and larger
_BESIDE, _OVER = "6", "1"  # QGIS codes of label placement: around a point, over the centre of an area

Properties = Mapping[str, str]


def _option(parent: XML.Element, name: str, value: str = "", kind: str = "QString") -> XML.Element:
    attributes = {"name": name, "type": kind} | ({} if kind == "Map" else {"value": value})
    return XML.SubElement(parent, "Option", attributes)


def _symbol_layer(parent: XML.Element, class_name: str, properties: Properties, expressions: Properties) -> None:
    """Add a symbol layer; every version of QGIS 3 reads its properties from `prop` elements."""
    layer = XML.SubElement(parent, "layer", {"class": class_name, "enabled": "1", "pass": "0", "locked": "0"})
    for key, value in properties.items():
        XML.SubElement(layer, "prop", k=key, v=value)
    bound = XML.SubElement(XML.SubElement(layer, "data_defined_properties"), "Option", type="Map")
    _option(bound, "name")
    entries = _option(bound, "properties", kind="Map")
    for key, expression in expressions.items():
        entry = _option(entries, key, kind="Map")
        _option(entry, "active", "true", "bool")
        _option(entry, "expression", expression)
        _option(entry, "type", "3", "int")
    _option(bound, "type", "collection")


def _symbol(parent: XML.Element, kind: str, name: str, layers: Sequence[tuple[str, Properties, Properties]]) -> None:
    symbol = XML.SubElement(
        parent, "symbol", {"type": kind, "name": name, "alpha": "1", "clip_to_extent": "1", "force_rhr": "0"}
    )
    for class_name, properties, expressions in layers:
        _symbol_layer(symbol, class_name, properties, expressions)


def _marker(shape: str, colour: str, size: float, *, unit: str = "MM", outline: str = "255,255,255,255") -> Properties:
    return {
        "name": shape, "color": f"{colour},255" if colour.count(",") == 2 else colour, "size": f"{size:g}",
        "size_unit": unit, "outline_color": outline, "outline_width": "0.2", "outline_width_unit": "MM",
        "outline_style": "solid", "angle": "0", "scale_method": "diameter", "vertical_anchor_point": "1",
        "horizontal_anchor_point": "1",
    }  # fmt: skip


def _fill(colour: str, outline: str, width: float, *, style: str = "solid") -> Properties:
    return {
        "color": colour, "style": style, "outline_color": outline, "outline_width": f"{width:g}",
        "outline_width_unit": "MM", "outline_style": "solid", "joinstyle": "miter",
    }  # fmt: skip


_Symbols = Sequence[tuple[str, Properties, Properties]]

_LEANS = 'coalesce("tilt", 0) >= 1 and "lean_azimuth" is not null'
_FRONT_KNOWN = "\"facing_from\" in ('post', 'pole')"
_FRONT_UNKNOWN = "\"facing_from\" = 'unknown'"
_NO_PANEL = '"facing_from" is null'  # neither of the other two holds for NULL

_POLE: _Symbols = (("SimpleMarker", _marker("circle", COLOURS["pole"], 2.2), {}),)
_ARROW = {**_marker("arrow", "230,120,0", 6.0), "vertical_anchor_point": "2"}
_LEAN: _Symbols = (("SimpleMarker", _ARROW, {"angle": 'coalesce("lean_azimuth", 0)'}),)
_FACING = {"angle": 'coalesce("facing", 0)'}
_SIGN: _Symbols = (("SimpleMarker", _marker("triangle", COLOURS["sign"], 3.2), _FACING),)
_BAR = {**_marker("line", COLOURS["sign"], 3.2, outline=f"{COLOURS['sign']},255"), "outline_width": "0.8"}
_BOARD: _Symbols = (("SimpleMarker", _BAR, {"angle": 'coalesce("facing", 0) + 90'}),)
_NO_FACE: _Symbols = (("SimpleMarker", _marker("diamond", COLOURS["sign"], 3.2), {}),)
_CROWN = _marker("circle", f"{COLOURS['tree']},90", 3.0, unit="MapUnit", outline=f"{COLOURS['tree']},255")
_TREE: _Symbols = (
    ("SimpleMarker", _CROWN, {"size": 'coalesce("crown_diameter", "width")'}),
    ("SimpleMarker", _marker("circle", "110,75,40", 1.2), {}),
)
_VEHICLE: _Symbols = (("SimpleFill", _fill(f"{COLOURS['vehicle']},120", f"{COLOURS['vehicle']},255", 0.3), {}),)
_FOOTPRINT: _Symbols = (("SimpleFill", _fill("0,0,0,0", "90,90,90,255", 0.2, style="no"), {}),)


def _line(colour: str, width: str = "0.4", *, style: str = "solid", cap: str = "round") -> _Symbols:
    symbol = {
        "line_color": colour if colour.count(",") == 3 else f"{colour},255", "line_width": width,
        "line_width_unit": "MM", "line_style": style, "capstyle": cap, "joinstyle": "round",
    }  # fmt: skip
    return (("SimpleLine", symbol, {}),)


_ALL = ""  # a filter that passes all objects

_RULES: dict[str, tuple[str, Sequence[tuple[str, str, _Symbols]]]] = {
    "objects": (
        "marker",
        [
            (f"{kind}s", f"\"kind\" = '{kind}'", (("SimpleMarker", _marker("circle", colour, 2.4), {}),))
            for kind, colour in COLOURS.items()
        ],
    ),
    "poles": ("marker", [("pole", _ALL, _POLE), ("leans by 1° or more, to there", _LEANS, _LEAN)]),
    "signs": (
        "marker",
        [
            ("sign, faces where it points", _FRONT_KNOWN, _SIGN),
            ("sign, front not known", _FRONT_UNKNOWN, _BOARD),
            ("sign, panel not measured", _NO_PANEL, _NO_FACE),
        ],
    ),
    "trees": ("marker", [("tree, as wide as its crown", _ALL, _TREE)]),
    "vehicles": ("fill", [("vehicle, its box", _ALL, _VEHICLE)]),
    "footprints": ("fill", [("outline of what was seen", _ALL, _FOOTPRINT)]),
    "kerbs": ("line", [("foot of a kerb", _ALL, _line(LINE_COLOURS["kerb"]))]),
    "wires": ("line", [("overhead wire", _ALL, _line(LINE_COLOURS["wire"]))]),
    "barriers": ("line", [("foot of a wall, fence or guard rail", _ALL, _line(LINE_COLOURS["barrier"]))]),
    "lane_lines": ("line", [("lane or edge line", _ALL, _line(LINE_COLOURS["lane_line"]))]),
    "stop_lines": ("line", [("stop line", _ALL, _line(LINE_COLOURS["stop_line"]))]),
    "crossings": ("line", [("crossing, along its middle", _ALL, _line(LINE_COLOURS["crossing"]))]),
    "other_markings": ("line", [("other marking", _ALL, _line(LINE_COLOURS["other_marking"]))]),
    "trajectory": ("line", [("path of the scanner", _ALL, _line("130,60,160", "0.5", style="dash"))]),
    "sections": ("line", [("section of the road", _ALL, _line("60,60,60,160", "1.6", cap="flat"))]),
}
"""Layer to the symbol type and the rules (legend text, filter, symbol)."""

_LABELS = {
    "poles": """format_number("height", 1) || ' m' || if("tilt" >= 1, '\n' || format_number("tilt", 1) || '°', '')""",
    "signs": """coalesce(format_number("panel_bottom", 1) || ' m', '')""",
    "trees": """format_number("height", 1) || ' m'""",
    "vehicles": """format_number("length", 1) || ' × ' || format_number("width", 1) || ' m'""",
}

LAYERS = tuple(_RULES)
"""Layers with a style."""


def _renderer(root: XML.Element, layer: str, *, drawn: bool) -> None:
    """Add the rules; each rule has a legend entry, ticked if it is drawn."""
    kind, legend = _RULES[layer]
    renderer = XML.SubElement(
        root, "renderer-v2", {"type": "RuleRenderer", "symbollevels": "0", "enableorderby": "0", "forceraster": "0"}
    )
    rules = XML.SubElement(renderer, "rules", key=f"{{{layer}}}")
    symbols = XML.SubElement(renderer, "symbols")
    for number, (text, condition, symbol) in enumerate(legend):
        rule = {"key": f"{{{layer}-{number}}}", "symbol": str(number), "label": text}
        rule |= ({"filter": condition} if condition else {}) | ({} if drawn else {"checkstate": "0"})
        XML.SubElement(rules, "rule", rule)
        _symbol(symbols, kind, str(number), symbol)


def _labels(root: XML.Element, layer: str, *, scaled: bool) -> None:
    labeling = XML.SubElement(root, "labeling", type="simple")
    settings = XML.SubElement(labeling, "settings", calloutType="simple")
    style = XML.SubElement(
        settings, "text-style",
        {"fieldName": _LABELS[layer], "isExpression": "1", "fontFamily": "Sans", "fontSize": "7",
         "fontSizeUnit": "Point", "textColor": "40,40,40,255", "textOpacity": "1", "namedStyle": "Regular",
         "multilineHeight": "1"},
    )  # fmt: skip
    buffer = {"bufferDraw": "1", "bufferSize": "0.7", "bufferSizeUnits": "MM", "bufferColor": "255,255,255,255"}
    XML.SubElement(style, "text-buffer", {**buffer, "bufferOpacity": "1"})
    XML.SubElement(settings, "text-format", multilineAlign="3")
    XML.SubElement(
        settings, "placement",
        {"placement": _OVER if layer == "vehicles" else _BESIDE, "quadOffset": "4", "dist": "1", "distUnits": "MM",
         "priority": "5"},
    )  # fmt: skip
    XML.SubElement(
        settings, "rendering",
        {"drawLabels": "1", "scaleVisibility": str(int(scaled)), "scaleMin": "1", "scaleMax": str(_LABEL_SCALE),
         "obstacle": "1"},
    )  # fmt: skip


def qml(layer: str, *, scaled: bool = True, drawn: bool = True) -> str:
    """Return the style of a layer as a QML document.

    Poles are dots, with an arrow in the direction of lean from 1 degree on. Signs are triangles that point in their
    facing direction, bars where the front is unknown, or diamonds where no panel was measured.
    """
    categories = "Symbology|Labeling|Fields"
    root = XML.Element("qgis", version="3.22.0", styleCategories=categories, labelsEnabled=str(int(layer in _LABELS)))
    _renderer(root, layer, drawn=drawn)
    if layer in _LABELS:
        _labels(root, layer, scaled=scaled)
    if layer not in ("trajectory", "sections"):
        aliases = XML.SubElement(root, "aliases")
        for name, field in fields_of_layer(layer).items():
            XML.SubElement(aliases, "alias", field=name, name=field.alias)
    XML.indent(root)
    doctype = "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
    return doctype + XML.tostring(root, encoding="unicode") + "\n"
