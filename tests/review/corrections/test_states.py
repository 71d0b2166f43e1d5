"""Order of review: what comes first, why, and the expected precision."""

import numpy as np
import pytest
from helpers.corrected import object_rows

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.objects.review import order_of_review
from mlsroad_pipeline.review.corrections import review_order


def test_uncertain_objects_come_first_and_each_has_a_reason():
    rows = review_order(object_rows(), {}, 10)
    assert [row["object_id"] for row in rows[:2]] == [3, 2]
    assert rows[0]["reason"].startswith("uncertain (score 0.50)")
    assert sorted(row["object_id"] for row in rows) == [1, 2, 3, 4, 5]


def test_decided_objects_are_left_out():
    states = {3: {"status": "rejected"}, 2: {"status": "accepted"}}
    assert {row["object_id"] for row in review_order(object_rows(), states, 10)} == {1, 4, 5}


def test_the_expected_precision_is_that_of_a_simulation():
    table = object_rows([("pole", i, 0) for i in range(40)], np.linspace(0.05, 0.95, 40))
    order = order_of_review(table, np.full(40, np.nan), 15)
    random = np.random.default_rng(0)
    right = random.random((20000, 40)) < table["score"].to_numpy()
    listed = 40 - np.cumsum(~right[:, order.rows], axis=1)
    found = (right.sum(axis=1)[:, None] / listed).mean(axis=0)
    np.testing.assert_allclose(order.precision, found, atol=0.01)
    assert (np.diff(order.precision) > 0).all()


def test_objects_far_from_the_path_come_last_and_say_so():
    table = object_rows().assign(offset=[3.0, -40.0, 5.0, -2.0, 90.0])
    rows = review_order(table, {}, 10)
    assert {row["object_id"] for row in rows[:3]} == {1, 3, 4}
    assert {row["reason"].partition(";")[0] for row in rows[3:]} == {"40 m from the path", "90 m from the path"}


def test_alike_objects_come_once_before_their_copies():
    table = object_rows([("pole", i, 0) for i in range(9)] + [("tree", 50, 0)], [0.5] * 9 + [0.55])
    table["height"] = [5.0] * 8 + [9.0, 5.0]
    first = order_of_review(table, np.full(10, np.nan), 3).rows
    assert {8, 9} < set(first.tolist())


def test_order_with_nothing_to_do_and_without_a_column():
    assert review_order([], {}, 5) == []
    assert review_order(object_rows(), {n: {"status": "accepted"} for n in range(1, 6)}, 5) == []
    with pytest.raises(DataError, match="no column 'score'"):
        review_order(object_rows().drop(columns="score"), {}, 5)
