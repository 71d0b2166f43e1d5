"""Objects and lines that two drives recorded are listed once."""

import numpy as np
import pandas as pd
import pytest
import shapely

from mlsroad_pipeline.algorithms.inventory.lines.extraction import LINE_FIELDS, line_row, line_table
from mlsroad_pipeline.algorithms.inventory.objects.merging import MergedObjects
from mlsroad_pipeline.algorithms.inventory.objects.table import FIELDS, OBJECT_FIELDS
from mlsroad_pipeline.algorithms.inventory.passes import are_comparable, join_pass_lines, join_pass_objects

EAST, NORTH = 389_000.0, 5_819_000.0


def drive(scene, *objects):
    """Return a drive of objects (kind, x, y, score, points, pole_id), each of which is one part of one scene."""
    rows = []
    for number, (kind, x, y, score, points, pole) in enumerate(objects, 1):
        blank = {name: "" if field.dtype == "str" else 0 for name, field in FIELDS.items()}
        box = shapely.box(EAST + x - 0.1, NORTH + y - 0.1, EAST + x + 0.1, NORTH + y + 0.1)
        rows.append(
            blank
            | {"object_id": number, "kind": kind, "class": kind, "score": score, "x": EAST + x, "y": NORTH + y}
            | {"point_count": points, "pole_id": pole, "footprint": box.wkt, "disagreeing_share": 0.1 * number}
            | {"x_min": EAST + x - 0.1, "x_max": EAST + x + 0.1}
        )
    table = pd.DataFrame(rows, columns=list(OBJECT_FIELDS)).astype(OBJECT_FIELDS)
    return MergedObjects(table, {scene: np.arange(len(objects) + 1, dtype=np.uint32)})


def test_an_object_of_two_drives_is_listed_once_with_the_points_of_both():
    first = drive("a", ("pole", 0.0, 0.0, 0.6, 100, 0), ("tree", 20.0, 0.0, 0.9, 500, 0))
    second = drive(
        "b", ("pole", 50.0, 0.0, 0.8, 40, 0), ("pole", 0.3, 0.0, 0.9, 300, 0), ("sign", 0.3, 0.2, 0.7, 30, 2)
    )
    table, numbers = join_pass_objects([first, second], comparable=True)
    assert table["object_id"].tolist() == [1, 2, 3, 4]
    assert table["kind"].tolist() == ["pole", "tree", "pole", "sign"]
    one = table.iloc[0]
    assert (one["score"], one["point_count"]) == (0.9, 400) and one["x"] == EAST + 0.3  # of the better drive
    assert [one["x_min"], one["x_max"]] == pytest.approx([EAST - 0.1, EAST + 0.4])
    assert shapely.from_wkt(one["footprint"]).area == pytest.approx(0.1, abs=1e-3)
    assert one["disagreeing_share"] == pytest.approx((0.1 * 100 + 0.2 * 300) / 400)
    assert table.iloc[3]["pole_id"] == 1  # the sign of the second drive hangs on the pole of both
    assert numbers["a"].tolist() == [0, 1, 2] and numbers["b"].tolist() == [0, 3, 1, 4]


def test_objects_of_other_kinds_or_farther_away_stay_apart():
    first = drive("a", ("pole", 0.0, 0.0, 0.6, 100, 0))
    second = drive("b", ("sign", 0.0, 0.0, 0.8, 40, 0), ("pole", 0.6, 0.0, 0.9, 300, 0))
    table, numbers = join_pass_objects([first, second], comparable=True)
    assert len(table) == 3 and numbers["b"].tolist() == [0, 2, 3]
    same = drive("c", ("pole", 0.0, 0.0, 0.6, 100, 0))
    assert len(join_pass_objects([first, same], comparable=False).objects) == 2


def test_drives_without_objects_change_nothing():
    first, none = drive("a", ("pole", 0.0, 0.0, 0.6, 100, 0)), drive("b")
    for order in ([first, none], [none, first]):
        table, numbers = join_pass_objects(order, comparable=True)
        assert table["object_id"].tolist() == [1] and numbers["a"].tolist() == [0, 1] and numbers["b"].tolist() == [0]


def test_places_of_scanners_are_not_compared():
    far, near = drive("a", ("pole", 0.0, 0.0, 0.6, 100, 0)).objects, drive("b", ("pole", 0, 0, 0.6, 1, 0)).objects
    assert are_comparable([far]) and not are_comparable([far, near.assign(x=3.0, y=-4.0)])
    assert not are_comparable([far.iloc[:0]])


def lines(*places):
    rows = [
        line_row(kind, np.array([(EAST + x0, NORTH + y, 5.0), (EAST + x1, NORTH + y, 6.0)]), None, height=0.12)
        for kind, x0, x1, y in places
    ]
    return line_table(rows)


def test_a_line_of_two_drives_is_listed_once_and_continued():
    first = lines(("kerb", 0.0, 10.0, 0.0))
    second = lines(("kerb", 5.0, 20.0, 0.2), ("kerb", 0.0, 9.0, 0.3), ("wire", 0.0, 9.0, 0.0), ("kerb", 0.0, 9.0, 3.0))
    table = join_pass_lines([first, second], comparable=True)
    assert list(table.columns) == list(LINE_FIELDS) and table["line_id"].tolist() == [1, 2, 3, 4]
    assert table["kind"].tolist() == ["kerb", "kerb", "kerb", "wire"]
    found = sorted(table.loc[table["kind"] == "kerb", "length"])
    assert found[0] == 9.0 and found[1] == pytest.approx(9.54, abs=0.02) and found[2] == 10.0
    rest = table[(table["kind"] == "kerb") & table["length"].between(9.1, 9.9)].iloc[0]
    z = shapely.get_coordinates(shapely.from_wkt(rest["line"]), include_z=True)[:, 2]
    assert rest["height"] == 0.12 and z.tolist() == pytest.approx([5.364, 6.0], abs=0.01)
    assert len(join_pass_lines([first, second], comparable=False)) == 5
    assert len(join_pass_lines([first.iloc[:0], first.iloc[:0]], comparable=True)) == 0
