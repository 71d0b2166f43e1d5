"""Decisions about lines: found by kind and place, cut, joined, moved, drawn; measures that stay and that are unknown."""

import numpy as np
import pandas as pd
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_row, line_table
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.review.corrections import Correction, Decision
from mlsroad_pipeline.review.corrections.line_decisions import line_states

PATH = Trajectory.from_positions(np.column_stack([np.linspace(0, 100, 30), np.full(30, -3.0), np.zeros(30)]))
KERB = [[0.0, 0.0, 1.0], [10.0, 0.0, 1.1], [20.0, 0.0, 1.2]]
LINES = line_table(
    [
        line_row("kerb", np.array(KERB), PATH, height=0.12, least_height=0.1, most_height=0.2),
        line_row("lane_line", np.array([[0.0, 4.0, 1.0], [9.0, 4.0, 1.0]]), PATH, score=0.8, width=0.15, pattern="solid"),
        line_row("kerb", np.array([[21.0, 0.0, 1.0], [30.0, 0.0, 1.0]]), PATH, height=0.15),
    ]
)  # fmt: skip


def decision(action, kind, x=0.0, y=0.0, number=1, **more):
    place = {} if action == "add_line" else {"line": number, "x": x, "y": y}
    return Decision(1, "", "ann", Correction(action, kind=kind, payload={**place, **more}), {})


def numbered():
    """Return the numbers of the first kerb, the second kerb and the lane line."""
    first, second = LINES[LINES["kind"] == "kerb"].sort_values("x")["line_id"].tolist()
    return first, second, int(LINES.loc[LINES["kind"] == "lane_line", "line_id"].iloc[0])


def test_lines_are_found_by_kind_and_place():
    lines = pd.DataFrame({"line_id": [1, 2, 3], "kind": ["kerb", "wire", "kerb"], "x": [0.0, 0.0, 9.0], "y": [0.0] * 3})
    made = [
        decision("reject_line", "kerb", 0.1, 0.1, 7),
        decision("reject_line", "wire", 0.2, 0.1, 7),
        decision("accept_line", "wire", 0, 0.1, 7),
    ]
    far = decision("reject_line", "kerb", 4.0, 0.1, 7)
    found = line_states([*made, far], lines)
    assert (found.status, found.unmatched) == ({1: "rejected", 2: "accepted"}, [far])
    assert line_states(made, lines[:0]).status == {}


def test_of_lines_that_begin_together_the_one_of_the_number_is_meant():
    lines = pd.DataFrame({"line_id": [4, 5], "kind": ["kerb"] * 2, "x": [3.0, 3.0], "y": [0.0] * 2})
    assert line_states([decision("reject_line", "kerb", 3.0, 0.0, 5)], lines).status == {5: "rejected"}


def test_a_cut_line_is_two_and_each_can_be_decided():
    first, _, _ = numbered()
    cut = decision("cut_line", "kerb", number=first, parts=[[*KERB[:2]], [KERB[1], KERB[2]]])
    rejected = decision("reject_line", "kerb", 10.0, 0.0, 4)
    found = line_states([cut, rejected], LINES, PATH)
    assert found.status == {first: "cut", 4: "rejected"}
    table = found.apply(LINES).set_index("line_id")
    assert table.loc[[first, 4], "length"].tolist() == [10.0, 10.0]
    assert table.loc[4, ["from_station", "to_station"]].tolist() == pytest.approx([10.0, 20.0], abs=0.01)
    assert table.loc[[first, 4], ["height", "least_height"]].isna().all(axis=None)  # they were those of the whole line
    undone = line_states([rejected], LINES, PATH)  # the cut was taken back
    assert (undone.status, undone.unmatched) == ({}, [rejected])


def test_joined_lines_are_one():
    first, second, _ = numbered()
    other = {"line": second, "kind": "kerb", "x": 21.0, "y": 0.0}
    whole = [*KERB, [21.0, 0.0, 1.0], [30.0, 0.0, 1.0]]
    found = line_states([decision("join_lines", "kerb", number=first, other=other, parts=[whole])], LINES, PATH)
    assert (found.status, found.gone) == ({first: "joined"}, {second})
    table = found.apply(LINES)
    assert table["line_id"].tolist() == sorted(set(LINES["line_id"]) - {second})
    assert table.set_index("line_id").loc[first, "length"] == 30.0


def test_a_moved_vertex_keeps_measures_and_another_kind_those_that_it_has():
    first, _, lane = numbered()
    moved = decision("shape_line", "kerb", number=first, parts=[[[0.0, 0.0, 1.0], [10.0, 3.0, 1.1], [20.0, 0.0, 1.2]]])
    stop = decision("kind_line", "lane_line", 0.0, 4.0, lane, to="stop_line")
    found = line_states([decision("accept_line", "kerb", number=first), moved, stop], LINES, PATH)
    assert found.status == {first: "accepted", lane: "changed"}
    table = found.apply(LINES).set_index("line_id")
    assert table.loc[first, "height"] == 0.12 and table.loc[first, "length"] == pytest.approx(20.881, abs=0.001)
    assert table.loc[lane, ["kind", "score", "width", "pattern"]].tolist() == ["stop_line", 0.8, 0.15, ""]


def test_a_drawn_line_can_be_moved_and_rejected():
    drawn = decision("add_line", "wire", parts=[[[5.0, 5.0, 8.0], [9.0, 5.0, 8.0]]])
    moved = decision("shape_line", "wire", 5.0, 5.0, 4, parts=[[[5.0, 6.0, 8.0], [9.0, 5.0, 8.0]]])
    found = line_states([drawn, moved], LINES, PATH)
    assert found.status == {4: "added"} and found.rows[4]["y"] == 6.0
    found = line_states([drawn, moved, decision("reject_line", "wire", 5.0, 6.0, 4)], line_table([]), None)
    assert found.status == {1: "rejected"}  # numbers start from 1 without other lines
    assert found.apply(line_table([]))["length"].tolist() == [pytest.approx(4.123, abs=0.001)]


@pytest.mark.parametrize(
    ("action", "more", "message"),
    [
        ("cut_line", {"parts": [KERB]}, "parts must be 2 lists"),
        ("shape_line", {"parts": [KERB[:1]]}, "two or more vertices"),
        ("shape_line", {"parts": [[[0, 0, "a"], [1, 1, 1]]]}, "parts must be 1 lists"),
        ("join_lines", {"parts": [KERB]}, "other must be the line"),
        ("join_lines", {"parts": [KERB], "other": {"line": 2}}, "line, x, y must be numbers"),
    ],
)
def test_shapes_that_are_none_are_refused(action, more, message):
    with pytest.raises(ParameterError, match=message):
        decision(action, "kerb", **more)
