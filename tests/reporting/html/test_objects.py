"""Map and table of objects in a real browser: pointer, keys, filters, print, odd names, none and 5,000 objects."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from helpers.browser import browser_page

from mlsroad_pipeline.reporting.clouds.pictures import map_frame, overview_picture
from mlsroad_pipeline.reporting.html.objects import (
    MOST_OBJECTS,
    object_map_section,
    object_table_section,
    shown_objects,
)
from mlsroad_pipeline.reporting.html.report import Picture, build_report, gallery_section

EVIL = "</script><script>document.title='broken'</script><b>&\"'"
NAMES = {
    "object_id": "Object",
    "class": "Class",
    "kind": "Kind",
    "score": "Score",
    "x": "Easting [m]",
    "height": "Height [m]",
}

MANY = [f"measure_{n}" for n in range(40)]
NAMES |= {name: f"Measure {name}" for name in MANY}


def objects_of(n, kinds=("pole", "sign", "tree", "vehicle")):
    rng = np.random.default_rng(1)
    kind = np.array(kinds)[np.arange(n) % len(kinds)]
    return pd.DataFrame(
        {
            "object_id": np.arange(n) + 1,
            "class": [EVIL if k == 0 else f"{name} class" for k, name in enumerate(kind)],
            "kind": kind,
            "score": np.round(rng.uniform(0, 1, n), 3),
            "x": 389000 + np.round(rng.uniform(0, 200, n), 2),
            "y": 5819000 + np.round(rng.uniform(0, 40, n), 2),
            "height": np.where(np.arange(n) % 5 == 0, np.nan, 3.25),
        }
    ).astype({"class": str, "kind": str})


def page_of(objects):
    path = np.column_stack([np.linspace(389000, 389200, 50), np.full(50, 5819020.0)])
    frame = map_frame(np.zeros((0, 2)), np.concatenate([path, objects[["x", "y"]].to_numpy()]))
    shown = shown_objects(objects)
    counts = {str(k): int(v) for k, v in objects["kind"].value_counts().sort_index().items()}
    total = objects.groupby(["kind", "class"]).size().rename("objects").reset_index()
    points = np.column_stack([path, np.zeros(50)])
    palette = np.array([[200, 30, 20], [214, 218, 225]], np.uint8)
    background = overview_picture([(points, np.zeros(50, np.int16))], palette, frame)
    picture = Picture(np.zeros((40, 60, 3), np.uint8), EVIL)
    sections = [
        object_map_section("Map", shown, frame, counts, path, background),
        gallery_section("Objects", {EVIL: [picture]}),
        object_table_section(
            "Inventory", shown, total, NAMES, frame.place(shown[["x", "y"]].to_numpy()), "inventory.gpkg"
        ),
    ]
    return build_report(sections, title="t", subtitle=EVIL)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with browser_page(tmp_path_factory.mktemp("browser")) as page:
        yield page


@pytest.fixture
def opened(browser, tmp_path):
    def open_page(objects, **size):
        place = tmp_path / "report.html"
        place.write_text(page_of(objects), encoding="utf-8")
        browser.open(place, **size)
        return browser

    yield open_page
    assert browser.messages == []
    assert [a for a in browser.addresses if not a.startswith(("file:", "data:"))] == []


def test_pointing_at_an_object_shows_its_measures(opened):
    page = opened(objects_of(12))
    x, y = page.middle('#map path[data-i="3"]')
    page.move(x + 3, y)
    row = shown_objects(objects_of(12)).iloc[3]
    said = page.js("document.getElementById('object-details').innerText")
    assert said.startswith(f"{row['object_id']} {row['class']}")
    assert f"{row['score']:g}" in said
    assert page.js("document.querySelectorAll('#map .chosen').length") == 1


def test_the_legend_hides_a_kind_with_a_click_and_with_the_keyboard(opened):
    page = opened(objects_of(12))
    page.click('input[data-kind="1"]')
    visible = "[...document.querySelectorAll('#map g.o')].map(g => getComputedStyle(g).display !== 'none')"
    assert page.js(visible) == [True, False, True, True]
    page.js("document.querySelector('input[data-kind=\"1\"]').focus()")
    page.press(" ")
    assert page.js(visible) == [True] * 4
    page.click('input[data-layer="cloud"]')
    assert page.js("getComputedStyle(document.querySelector('#map image')).display") == "none"


def test_keys_and_buttons_zoom_and_the_scale_bar_follows(opened):
    page = opened(objects_of(12))

    def metres_per_pixel():
        return page.js(
            "document.querySelector('#map').viewBox.baseVal.width / document.querySelector('#map').clientWidth"
        )

    def bar():
        text, width = page.js(
            "(e => [e.textContent, e.getBoundingClientRect().width])(document.querySelector('.scale'))"
        )
        return float(text.split()[0]) * (1000 if "km" in text else 1) / width

    before = metres_per_pixel()
    assert bar() == pytest.approx(before, rel=0.05)
    page.click('button[data-zoom="1.6"]')
    page.js("document.getElementById('map').focus()")
    page.press("+")
    assert metres_per_pixel() == pytest.approx(before / 2.56, rel=0.01)
    assert bar() == pytest.approx(before / 2.56, rel=0.05)
    page.press("ArrowRight")
    assert page.js("document.querySelector('#map').viewBox.baseVal.x") > 0
    page.press("0")
    assert metres_per_pixel() == pytest.approx(before)


def test_the_table_is_sorted_filtered_and_leads_to_the_map(opened):
    objects = objects_of(300)
    page = opened(objects)

    def column(k):
        return page.js(f"[...document.querySelectorAll('#objects tbody tr')].map(r => r.cells[{k}].innerText)")

    assert [int(n) for n in column(0)] == shown_objects(objects)["object_id"].tolist()[:100]
    page.js("document.querySelector('[name=kind]').value = 'tree'; document.querySelector('[name=low]').value = 0.5")
    page.js("document.getElementById('object-filters').dispatchEvent(new Event('input'))")
    wanted = objects[(objects["kind"] == "tree") & (objects["score"] >= 0.5)]
    assert sorted(map(int, column(0))) == wanted["object_id"].tolist()
    page.click('#objects thead button[data-column="3"]')
    assert [float(s) for s in column(3)] == pytest.approx(sorted(wanted["score"]))
    page.click("#objects tbody tr td button")
    chosen = page.js("document.getElementById('object-details').innerText").split()[0]
    assert chosen == column(0)[0]
    assert page.js("document.getElementById('map').viewBox.baseVal.width") <= 60
    page.js("document.querySelector('[name=kind]').value = ''; document.querySelector('[name=low]').value = 0")
    page.js("document.querySelector('[name=text]').focus()")
    page.type("</script>")
    assert column(1) == [EVIL]


def test_nothing_of_the_survey_becomes_html(opened):
    page = opened(objects_of(3))
    assert page.js("document.title") == "t"
    assert page.js("document.querySelectorAll('td b, figcaption b, h3 b').length") == 0


def test_every_picture_and_control_has_a_name(opened):
    page = opened(objects_of(12))
    assert page.js("[...document.images].every(i => i.alt)")
    assert page.js("[...document.querySelectorAll('button')].every(b => b.innerText || b.ariaLabel || b.hidden)")
    assert page.js("[...document.querySelectorAll('input, select')].every(i => i.labels.length)")
    assert page.js("[...document.querySelectorAll('svg')].every(s => s.getAttribute('aria-label'))")


def test_without_objects_the_map_has_the_path(opened):
    page = opened(objects_of(0))
    assert page.js("document.body.innerText").count("No objects were found.") == 2
    assert page.js("document.querySelector('#map .path').getBoundingClientRect().width") > 500
    page.click('input[data-layer="path"]')
    assert page.js("getComputedStyle(document.querySelector('#map .path')).display") == "none"


def test_many_objects_are_shown_up_to_a_limit_and_fit_the_window(opened):
    objects = objects_of(MOST_OBJECTS + 1000)
    page = opened(objects, width=700)
    assert page.js("document.querySelectorAll('#map g.o path').length") == MOST_OBJECTS
    assert "5000 of 6000 objects" in page.js("document.body.innerText")
    assert page.js("document.documentElement.scrollWidth") <= 700
    shown = shown_objects(objects)
    for kind, rows in objects.groupby("kind"):
        assert set(shown[shown["kind"] == kind]["score"]) == set(rows["score"].nlargest(MOST_OBJECTS // 4))


def test_it_prints_on_few_pages_without_the_controls(opened):
    page = opened(objects_of(40).assign(**{name: 389123.456 for name in MANY}), width=720)
    assert len(re.findall(rb"/Type\s*/Page\b", page.pdf())) <= 5
    page.send("Emulation.setEmulatedMedia", media="print")
    hidden = [".filters", "nav", ".map-buttons"]
    assert (
        page.js(f"{json.dumps(hidden)}.map(s => getComputedStyle(document.querySelector(s)).display)") == ["none"] * 3
    )
    assert page.js("document.documentElement.scrollWidth") <= 720
    page.send("Emulation.setEmulatedMedia", media="")


def test_the_map_is_turned_along_a_road_and_its_arrow_points_north():
    road = np.column_stack([np.linspace(0, 100, 50), np.linspace(0, 100, 50)])
    frame = map_frame(road, np.zeros((0, 2)))
    assert frame.size[1] < 10
    assert frame.size[0] > 130
    turn = np.radians(frame.north)
    step = frame.place(np.array([[0.0, 1.0]])) - frame.place(np.zeros((1, 2)))
    assert step[0] == pytest.approx([np.sin(turn), -np.cos(turn)])
    assert map_frame(np.array([[0.0, 0], [10, 10], [0, 10], [10, 0]]), np.zeros((0, 2))).north == 0.0


def test_the_picture_of_a_survey_has_the_class_of_the_highest_point():
    frame = map_frame(np.array([[0.0, 0.0], [10.0, 10.0]]), np.zeros((0, 2)))
    palette = np.array([[255, 0, 0], [0, 0, 255], [214, 218, 225]], np.uint8)
    low, high = np.array([[5.0, 5.0, 0.0], [2.0, 2.0, 0.0]]), np.array([[5.0, 5.0, 3.0]])
    parts = [(low, np.array([0, -1])), (high, np.array([1]))]
    picture = overview_picture(parts, palette, frame)
    assert np.array_equal(picture, overview_picture(parts[::-1], palette, frame))
    pixel = frame.size[0] / picture.shape[1]
    column, row = (frame.place(high[:, :2])[0] / pixel).astype(int)
    assert picture[row, column].tolist() == [0, 0, 255]
    assert {tuple(c) for c in picture.reshape(-1, 3)} == {(255, 255, 255), (0, 0, 255), (214, 218, 225)}
