"""Several objects at once, order and search of the list, notes and attributes."""

import json

import geopandas
import pytest
from helpers.page_tab import click_at, decide, entries, reload, saved
from typer.testing import CliRunner

from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.review.corrections import open_corrections


def on_map(tab, x, y):
    """Return the place in the window of local coordinates on the map."""
    return tab.js(
        f"(() => {{ const [x, y] = page.map.at({x}, {y}); const b = document.querySelector('.map canvas').getBoundingClientRect();"
        " return [b.x + x, b.y + y]; })()"
    )


def place(tab, number):
    return tab.js(f"page.model.byId.get({number}).place")


def statuses(tab):
    return tab.js("[1, 2, 3, 4, 5].map((id) => page.model.status(id))")


def mark_rectangle(tab):
    """Drag a rectangle around the poles and the sign."""
    tab.js("page.map.fit()")
    tab.click("[data-shape='rectangle']")
    low, high = place(tab, 1), place(tab, 3)
    tab.drag(on_map(tab, low[0] - 3, low[1] + 2), on_map(tab, high[0] + 3, high[1] - 2))
    tab.click("[data-shape='rectangle']")


def choose(tab, selector, value):
    tab.js(
        f"(() => {{ const s = document.querySelector('{selector}'); s.value = {json.dumps(value)};"
        " for (const name of ['input', 'change']) s.dispatchEvent(new Event(name)); })()"
    )


def test_objects_in_a_rectangle_are_decided_and_taken_back_together(tab, server, folder):
    mark_rectangle(tab)
    assert tab.js("document.querySelector('#chosen').innerText").startswith("3 objects marked\n\n2 × pole, 1 × sign")
    assert tab.js("[...document.querySelectorAll('#queue input:checked')].length") == 3
    tab.press("r")
    assert saved(tab).startswith("3 objects rejected. Saved at")
    for again in (False, True):
        tab.until("page.model.status(1) === 'rejected' && !page.model.busy")
        assert (statuses(tab), tab.js("page.model.marked.size")) == (["rejected"] * 3 + ["", ""], 0)
        if not again:
            reload(tab, server)
    with open_corrections(folder) as store:
        assert len({decision.made for decision in store.current()}) == 1
    decide(tab, "u")
    assert tab.js("page.model.saved.text").startswith("Undone: 3 decisions, reject.")
    assert statuses(tab) == [""] * 5


def test_undo_takes_all_back_also_in_a_new_tab(tab, server):
    mark_rectangle(tab)
    decide(tab, "a")
    tab.js("sessionStorage.clear()")
    reload(tab, server)
    assert statuses(tab) == ["accepted"] * 3 + ["", ""]
    decide(tab, "u")
    assert statuses(tab) == [""] * 5


def test_a_lasso_marks_what_it_surrounds(tab):
    tab.js("page.map.fit()")
    tab.click("[data-shape='lasso']")
    (x, y, _), (a, b, _) = place(tab, 4), place(tab, 5)
    corners = [(x - 3, y - 3), (x + 3, y - 3), (x + 3, y + 3), (x - 3, y + 3)]
    first, *others = [on_map(tab, *corner) for corner in corners]
    tab.move(*first)
    tab.send("Input.dispatchMouseEvent", type="mousePressed", x=first[0], y=first[1], button="left", clickCount=1)
    for u, v in others:
        tab.send("Input.dispatchMouseEvent", type="mouseMoved", x=u, y=v, button="left")
    tab.send("Input.dispatchMouseEvent", type="mouseReleased", x=u, y=v, button="left", clickCount=1)
    assert tab.js("[...page.model.marked]") == [4]
    start, end = on_map(tab, a - 2, b - 2), on_map(tab, a + 2, b + 2)
    tab.click("[data-shape='rectangle']")
    for kind, (u, v) in (("mousePressed", start), ("mouseMoved", end), ("mouseReleased", end)):
        tab.send(
            "Input.dispatchMouseEvent", type=kind, x=u, y=v, button="left", clickCount=1, modifiers=8
        )  # Shift adds
    assert tab.js("[...page.model.marked]") == [4, 5]
    tab.press("Escape")
    assert tab.js("page.model.marked.size") == 0


def test_marks_of_the_list_change_the_kind_of_all(tab):
    choose(tab, "#order", "number")
    tab.click("#queue li[data-id='1'] input")
    box = tab.middle("#queue li[data-id='3'] input")
    for kind in ("mousePressed", "mouseReleased"):
        tab.send("Input.dispatchMouseEvent", type=kind, x=box[0], y=box[1], button="left", clickCount=1, modifiers=8)
    assert tab.js("[...page.model.marked]") == [1, 2, 3]
    tab.click("#queue li[data-id='2'] input")  # off again
    tab.js("page.model.select(2)")
    assert "pole 2" in tab.js("document.querySelector('#chosen').innerText")
    names = "[...document.querySelectorAll('#chosen button')].map((b) => b.dataset.action).filter(Boolean)"
    assert tab.js(names) == ["Accept all", "Reject all", "Other kind", "Unmark"]  # none that decides about pole 2
    tab.press("k")
    assert tab.js("document.querySelector('dialog[open] h2').textContent") == "What are the 2 marked objects?"
    tab.press("3")
    assert saved(tab).startswith("2 objects are tree now.")
    tab.until("!page.model.busy")
    assert tab.js("[1, 2, 3].map((id) => page.model.byId.get(id).kind)") == ["tree", "pole", "tree"]


def test_the_list_is_sorted_and_searched(tab):
    for order, numbers in (
        ("number", [1, 2, 3, 4, 5]), ("kind", [1, 2, 3, 4, 5]), ("lowest", [5, 3, 2, 1, 4]), ("highest", [4, 1, 2, 3, 5]),
    ):  # fmt: skip
        choose(tab, "#order", order)
        assert [int(text.split()[1]) for text in entries(tab)] == numbers, order
    tab.press("n")
    tab.press("n")
    assert tab.js("page.model.selected") == 1  # N follows the order of the list
    tab.press("/")
    tab.type("POLE")
    assert [text.split()[:2] for text in entries(tab)] == [["pole", "1"], ["pole", "2"]]
    assert tab.js("document.querySelector('#progress').textContent").startswith("2 found. ")
    tab.press("Enter")
    tab.press("n")
    decide(tab, "a")
    tab.press("/")
    for words, numbers in (
        ("accepted", [2]),
        ("4", [4]),
        ("pole 1", [1]),
        ("reaches ground", [4, 1, 2, 3, 5]),
        ("x y z", []),
    ):
        choose(tab, "#search", words)
        assert [int(text.split()[1]) for text in entries(tab)] == numbers, words
    tab.click("#mark-all")
    assert tab.js("page.model.marked.size") == 0
    tab.js("document.querySelector('#search').focus()")
    tab.press("Escape")
    assert len(entries(tab)) == 5


def typed(tab, selector, text):
    tab.click(selector)
    tab.js("document.activeElement.select()")
    tab.js("page.model.saved = { text: '', kind: '' }")
    tab.type(text)
    tab.press("Enter")


def test_a_note_and_attributes_are_typed_listed_and_taken_back(tab, server, folder):
    tab.js("page.actions.go(4)")
    typed(tab, "#note", "leans <b>north</b>, 1 a")
    assert saved(tab).startswith("tree 4 has a new note. Saved at")
    tab.until("!page.model.busy")
    tab.click("#attribute")
    tab.type("Condition of bark")
    typed(tab, "#value", "poor")
    assert saved(tab).startswith("tree 4 has a new note.")
    tab.until("!page.model.busy")
    for again in (False, True):
        tab.js("page.actions.go(4)")
        assert tab.js("document.querySelector('#note').value") == "leans <b>north</b>, 1 a"
        assert tab.js("document.querySelector('[data-attribute]').value") == "poor"
        choose(tab, "#search", "north BARK")
        [entry] = entries(tab)
        assert entry.endswith("leans <b>north</b>, 1 a; condition_of_bark: poor")
        choose(tab, "#search", "")
        if not again:
            reload(tab, server)
    with open_corrections(folder) as store:
        states = store.states()
        assert states.notes[4] == ("leans <b>north</b>, 1 a", {"condition_of_bark": "poor"})
        assert 4 not in states.of_objects  # a note is no decision about the object
    tab.js("document.activeElement.blur()")
    decide(tab, "u")
    tab.until("!document.querySelector('[data-attribute]')")
    assert tab.js("document.querySelector('#note').value") == "leans <b>north</b>, 1 a"


@pytest.mark.filterwarnings("ignore:'crs' was not provided:UserWarning")  # the survey has none
def test_notes_are_delivered_also_of_added_objects(tab, folder, tmp_path):
    tab.js("page.actions.go(2)")
    typed(tab, "#note", "paint is off")
    saved(tab)
    tab.until("!page.model.busy")
    tab.js("page.actions.add([12, 3, 0])")
    tab.until("document.querySelector('dialog[open]') !== null")
    tab.press("1")
    tab.until("page.model.objects.length === 6 && !page.model.busy")
    tab.js("page.actions.go(6)")
    tab.click("#attribute")
    tab.type("material")
    typed(tab, "#value", "steel")
    assert saved(tab).startswith("pole 6 has a new note.")
    tab.until("!page.model.busy")
    assert entries(tab)[0] == "pole 6 added material: steel"
    target = tmp_path / "checked.gpkg"
    done = CliRunner().invoke(app, ["export", str(folder), "-o", str(target)])
    assert done.exit_code == 0, done.output
    objects = geopandas.read_file(target, layer="objects").set_index("object_id")
    assert objects.loc[2, "note"] == "paint is off" and objects.loc[6, "attr_material"] == "steel"
    assert objects["note"].notna().sum() == objects["attr_material"].notna().sum() == 1


def test_typing_goes_on_while_another_tab_decides(tab, server, folder):
    from mlsroad_pipeline.review.corrections import Correction

    tab.js("page.actions.go(1)")
    tab.click("#note")
    tab.type("half a sen")
    with open_corrections(folder) as store:
        store.add(Correction("reject", 1), who="bob")
    tab.until("page.model.status(1) === 'rejected'", seconds=5)
    assert "rejected" in tab.js("document.querySelector('#chosen .state').textContent")
    tab.type("tence")
    assert tab.js("document.activeElement.id + document.activeElement.value") == "notehalf a sentence"
    tab.js("page.model.saved = { text: '', kind: '' }")
    click_at(tab, tab.middle("h1"))  # leaving the field saves it
    tab.until("document.activeElement === document.body || document.activeElement.id !== 'note'")
    tab.js("document.activeElement.blur()")
    saved(tab)
    with open_corrections(folder) as store:
        assert store.states().notes[1].text == "half a sentence"


def test_the_server_refuses_notes_and_groups_that_are_none(tab, folder):
    ask = (
        "fetch('/api/decide', {{method: 'POST', headers: {{'Content-Type': 'application/json'}}, body: JSON.stringify({0})}})"
        ".then(async (a) => [a.status, (await a.json()).error])"
    )
    for wanted, words in (
        ('{"action": "note", "object_id": 1, "payload": {"attributes": {"A b": "x"}}}', "is not the name of an attribute"),
        ('{"action": "note", "object_id": 1, "payload": {"note": "two\\nlines"}}', "printable"),
        ('{"all": [{"action": "accept", "object_id": 1}, {"action": "accept", "object_id": 99}]}', "no object 99"),
        ('{"all": []}', "all must be a list"),
    ):  # fmt: skip
        status, error = tab.js(ask.format(wanted))
        assert status == 409 and words in error
    tab.messages.clear()  # the refusals are in the console
    with open_corrections(folder) as store:
        assert store.current() == []
