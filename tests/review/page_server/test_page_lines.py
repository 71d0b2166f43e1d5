"""Lines are reviewed like objects: filter, kind, cut, join, vertices, new lines; the delivery has the corrected ones."""

import geopandas
import numpy as np
import pytest
import shapely
from helpers.page_tab import click_at, decide, entries, local, place_of, reload, saved, settle
from typer.testing import CliRunner

from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.review.corrections import Correction, open_corrections

FIRST, SECOND = ((20.0, -4.7), (30.0, -4.6))  # places near the kerb
DRAWN = "page.cloud.marks.surveyed.children.length"


def above(tab, x, y):
    """Look from above at a place, so that a metre is 25 pixels or more."""
    place = local(x, y, 0, tab)
    tab.js(f"page.cloud.look({place}, 26, 0, Math.PI / 2 - 1e-3)")
    settle(tab)


def at_line(tab, number, share, x):
    """Return the place in the window of the point of a line at a world easting, from 500 on."""
    vertices = tab.js(f"page.model.lineOf({number}).vertices")
    y, z = (float(np.interp(500 + x, [v[0] for v in vertices], [v[axis] for v in vertices])) for axis in (1, 2))
    return place_of(tab, *local(x + share, y - 900, z - 12, tab))


def lines(tab):
    return tab.js(
        "page.model.lines.map((l) => [l.line_id, l.kind, Math.round(100 * l.length) / 100, page.model.lineStatus(l)])"
    )


def choose_line(tab, number):
    tab.js(f"page.actions.showList('lines'); page.model.selectLine(page.model.lineOf({number}))")


def cut_at(tab, number, x):
    choose_line(tab, number)
    above(tab, x, -4.7)
    tab.press("s")
    tab.js("page.model.saved = { text: '', kind: '' }")
    click_at(tab, at_line(tab, number, 0, x))
    text = saved(tab)
    tab.until("!page.model.busy")
    return text


@pytest.mark.filterwarnings("ignore:'crs' was not provided:UserWarning")  # the survey has none
def test_a_line_is_cut_a_part_rejected_and_the_rest_delivered(tab, server, folder, tmp_path):
    assert cut_at(tab, 1, 25.0).startswith("kerb 1 cut. Saved at")
    for again in (False, True):
        [first, second] = lines(tab)
        assert (first[0], first[3], second[0], second[3]) == (1, "cut", 2, "cut")
        assert first[2] == pytest.approx(30.0, abs=0.2) and first[2] + second[2] == pytest.approx(95.01, abs=0.02)
        tab.js("page.actions.showList('lines')")
        assert [entry.rsplit(" ", 2)[0] for entry in entries(tab)] == ["kerb 2 cut", "kerb 1 cut"]
        if not again:
            reload(tab, server)
    choose_line(tab, 2)
    decide(tab, "r")
    assert [row[3] for row in lines(tab)] == ["cut", "rejected"]
    targets = [tmp_path / name for name in ("lines.gpkg", "street.csv", "check.html")]
    done = CliRunner().invoke(app, ["export", str(folder), "-o", *map(str, targets)])
    assert done.exit_code == 0, done.output
    kerbs = geopandas.read_file(targets[0], layer="kerbs")
    assert kerbs["line_id"].tolist() == [1] and kerbs["length"][0] == pytest.approx(first[2], abs=0.01)
    assert kerbs["to_station"][0] == pytest.approx(30.0, abs=0.3)
    assert shapely.get_coordinates(kerbs.geometry[0])[-1] == pytest.approx([525.0, 895.33], abs=0.2)
    assert (tmp_path / "street_lines.csv").read_text(encoding="utf-8").count("\n") == 2
    assert "kerb" in targets[2].read_text(encoding="utf-8")
    decide(tab, "u")
    decide(tab, "u")
    tab.until("page.model.lines.length === 1 && page.model.lineStatus(page.model.lines[0]) === ''")


def test_parts_are_joined_again(tab):
    cut_at(tab, 1, 25.0)
    choose_line(tab, 1)
    above(tab, 27, -4.6)
    tab.press("m")
    tab.js("page.model.saved = { text: '', kind: '' }")
    click_at(tab, at_line(tab, 2, 0, 28.0))
    assert saved(tab).startswith("kerb 1 joined. Saved at")
    tab.until("!page.model.busy")
    [(number, kind, length, status)] = lines(tab)
    assert (number, kind, status) == (1, "kerb", "joined") and length == pytest.approx(95.01, abs=0.02)
    assert len(tab.js("page.model.lines[0].vertices")) == 4  # the place of the cut stays a vertex
    assert tab.js("page.model.line.line_id") == 1


def test_a_vertex_is_moved(tab, server):
    choose_line(tab, 1)
    above(tab, 40, -4.5)
    tab.press("b")
    assert "a cross" in tab.js("document.querySelector('.hint').textContent")
    click_at(tab, at_line(tab, 1, 4.0, 40.0))
    assert tab.js("document.querySelector('#saved').textContent").startswith("There is no vertex here")
    click_at(tab, at_line(tab, 1, 0, 40.0))
    assert tab.js("document.querySelector('.hint').textContent") == "Click the right place of the vertex."
    tab.js("page.model.saved = { text: '', kind: '' }")
    click_at(tab, place_of(tab, *local(41, -2, 0, tab)))
    assert saved(tab).startswith("kerb 1 moved. Saved at")
    for again in (False, True):
        tab.until("!page.model.busy && page.model.lineStatus(page.model.lines[0]) === 'moved'")
        vertex = tab.js("page.model.lines[0].vertices[1]")
        assert vertex[:2] == pytest.approx([541.0, 898.0], abs=0.15)  # the nearest point of the road
        if not again:
            reload(tab, server)


def test_a_line_is_drawn_named_and_gets_another_kind(tab, server):
    above(tab, 20, 0)
    tab.press("w")
    tab.press("Enter")
    assert "two vertices or more" in tab.js("document.querySelector('#saved').textContent")
    for x in (15, 20, 25):
        click_at(tab, place_of(tab, *local(x, 2, 0, tab)))
    tab.press("Enter")
    tab.until("document.querySelector('dialog[open]') !== null")
    assert "another class" not in tab.js("document.querySelector('dialog').innerText")
    tab.press("3")
    assert saved(tab).startswith("lane line added. Saved at")
    tab.until("!page.model.busy && page.model.lines.length === 2")
    [_, (number, kind, length, status)] = lines(tab)
    assert (number, kind, status) == (2, "lane_line", "added") and length == pytest.approx(10, abs=0.3)
    choose_line(tab, 2)
    tab.press("k")
    tab.until("document.querySelector('dialog[open]') !== null")
    tab.js("page.model.saved = { text: '', kind: '' }")
    tab.press("3")  # the kinds but its own: kerb, wire, stop line
    assert saved(tab).startswith("lane line 2 is stop line now. Saved at")
    for again in (False, True):
        tab.until("!page.model.busy && page.model.lines[1]?.kind === 'stop_line'")
        names = tab.js(
            "[...document.querySelectorAll('#lines li')].map((li) => li.innerText.replace(/\\s+/g, ' ').trim())"
        )
        assert [name.removesuffix(" only") for name in names] == ["kerb 1", "stop line 1"]
        if not again:
            reload(tab, server)


def test_lines_are_filtered_marked_and_decided_together(tab):
    cut_at(tab, 1, 25.0)
    tab.js("page.model.select(null); page.cloud.showAll()")
    assert tab.js(DRAWN) == 1
    tab.click("#lines li:first-child input")
    assert (tab.js(DRAWN), entries(tab)) == (0, [])
    tab.click("#lines li:first-child input")
    assert tab.js("[...document.querySelectorAll('#statuses li')].map((li) => li.innerText.split('\\n')[0])") == [
        "not looked at",
        "cut",
    ]
    tab.click("#mark-all")
    assert tab.js("document.querySelector('#marked').textContent") == "2 lines marked"
    decide(tab, "a")
    assert tab.js("page.model.saved.text").startswith("2 lines accepted.")
    assert [row[3] for row in lines(tab)] == ["accepted", "accepted"]
    decide(tab, "u")
    assert [row[3] for row in lines(tab)] == ["cut", "cut"]


def test_a_click_on_the_map_and_in_the_cloud_chooses_a_line(tab):
    tab.js("page.map.fit(); page.actions.showList('objects')")
    x, y, _ = local(45, -4.45, 0, tab)
    place = tab.js(
        f"(() => {{ const [x, y] = page.map.at({x}, {y}); const b = document.querySelector('.map canvas').getBoundingClientRect(); return [b.x + x, b.y + y]; }})()"
    )
    click_at(tab, place)
    assert tab.js("[page.model.line?.line_id, page.model.list]") == [1, "lines"]
    tab.js("page.model.select(null)")
    above(tab, 25, -4.6)
    click_at(tab, at_line(tab, 1, 0, 25.0))
    assert tab.js("page.model.line?.line_id") == 1
    click_at(tab, place_of(tab, *local(25, 3, 0, tab)))
    assert tab.js("page.model.line") is None


def test_lines_of_another_program_and_lost_ones(tab, folder):
    """A decision about a line that is not there has no effect and harms nothing."""
    with open_corrections(folder) as store:
        store.add(Correction("reject_line", kind="kerb", payload={"line": 1, "x": 700.0, "y": 895.0}), who="bob")
        parts = [[[500.0, 901.0, 12.0], [520.0, 901.0, 12.0]]]
        store.add(Correction("add_line", kind="wire", payload={"parts": parts}), who="bob")
    tab.until("page.model.lines.length === 2", seconds=5)
    assert lines(tab)[1] == [2, "wire", 20.0, "added"] and lines(tab)[0][3] == ""
