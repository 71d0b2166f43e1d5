"""Page of a comparison: states on the map and in the table, also of nothing."""

import numpy as np
import pandas as pd
import pytest

from mlsroad_pipeline.algorithms.core.palette import STATE_COLOURS
from mlsroad_pipeline.reporting.changes_page import ChangesMap, changes_page
from mlsroad_pipeline.reporting.clouds.pictures import map_frame

TABLE = pd.DataFrame(
    {
        "kind": ["pole", "tree", "tree", "sign<b>"],
        "state": ["gone", "unchanged", "unchanged", "new"],
        "x": [0.0, 5, 9, 12],
        "y": [0.0, 1, 2, 3],
        "changes": ["", "", "", "height 2.0 to 3.0 m"],
    }
)


def page_of(table):
    frame = map_frame(np.zeros((0, 2)), np.array([[0.0, 0], [12, 3]]))
    drawn = ChangesMap(frame, None, np.array([[0.0, 0], [12, 0]]))
    facts = {"offset": "none"}
    return changes_page(
        table, {"changes": "Changes"}, drawn, title="a & b", subtitle="x", facts=facts, layers="changes.gpkg"
    )


def test_states_have_their_colours_and_changes_come_first():
    page = page_of(TABLE)
    assert all(STATE_COLOURS[state] in page for state in TABLE["state"])
    assert page.count("data-i=") == 4 + page.count('data-i="${i}"') and "sign<b>" not in page and "a &amp; b" in page
    rows = page[page.index('<table id="objects">') :]
    assert rows.index("height 2.0 to 3.0 m") < rows.index("unchanged")
    assert "Score from" not in page and "Sorted by state" in page


def test_nothing_to_compare_is_a_page():
    assert "No objects were found." in page_of(TABLE.iloc[:0])


@pytest.mark.parametrize("state", sorted(STATE_COLOURS))
def test_every_state_has_a_colour(state):
    assert STATE_COLOURS[state] in page_of(TABLE.assign(state=state))
