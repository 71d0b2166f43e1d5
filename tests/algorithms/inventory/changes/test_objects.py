"""States of planted objects of two surveys."""

import numpy as np
import pandas as pd
import pytest

from mlsroad_pipeline.algorithms.inventory.changes.objects import (
    BY_BOTH,
    BY_POINTS,
    BY_RAYS,
    CHANGED,
    GONE,
    MOVED,
    NEW,
    OTHER_KIND,
    UNCHANGED,
    UNSEEN_FIRST,
    UNSEEN_SECOND,
    MeasuredByPoints,
    Unmatched,
    changed_objects,
    pair_objects,
)
from mlsroad_pipeline.algorithms.inventory.register.states import Evidence

COLUMNS = ("kind", "x", "y", "height", "tilt", "lean_azimuth", "panel_bottom")


def objects_of(*rows):
    table = pd.DataFrame([(*row, *([np.nan] * (len(COLUMNS) - len(row)))) for row in rows], columns=COLUMNS)
    return table.assign(object_id=np.arange(len(table)) + 11, z=30.0).astype({"x": float, "y": float})


def evidence(rows, empty, standing, rays=900, crossing=np.nan):
    n = len(rows)
    nothing, upright = np.zeros(n, dtype=np.bool_), np.full(n, empty == 0)
    found = Evidence(np.zeros(n, np.int64), nothing, upright, np.broadcast_to(float(empty), n))
    return Unmatched(
        np.asarray(rows), found, np.broadcast_to(float(standing), n), np.full(n, rays), np.full(n, crossing)
    )


def compared(first, second, *, empty=1.0, standing=0.0, rays=900, crossing=np.nan, **by_points):
    pairs = pair_objects(first, second)
    doubtful = pairs.doubtful(first, second)
    sides = [evidence(rows, empty, standing, rays, crossing) for rows in (doubtful.left_first, doubtful.left_second)]
    pairs = pairs.proved(*sides)
    measured = MeasuredByPoints.unknown(len(pairs.first))
    measured = measured._replace(**{name: np.full(len(pairs.first), value) for name, value in by_points.items()})
    return changed_objects(first, second, pairs, *sides, measured)


def test_each_state_is_that_of_its_planted_case():
    first = objects_of(
        ("pole", 0, 0, 5), ("pole", 20, 0, 5), ("sign", 40, 0, 3), ("tree", 60, 0, 8), ("tree", 80, 0, 9)
    )
    second = objects_of(("pole", 0.3, 0, 5.1), ("pole", 23, 0, 5.2), ("pole", 40.2, 0, 3), ("tree", 63, 0, 3))
    table = compared(first, second)
    # The second tree is not half as high: it is no tree that moved. The sign is gone, and the pole in its place is new.
    assert table["state"].tolist() == [UNCHANGED, MOVED, GONE, GONE, GONE, NEW, NEW]
    assert table["evidence"].tolist() == [BY_BOTH, BY_BOTH, *[BY_RAYS] * 5]
    assert table["first_id"].tolist() == [11, 12, 13, 14, 15, 0, 0]
    assert table["second_id"].tolist() == [11, 12, 0, 0, 0, 13, 14]
    moved = table.set_index("state").loc[MOVED]
    assert (moved["x"], moved["dx"], moved["distance"]) == pytest.approx((23, 3, 3))


@pytest.mark.parametrize(
    ("empty", "standing", "rays", "before", "after"),
    [
        (1.0, 0.0, 900, GONE, NEW),
        (1.0, 0.55, 900, UNSEEN_SECOND, UNSEEN_FIRST),  # half of the object is there: no proof of either
        (0.0, 0.9, 900, UNCHANGED, UNCHANGED),  # it stands, but is not listed
        (0.0, 0.29, 900, GONE, NEW),  # another object stands at the place
        (0.0, 0.31, 900, UNSEEN_SECOND, UNSEEN_FIRST),
        (0.0, 0.0, 20, UNSEEN_SECOND, UNSEEN_FIRST),
        (1.0, np.nan, 900, GONE, NEW),  # an object that a user added has no points of its own
        (0.0, np.nan, 900, UNCHANGED, UNCHANGED),
    ],
)
def test_what_the_other_survey_saw_decides_about_objects_of_one_survey(empty, standing, rays, before, after):
    objects = objects_of(("pole", 0, 0, 5))
    table = compared(objects, objects.iloc[:0], empty=empty, standing=standing, rays=rays)
    assert table["state"].tolist() == [before] and table["first_id"].tolist() == [11]
    table = compared(objects.iloc[:0], objects, empty=empty, standing=standing, rays=rays)
    assert table["state"].tolist() == [after] and table["second_id"].tolist() == [11]
    assert table["evidence"].tolist() == [BY_POINTS if after == UNCHANGED else BY_RAYS]


def test_objects_without_evidence_are_not_visible():
    objects = objects_of(("pole", 0, 0, 5))
    pairs, nothing = pair_objects(objects, objects.iloc[:0]), np.zeros(0, np.int64)
    table = changed_objects(
        objects, objects.iloc[:0], pairs, *(evidence(nothing, 1, 0),) * 2, MeasuredByPoints.unknown(0)
    )
    assert table["state"].tolist() == [UNSEEN_SECOND] and table["rays"].tolist() == [0]


@pytest.mark.parametrize(
    ("before", "after", "angle", "is_change"),
    [
        ((0.0, 0), (1.0, 90), 1.0, True),
        ((1.0, 0), (1.0, 180), 2.0, True),
        ((2.0, 45), (2.5, 45), 0.5, False),
        ((0.4, np.nan), (2.8, 90), 2.4, True),  # too upright for a direction: at least the difference
        ((0.4, np.nan), (0.3, np.nan), 0.1, False),
    ],
)
def test_the_tilt_of_a_pole_is_the_angle_between_its_axes(before, after, angle, is_change):
    first, second = (objects_of(("pole", 0, 0, 8, *axis)) for axis in (before, after))
    table = compared(first, second)
    assert table["tilt_change"].to_numpy() == pytest.approx([angle], abs=1e-6)
    assert (table["state"].tolist() == [CHANGED]) == is_change == ("axis turned by" in table.loc[0, "changes"])


def test_tilts_of_poles_whose_bases_lie_apart_are_not_compared():
    first, second = objects_of(("pole", 0, 0, 8, 2.6, 0)), objects_of(("pole", 0.45, 0, 8, 5.1, 90))
    assert compared(first, second, standing=0.9)["state"].tolist() == [UNCHANGED]


@pytest.mark.parametrize("kind", ["pole", "sign", "tree"])
def test_an_object_moves_to_one_of_its_height(kind):
    first = objects_of((kind, 0, 0, 8.0))
    # The nearest one is lower.
    second = objects_of((kind, 2.0, 0, 6.5), (kind, -3.5, 0, 7.9))
    table = compared(first, second).set_index("state")
    assert sorted(table.index) == [MOVED, NEW] and table.loc[MOVED, "x"] == -3.5
    assert compared(first, second.iloc[:1])["state"].tolist() == [MOVED]
    assert compared(first, second.iloc[:1].assign(height=5.0))["state"].tolist() == [GONE, NEW]


@pytest.mark.parametrize(
    ("distance", "standing", "states"),
    [(0.3, 0.0, [UNCHANGED]), (0.8, 0.0, [GONE, NEW]), (0.8, 0.9, [UNCHANGED]), (0.8, 0.55, [UNCHANGED])],
)
def test_objects_that_lie_apart_are_two_where_neither_survey_has_the_other_one(distance, standing, states):
    first, second = objects_of(("pole", 0, 0, 8)), objects_of(("pole", distance, 0, 4))
    assert compared(first, second, standing=standing)["state"].tolist() == states


def test_tilts_of_short_poles_and_of_poles_seen_to_other_heights_are_not_compared():
    for heights in ((2.0, 2.0), (8.0, 5.0)):
        first, second = (objects_of(("pole", 0, 0, high, tilt, 0)) for high, tilt in zip(heights, (0, 5), strict=True))
        assert compared(first, second)["state"].tolist() == [UNCHANGED]


@pytest.mark.parametrize(
    ("growth", "state"), [(0.9, CHANGED), (0.1, UNCHANGED), (-0.9, UNCHANGED), (np.nan, UNCHANGED)]
)
def test_a_tree_grew_where_its_top_did_too(growth, state):
    first, second = (objects_of(("tree", 0, 0, high)) for high in (8.0, 9.0))
    assert compared(first, second, growth=growth)["state"].tolist() == [state]


def test_a_panel_at_another_height_is_a_change():
    first, second = (objects_of(("sign", 0, 0, 3, 0, 0, bottom)) for bottom in (2.2, 1.5))
    assert compared(first, second)["changes"].tolist() == ["panel bottom 2.2 to 1.5 m"]


def test_empty_inventories_have_no_changes():
    nothing = objects_of(("pole", 0, 0, 5)).iloc[:0]
    assert compared(nothing, nothing).empty


@pytest.mark.parametrize(("turn", "state"), [(0.2, UNCHANGED), (1.8, CHANGED), (np.nan, CHANGED)])
def test_points_refute_the_turn_of_a_pole(turn, state):
    first, second = (objects_of(("pole", 0, 0, 8, tilt, 0)) for tilt in (1, 3))
    assert compared(first, second, turn=turn)["state"].tolist() == [state]


@pytest.mark.parametrize(("panel", "state"), [(0.9, UNCHANGED), (0.2, CHANGED), (np.nan, CHANGED)])
def test_points_refute_the_move_of_a_panel(panel, state):
    first, second = (objects_of(("sign", 0, 0, 3, 0, 0, bottom)) for bottom in (2.2, 1.5))
    assert compared(first, second, panel=panel)["state"].tolist() == [state]


@pytest.mark.parametrize(
    ("standing", "state", "by"), [(0.9, UNCHANGED, BY_POINTS), (0.31, OTHER_KIND, BY_BOTH), (0.5, OTHER_KIND, BY_BOTH)]
)
def test_two_kinds_whose_points_both_surveys_have_are_no_change(standing, state, by):
    first, second = objects_of(("pole", 0, 0, 4)), objects_of(("sign", 0.3, 0, 4))
    table = compared(first, second, empty=0.0, standing=standing)
    assert table[["state", "evidence"]].to_numpy().tolist() == [[state, by]] and (table["reason"] != "").all()


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({}, "the second survey has points at 0% of it; 900 rays of the second survey cross its place"),
        ({"empty": 0.3, "standing": 0.55}, "900 rays of the second survey cross its place (30% of it empty): no proof"),
        ({"empty": 0.0, "standing": 0.9}, "has points at 90% of it"),
    ],
)
def test_a_reason_names_the_evidence(options, reason):
    objects = objects_of(("pole", 0, 0, 5))
    assert reason in compared(objects, objects.iloc[:0], **options).loc[0, "reason"]


@pytest.mark.parametrize(("crossing", "state"), [(40, GONE), (3, UNSEEN_SECOND), (np.nan, GONE)])
def test_a_sign_is_gone_where_rays_cross_its_panel(crossing, state):
    objects = objects_of(("sign", 0, 0, 3))
    assert compared(objects, objects.iloc[:0], crossing=crossing)["state"].tolist() == [state]
