"""Shapes of plates and types of poles: planted outlines and wires."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_row, line_table
from mlsroad_pipeline.algorithms.inventory.lines.wire_poles import with_utility_poles
from mlsroad_pipeline.algorithms.inventory.objects.plate_shapes import plate_shape
from mlsroad_pipeline.algorithms.inventory.objects.table import object_table

OUTLINES = {
    "round": lambda u, v: np.hypot(u, v) <= 0.4,
    "octagon": lambda u, v: (np.maximum(abs(u), abs(v)) <= 0.37) & (abs(u) + abs(v) <= 0.523),
    "triangle": lambda u, v: abs(u) <= (0.4 - v) / np.sqrt(3),
    "yield": lambda u, v: abs(u) <= (0.4 + v) / np.sqrt(3),
    "square": lambda u, v: np.maximum(abs(u), abs(v)) <= 0.35,
    "board": lambda u, v: abs(v) <= 0.2,
    "diamond": lambda u, v: abs(u) + abs(v) <= 0.4,
}
EXPECTED = {
    "octagon": "round",
    "yield": "triangle",
    "square": "rectangle",
    "board": "rectangle",
    "diamond": "rectangle",
}


def planted(name, n, seed):
    """Return points on a plate that scan lines 6 cm apart hit."""
    rng = np.random.default_rng(seed)
    v = np.repeat(np.arange(-0.4, 0.41, 0.06) + rng.uniform(-0.03, 0.03), 40)
    u = rng.uniform(-0.45, 0.45, len(v))
    uv = np.column_stack([u, v])[OUTLINES[name](u, v) & (abs(v) <= 0.4)]
    return uv[rng.permutation(len(uv))[:n]] + rng.normal(0, 0.004, (min(n, len(uv)), 2))


@pytest.mark.parametrize("name", OUTLINES)
@pytest.mark.parametrize("n", [60, 200])
def test_planted_plates_have_their_shape(name, n):
    found = [plate_shape(planted(name, n, seed) + [0.2, 2.5]) for seed in range(20)]
    assert found.count(EXPECTED.get(name, name)) >= (18 if name != "octagon" else 15)


def test_few_points_and_slivers_have_no_shape():
    assert plate_shape(planted("round", 19, 1)) == ""
    assert plate_shape(np.random.default_rng(1).uniform(0, [1.0, 0.1], (200, 2))) == ""


def test_poles_that_wires_run_to_are_utility_poles():
    """Poles at 0 (at the end of a wire), 30 (6 m beyond its other end), 15 (low), 40 (too far), beside the wire."""
    places = [(0.0, 0, 9.0), (30, 0.2, 9.0), (15, 0, 5.0), (40, 0, 9.0), (12, 2.0, 9.0)]
    rows = [
        {**dict.fromkeys(object_table([]).columns, np.nan), "kind": "pole", "class": "pole", "x": x, "y": y, "z": 20.0,
         "height": h, "point_count": 9, "score": 1.0, "facing_from": "", "complete": "", "footprint": "", "scene": "s",
         "pole_type": "", "panel_shape": ""}
        for x, y, h in places
    ]  # fmt: skip
    numbers = [n for n, t in object_table([]).dtypes.items() if t == np.int64]
    objects = object_table([{**row, **dict.fromkeys(numbers, 0)} for row in rows])
    wire = np.column_stack([np.linspace(0, 24, 25), np.zeros(25), 27.0 + 0.01 * (np.arange(25) - 12) ** 2])
    found = with_utility_poles(objects, line_table([line_row("wire", wire, None)]))
    assert found["pole_type"].tolist() == ["utility", "utility", "", "", ""]
    assert with_utility_poles(objects, line_table([]))["pole_type"].tolist() == [""] * 5
