"""Sections of a road: counts by hand, given sections, ends of the path, wrong tables."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.objects.sections import (
    equal_sections,
    line_lengths,
    part_of_path,
    section_table,
)
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

OBJECTS = pd.DataFrame(
    {
        "kind": ["pole", "pole", "sign", "tree", "vehicle", "tree"],
        "station": [-4.0, 99.9, 100.0, 250.0, 262.0, np.nan],
    }
)


def test_every_object_with_a_station_is_in_one_section():
    table = section_table(OBJECTS, 250.0)
    assert table["from_station"].tolist() == [0.0, 100.0, 200.0]
    assert table["length"].tolist() == [100.0, 100.0, 50.0]
    assert table[["pole", "sign", "vehicle", "tree"]].to_numpy().tolist() == [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1]]
    assert table["objects"].sum() == 5


@pytest.mark.parametrize(("length", "n"), [(0.0, 1), (99.0, 1), (100.0, 1), (100.1, 2), (300.0, 3)])
def test_sections_cover_the_road(length, n):
    table = equal_sections(length)
    assert len(table) == n and table["to_station"].iloc[-1] == length
    assert (table["from_station"].to_numpy()[1:] == table["to_station"].to_numpy()[:-1]).all()


def test_given_sections_may_leave_gaps_and_hold_nothing_beyond_them():
    given = pd.DataFrame({"section": ["bridge", "school"], "from_station": [0.0, 240.0], "to_station": [50.0, 255.0]})
    table = section_table(OBJECTS, 250.0, sections=given)
    assert table["section"].tolist() == ["bridge", "school"]
    assert table["objects"].tolist() == [0, 1]


def test_wrong_sections_are_named():
    with pytest.raises(DataError, match="to_station"):
        section_table(OBJECTS, 250.0, sections=pd.DataFrame({"section": [1], "from_station": [0.0]}))
    given = pd.DataFrame({"section": [7], "from_station": [10.0], "to_station": [5.0]})
    with pytest.raises(DataError, match=r"section 7 ends at 5\.0, before 10\.0"):
        section_table(OBJECTS, 250.0, sections=given)


def test_lengths_of_lines_by_section():
    path = Trajectory.from_positions(np.array([[0.0, 0, 0], [250, 0, 0]]))
    lines = [np.array([[90.0, 3, 0], [130, 3, 0]]), np.array([[-20.0, -3, 0], [10, -3, 0]]), np.zeros((1, 3))]
    table = equal_sections(path.length)
    assert line_lengths(lines, path, table).tolist() == [40.0, 30.0, 0.0]
    assert line_lengths([], path, table).tolist() == [0.0, 0.0, 0.0]


def test_parts_of_the_path_join_and_have_the_length_of_their_section():
    path = Trajectory.from_positions(np.array([[0.0, 0, 1], [60, 0, 1], [60, 0, 1], [60, 80, 3]]))
    table = equal_sections(path.length, step=50.0)
    parts = [part_of_path(path, low, high) for low, high in table[["from_station", "to_station"]].to_numpy()]
    for part, length in zip(parts, table["to_station"] - table["from_station"], strict=True):
        assert np.hypot(*np.diff(part[:, :2], axis=0).T).sum() == pytest.approx(length)
    for first, second in pairwise(parts):
        assert first[-1] == pytest.approx(second[0])
    assert part_of_path(path, 60.0, 61.0)[0] == pytest.approx([60.0, 0.0, 1.0])
