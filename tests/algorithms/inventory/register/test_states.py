"""States of planted entries."""

import numpy as np
import pandas as pd
import pytest

from mlsroad_pipeline.algorithms.inventory.register.offset import register_offset
from mlsroad_pipeline.algorithms.inventory.register.seen_space import SIDE, SLICES, SeenSpace
from mlsroad_pipeline.algorithms.inventory.register.states import (
    BY_OBJECT,
    BY_OTHERS,
    BY_POINTS,
    BY_RAYS,
    CONFIRMED,
    MOVED,
    NEW,
    NOT_FOUND,
    NOT_VISIBLE,
    OTHER_KIND,
    confirm,
    decide,
    evidence_of,
)


def entries_of(*rows):
    table = pd.DataFrame(rows, columns=["kind", "x", "y", "height"])
    return table.assign(id=np.arange(len(table)) + 1)


def objects_of(*rows):
    table = pd.DataFrame(rows, columns=["kind", "x", "y", "height"])
    return table.assign(object_id=np.arange(len(table)) + 11, z=0.0)


def decided(entries, objects, seen=None):
    matches = confirm(entries, objects)
    rows = np.flatnonzero(matches.state == "")
    seen = SeenSpace.unseen(len(rows)) if seen is None else seen(len(rows))
    kind, height = entries["kind"].to_numpy(dtype=str)[rows], entries["height"].to_numpy()[rows]
    return decide(entries, objects, matches, rows, evidence_of(seen, kind, height), seen.rays)


def free_everywhere(n):
    seen = SeenSpace.unseen(n)
    seen.free[:] = 2
    return seen._replace(rays=np.full(n, 99))


def test_each_state_is_that_of_its_planted_case():
    entries = entries_of(
        ("pole", 0, 0, 5.0), ("pole", 20, 0, 5.0), ("sign", 40, 0, 2.5), ("tree", 60, 0, np.nan), ("pole", 80, 0, 5.0)
    )
    objects = objects_of(
        ("pole", 0.4, 0.3, 6.0),
        ("pole", 23, 0, 5.0),
        ("pole", 40, 0.5, 3.0),
        ("sign", 100, 0, 2.0),
    )
    table = decided(entries, objects, free_everywhere)
    assert table["state"].tolist() == [CONFIRMED, MOVED, OTHER_KIND, NOT_FOUND, NOT_FOUND, NEW]
    assert table["evidence"].tolist() == [BY_OBJECT, BY_OBJECT, BY_OBJECT, BY_RAYS, BY_RAYS, BY_OBJECT]
    assert table["object_id"].tolist() == [11, 12, 13, 0, 0, 14]
    first = table.iloc[0]
    assert (first["distance"], first["dx"], first["height_difference"]) == pytest.approx((0.5, 0.4, 1.0))
    assert table["rays"].tolist()[3:] == [99, 99, 0]


def test_objects_of_like_height_are_assigned_first():
    # The entry of the low tree takes neither the high tree beside it, which is that of an entry that moved, nor the
    # lamp: its plate is as high.
    entries = entries_of(("tree", 0, 0, 3.0), ("tree", 4, 0, 9.0), ("pole", 20, 0, 3.0), ("pole", 40, 0, 3.0))
    objects = objects_of(("tree", 0.8, 0, 9.0), ("pole", 20.1, 0, 9.0), ("sign", 20.3, 0, 3.0), ("pole", 40, 0.5, 9.0))
    table = decided(entries, objects, free_everywhere)
    assert table["state"].tolist() == [NOT_FOUND, MOVED, OTHER_KIND, CONFIRMED, NEW]
    assert table["object_id"].tolist() == [0, 11, 13, 14, 12]


def test_unseen_entries_are_not_visible():
    table = decided(entries_of(("pole", 0, 0, 5.0), ("tree", 9, 9, np.nan)), objects_of())
    assert table["state"].tolist() == [NOT_VISIBLE, NOT_VISIBLE] and table["rays"].tolist() == [0, 0]


def test_entries_without_ground_are_not_visible():
    entries = entries_of(("pole", 0, 0, 5.0))
    nothing = SeenSpace.unseen(0)
    evidence = evidence_of(nothing, np.zeros(0, str), np.zeros(0))
    table = decide(entries, objects_of(), confirm(entries, objects_of()), np.zeros(0, np.int64), evidence, nothing.rays)
    assert table["state"].tolist() == [NOT_VISIBLE]


def test_points_confirm_an_entry_without_an_object():
    middle = SIDE // 2

    def standing(n):
        seen = free_everywhere(n)
        for name in ("hit", "own"):
            getattr(seen, name)[0, :8, middle, middle] = 3
        for name in ("hit", "other"):
            getattr(seen, name)[1, :8, middle, middle] = 3
        seen.hit[2, :8, middle, middle] = 3  # of no upright kind: nothing is proved
        seen.hit[3, 0, middle, middle] = 3  # too few
        return seen

    entries = entries_of(*(("pole", 20.0 * k, 0, 5.0) for k in range(4)))
    table = decided(entries, objects_of(), standing)
    assert table["state"].tolist() == [CONFIRMED, CONFIRMED, NOT_VISIBLE, NOT_FOUND]
    assert table["evidence"].tolist() == [BY_POINTS, BY_OTHERS, BY_RAYS, BY_RAYS]
    assert table["points"].tolist() == [24, 0, 0, 0]


@pytest.mark.parametrize(("columns", "state"), [(SIDE, NOT_FOUND), (SIDE // 2, NOT_VISIBLE)])
def test_most_columns_must_be_free(columns, state):
    def partly(n):
        seen = SeenSpace.unseen(n)
        seen.free[:, :4, :columns] = 1
        return seen

    assert decided(entries_of(("pole", 0, 0, 5.0)), objects_of(), partly)["state"].tolist() == [state]


def test_a_low_object_is_not_searched_for_above_its_top():
    def above(n):
        seen = SeenSpace.unseen(n)
        seen.free[:, 4:] = 1
        return seen

    table = decided(entries_of(("pole", 0, 0, 1.2), ("pole", 9, 0, 0.5)), objects_of(), above)
    assert table["state"].tolist() == [NOT_VISIBLE, NOT_VISIBLE]
    table = decided(entries_of(("pole", 0, 0, 0.5)), objects_of(), free_everywhere)
    assert table["state"].tolist() == [NOT_VISIBLE]  # too few slices
    assert SLICES > 4


def test_the_offset_is_the_most_frequent_displacement(rng):
    places = rng.random((200, 2)) * 400
    kind = rng.choice(["pole", "sign"], 200)
    objects = places + [2.1, -1.4] + rng.normal(0, 0.1, (200, 2))
    objects[:60] = rng.random((60, 2)) * 400
    found = register_offset(places, kind, objects, kind)
    assert found.shift == pytest.approx([2.1, -1.4], abs=4 * found.error.max())
    assert 130 <= found.pairs <= 150 and found.error.max() < 0.03


def test_no_offset_is_claimed_without_enough_pairs(rng):
    places = rng.random((40, 2)) * 100
    few = register_offset(places, np.repeat("pole", 40), places[:3] + 1, np.repeat("pole", 3))
    other = register_offset(places, np.repeat("pole", 40), places, np.repeat("sign", 40))
    random = register_offset(places, np.repeat("pole", 40), rng.random((40, 2)) * 100, np.repeat("pole", 40))
    for found in (few, other, random):
        assert found.pairs == 0 and found.shift.tolist() == [0, 0] and np.isnan(found.error).all()
