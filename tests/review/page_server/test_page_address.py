"""The address names the chosen object, line or place, the page opens there, and the served report links to it."""

import pandas as pd
import pytest
from helpers.page_tab import READY, errors, local

from mlsroad_pipeline.inventory_files.geopackage import read_geopackage
from mlsroad_pipeline.label.report import _line_table
from mlsroad_pipeline.reporting.clouds.pictures import map_frame
from mlsroad_pipeline.reporting.html.objects import object_map_section, object_table_section
from mlsroad_pipeline.reporting.html.report import table_section

ADDRESS = "location.hash"


def opened_at(tab, server, fragment):
    """Load the page anew at an address."""
    tab.open("about:blank")
    tab.open(f"http://127.0.0.1:{server.port}/{fragment}", width=1200, height=800)
    tab.until(READY)
    tab.until("page.model.queued && page.model.counted")


def target(tab):
    return [round(value, 1) for value in tab.js("page.cloud.target")]


def test_the_address_follows_what_is_chosen(tab):
    assert tab.js(ADDRESS) == ""
    tab.press("n")
    assert tab.js(ADDRESS) == f"#object={tab.js('page.model.selected')}"
    tab.js("page.actions.showList('lines'); page.actions.lines.go(page.model.lineOf(1))")
    assert tab.js(ADDRESS) == "#line=1"
    tab.js("page.actions.showList('groups')")
    tab.until("page.model.groups.length > 0")
    tab.press("n")
    tab.until("page.model.group !== null")
    place = [float(value) for value in tab.js(ADDRESS).removeprefix("#place=").split(",")]
    assert local(place[0] - 500, place[1] - 900, place[2] - 12, tab) == pytest.approx(
        tab.js("page.model.group.place"), abs=0.01
    )
    tab.js("page.model.select(null)")
    assert tab.js(ADDRESS) == ""


def test_the_page_opens_at_an_object_a_line_and_a_place(tab, server):
    opened_at(tab, server, "#object=4")
    assert tab.js("page.model.selected") == 4 and tab.js(ADDRESS) == "#object=4"
    assert target(tab)[:2] == pytest.approx(tab.js("page.model.byId.get(4).place")[:2], abs=0.1)
    opened_at(tab, server, "#line=1")
    assert tab.js("page.model.line.line_id") == 1 and tab.js("page.model.list") == "lines"
    opened_at(tab, server, "#place=512.5,903,12.5")
    assert target(tab) == pytest.approx(local(12.5, 3, 0.5, tab), abs=0.1)
    assert tab.js(ADDRESS) == "#place=512.5,903,12.5" and tab.js("page.model.selected") is None


def test_a_changed_address_goes_there_and_a_wrong_one_says_so(tab):
    tab.js("location.hash = '#object=2'")
    tab.until("page.model.selected === 2")
    tab.js("location.hash = '#place=520,905'")
    tab.until("page.model.selected === null")
    assert target(tab)[:2] == pytest.approx(local(20, 5, 0, tab)[:2], abs=0.1)
    for wrong, named in (("#object=99", "object 99"), ("#line=7", "line 7"), ("#place=a,b", "place a,b")):
        tab.js(f"location.hash = '{wrong}'")
        tab.until(f"page.model.saved.text.startsWith('The survey has no {named}:')")
    assert tab.js("page.model.selected") is None


@pytest.fixture
def report(folder):
    """Put a report with a map, tables of objects and lines, and places into the folder; put the old one back."""
    path = folder / "report.html"
    before, inventory = path.read_bytes(), read_geopackage(folder / "inventory.gpkg")
    objects = inventory.objects
    frame = map_frame(objects[["x", "y"]].to_numpy(), objects[["x", "y"]].to_numpy())
    counts = objects["kind"].value_counts().to_dict()
    names = {name: name for name in ("object_id", "class", "kind", "score")}
    doubts = pd.DataFrame({"reason": ["low"], "x": [1520.123], "y": [905.25], "z": [12.5]})
    sections = [
        object_map_section("Map", objects, frame, counts),
        *_line_table(inventory.lines.assign(status="")),
        table_section("Places to check", doubts),
        object_table_section(
            "Objects", objects, pd.DataFrame({"objects": [5]}), names, frame.place(objects[["x", "y"]])
        ),
    ]
    path.write_text("<meta charset=utf-8>" + "".join(section.body for section in sections), encoding="utf-8")
    yield path
    path.write_bytes(before)


LINKS = "[...document.querySelectorAll('a')].map((link) => link.getAttribute('href'))"


def test_rows_of_the_served_report_lead_to_the_page(tab, server, report):
    tab.open(f"http://127.0.0.1:{server.port}/report", width=1200, height=800)
    tab.until("document.querySelectorAll('#objects a').length === 5")
    links = tab.js(LINKS)
    assert {"/go?object=3", "/go?line=1", "/go?place=1520.12,905.2,12.5"} <= set(links)
    tab.click("a[href='/go?object=3']")
    tab.until("location.pathname === '/' && location.hash === '#object=3'")
    tab.until("window.page?.model.selected === 3")
    assert errors(tab) == ([], [])
    tab.open(report)  # as a file it has no page to lead to
    tab.until("document.querySelectorAll('#objects button').length > 5")
    assert tab.js(LINKS) == []
    tab.messages.clear()
    tab.addresses.clear()


def test_a_link_of_another_page_gets_the_way_to_the_page_and_nothing_else(server):
    foreign = {"Sec-Fetch-Site": "cross-site"}
    kept, server.cookie = server.cookie, None
    try:
        for query, way in (("object=3", "#object=3"), ("x=1", "#"), ("object=1%22", "#"), ("place=1,2'onload", "#")):
            status, headers, content = server.ask(f"/go?{query}", headers=foreign)
            assert (status, "set-cookie" in headers) == (200, False) and f'url=/{way}"'.encode() in content
        assert server.ask("/go?object=3", headers={**foreign, "Host": "evil.example"})[0] == 403
        assert server.ask("/go?object=3", headers={"Origin": "http://evil.example"})[0] == 403
        assert server.ask("/", headers=foreign)[0] == 403 and server.ask("/")[0] == 401
    finally:
        server.cookie = kept
