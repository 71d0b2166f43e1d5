"""Colours of the taxonomy classes in all pictures, figures and reports.

Related classes share a hue: ground grey and earth, buildings orange and brown, vegetation green, poles blue and violet,
vehicles red and pink, people yellow. They differ in lightness, so that the main classes remain distinguishable with
red-green colour blindness.
"""

import colorsys

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme

Colour = tuple[int, int, int]

IGNORED_COLOUR: Colour = (214, 218, 225)
"""Colour of points that are unlabelled or not scored."""
CORRECT_COLOUR: Colour = (150, 156, 164)
WRONG_COLOUR: Colour = (200, 30, 20)
HIT_COLOUR: Colour = (20, 140, 60)
MISSED_COLOUR: Colour = (30, 80, 220)
"""Colours of detected (green) and missed (blue) objects; false detections have `WRONG_COLOUR`."""

COLOURS: dict[str, str] = {
    "unlabelled": "#d6dae1",
    "road": "#8a8f98", "lane_marking": "#f2f3f4", "parking": "#a7a4b8", "sidewalk": "#c9bfae", "curb": "#e8d9b5",
    "manhole": "#5f646d", "trail": "#b59f7c", "grass": "#a9cf6e", "soil": "#9c7f58", "other_ground": "#bab7ae",
    "building": "#f2994a", "wall": "#93401a", "fence": "#552204", "stairs": "#f9c48e", "bridge": "#54341f",
    "guardrail": "#d4a017", "other_structure": "#c98b6b",
    "trunk": "#4a3016", "tree": "#1a7f4b", "palm": "#4cc9a0", "cycas": "#b9efdc", "brushwood": "#75861b",
    "hedge": "#3f5a1c", "other_vegetation": "#1f7a36",
    "utility_pole": "#2f62e6", "light_pole": "#5a86f0", "traffic_sign": "#009fc4", "traffic_light": "#044a63",
    "post": "#7d8fe8", "gantry": "#27306b", "transformer": "#5b4bd0", "station_sign": "#62d2ef",
    "wire": "#6a35c0", "support_wire": "#4a4a57",
    "car": "#ef3b7c", "van": "#ff8fb3", "truck": "#b8124a", "bus": "#d2649f", "train": "#5e0f36",
    "motorcycle": "#b03fd0", "bicycle": "#e6b8ff", "other_vehicle": "#ffc2d6",
    "person": "#ffd400", "rider": "#e6b800", "animal": "#fff08a",
    "bus_shelter": "#8a5cc7", "bin": "#a783dc", "bench": "#cdb6ee", "bollard": "#452a78", "hydrant": "#7e2fb8",
    "mail_box": "#d3c1f0", "parking_meter": "#8c86b8", "other_object": "#a58bc4",
    "outlier": "#ff6f61",
}  # fmt: skip
"""Taxonomy class to colour, ``#rrggbb``."""

KIND_COLOURS = {
    kind: COLOURS[name]
    for kind, name in (("pole", "utility_pole"), ("sign", "traffic_sign"), ("tree", "tree"), ("vehicle", "car"))
}
"""Kind of object to the colour of its class, on maps, in the page, in QGIS and in drawings."""

LINE_COLOURS = {
    "kerb": "#b9770e", "wire": COLOURS["wire"], "barrier": COLOURS["wall"], "lane_line": "#008caa",
    "stop_line": "#c81e3c", "crossing": "#e68200", "other_marking": "#6e7d87",
}  # fmt: skip
"""Kind of line to its colour, likewise."""

STATE_COLOURS = {
    **dict.fromkeys(("unchanged", "confirmed"), "#7f8c8d"), "changed": "#e68200", "moved": "#7d3cb5",
    "different kind": "#b9770e", "new": "#1f8a3b", **dict.fromkeys(("gone", "not found"), "#c81e3c"),
    **dict.fromkeys(("not visible", "not visible in the second"), "#4a76c9"), "not visible in the first": "#35b0c9",
}  # fmt: skip
"""State of a comparison to its colour on maps."""

_ALIASES = {
    "ground": "road", "paved ground": "road", "man-made terrain": "road", "natural ground": "grass",
    "natural terrain": "grass", "facade": "building", "vegetation": "tree", "palm tree": "palm", "hard scape": "wall",
    "pole": "utility_pole", "pole object": "utility_pole", "sign": "traffic_sign", "vehicle": "car", "human": "person",
    "low vegetation": "brushwood", "wall or fence": "wall", "two-wheeler": "bicycle", "street furniture": "bin",
    "pedestrian": "person", "other": "other_object", "man-made object": "other_object",
}  # fmt: skip
"""Class name of a scheme to the taxonomy class whose colour it takes."""


def hex_to_rgb(colour: str) -> Colour:
    """Convert ``#rrggbb`` to red, green and blue, 0 to 255.

    >>> hex_to_rgb("#d81b60")
    (216, 27, 96)
    """
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def rgb_to_hex(colour: ArrayLike) -> str:
    """Convert red, green and blue, 0 to 255, to ``#rrggbb``.

    >>> rgb_to_hex((216, 27, 96))
    '#d81b60'
    """
    red, green, blue = (int(value) for value in np.asarray(colour))
    return f"#{red:02x}{green:02x}{blue:02x}"


LAS_CODES = {
    **{2: "grass", 3: "brushwood", 4: "hedge", 5: "tree", 6: "building", 11: "road", 14: "wire", 17: "bridge"},
    **{64: "utility_pole", 65: "traffic_sign", 66: "car", 67: "bin", 68: "wall", 69: "bicycle", 70: "person"},
}
"""LAS class code to the taxonomy class whose colour it takes: standard codes and the private codes of results."""


def las_palette() -> NDArray[np.uint8]:
    """Return the colour of every LAS class code, uint8 (256, 3).

    Unlisted codes below 64 have `IGNORED_COLOUR`, each unlisted private code its own colour.
    """
    table = np.empty((256, 3), dtype=np.uint8)
    table[:64] = IGNORED_COLOUR
    table[64:] = [_spread(code) for code in range(64, 256)]
    for code, name in LAS_CODES.items():
        table[code] = hex_to_rgb(COLOURS[name])
    return table


def _spread(index: int) -> Colour:
    """Return the colour of the index-th class outside the taxonomy: hues at steps of the golden angle."""
    hue, level = (0.58 + index * 0.61803398875) % 1.0, (0.72, 0.5, 0.9)[index % 3]
    red, green, blue = colorsys.hsv_to_rgb(hue, 0.75, level)
    return round(255 * red), round(255 * green), round(255 * blue)


def class_palette(classes: ClassScheme | ArrayLike) -> NDArray[np.uint8]:
    """Return the colours of the classes of a comparison, uint8 (C + 1, 3).

    A class takes the colour of the taxonomy class of the same name, of the class that represents its group, or of its
    first member, in this order. The colours are distinct. The last row, also indexed by label -1, is `IGNORED_COLOUR`.
    """
    if isinstance(classes, ClassScheme):
        names = list(classes.classes)
        leaders = [group[0] if group else name for name, group in zip(names, classes.members, strict=True)]
    else:
        names = leaders = [str(name) for name in np.asarray(classes).tolist()]
    table = np.empty((len(names) + 1, 3), dtype=np.uint8)
    table[-1] = IGNORED_COLOUR
    unknown = 0
    taken: set[Colour] = set()
    for label, (name, leader) in enumerate(zip(names, leaders, strict=True)):
        key = name.replace(" ", "_")
        candidates = [COLOURS.get(key), COLOURS.get(_ALIASES.get(name.replace("_", " "), "")), COLOURS.get(leader)]
        colour = next((hex_to_rgb(c) for c in candidates if c and hex_to_rgb(c) not in taken), None)
        while colour is None or colour in taken:
            colour, unknown = _spread(unknown), unknown + 1
        taken.add(colour)
        table[label] = colour
    return table


def outcome_colours(outcomes: ArrayLike) -> NDArray[np.uint8]:
    """Return the colours of points by detection outcome: 0 detected, 1 missed, 2 false, -1 not of a target class."""
    table = np.array([HIT_COLOUR, MISSED_COLOUR, WRONG_COLOUR, IGNORED_COLOUR], dtype=np.uint8)
    return table[np.asarray(outcomes)]


def error_colours(truth: ArrayLike, predicted: ArrayLike) -> NDArray[np.uint8]:
    """Return the colours of points by correctness: grey correct, red wrong, light grey without true label (-1)."""
    t, p = np.asarray(truth), np.asarray(predicted)
    table = np.array([CORRECT_COLOUR, WRONG_COLOUR, IGNORED_COLOUR], dtype=np.uint8)
    return table[np.where(t < 0, 2, (t != p).astype(np.int8))]
