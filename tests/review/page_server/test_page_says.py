"""The page says at once, and after a reload, what decisions have changed; two tabs follow each other."""

import io
import re
import shutil

import numpy as np
import pytest
from helpers.inventories import planted_inventory
from helpers.page_output import EVIL, FILES
from helpers.page_tab import POLE, click_at, decide, entries, errors, local, pixels, reload, saved, settle
from PIL import Image

from mlsroad_pipeline.algorithms.core.palette import COLOURS, KIND_COLOURS, LINE_COLOURS, class_palette, rgb_to_hex
from mlsroad_pipeline.reporting.clouds.pictures import map_frame
from mlsroad_pipeline.reporting.html.objects import object_map_section
from mlsroad_pipeline.reporting.html.report import scene_section
from mlsroad_pipeline.review.corrections import Correction, open_corrections

GREEN = tuple(bytes.fromhex(COLOURS["tree"][1:]))


def counts(tab):
    """Return the numbers behind the classes, kinds and statuses at the left, and the total at the top."""
    rows = "[...document.querySelectorAll('#{0} li')].map((li) => [li.querySelector('.name').textContent, li.querySelector('b').textContent])"
    found = {part: dict(tab.js(rows.format(part))) for part in ("classes", "kinds", "statuses")}
    return found | {"total": tab.js("document.querySelector('#total').textContent").split(", ")[1]}


def boxes(tab, number):
    """Return the corners of the box that is drawn around a chosen object."""
    tab.js(f"page.model.select({number})")
    return tab.js(
        "(() => { const { box } = page.cloud.marks; box.geometry.computeBoundingBox(); const b = box.geometry.boundingBox;"
        " return box.visible ? [b.min.toArray(), b.max.toArray()].map((c) => c.map((v) => Math.round(100 * v) / 100)) : null; })()"
    )


def test_an_added_object_is_in_list_counts_marks_and_map_and_can_be_taken_back(tab, server):
    tab.js(f"page.cloud.look({local(25, 0, 1, tab)}, 14, 0, 1.2)")
    settle(tab)
    tab.press("i")
    click_at(tab, (560, 420))
    tab.until("document.querySelector('dialog[open]') !== null")
    tab.press("1")
    assert saved(tab).startswith("pole added. Saved at")
    for again in (False, True):
        tab.until("page.model.objects.length === 6")
        assert entries(tab)[0] == "pole 6 added"
        assert (counts(tab)["kinds"]["pole"], counts(tab)["statuses"]["added"]) == ("3", "1")
        assert counts(tab)["total"] == "6 objects"
        assert tab.js("page.cloud.marks.tops.map((top) => top.id)") == [1, 2, 3, 4, 5, 6]
        assert boxes(tab, 6) is not None
        if not again:
            reload(tab, server)
    assert "Take back" in tab.js("document.querySelector('#chosen').innerText")
    tab.press("a")
    assert tab.js("page.model.saved.text") == "A decision made pole 6: take it back to change it."
    tab.click("[data-action='Take back']")
    tab.until("page.model.objects.length === 5 && !page.model.busy")
    assert entries(tab)[0] != "pole 6 added"


def test_both_parts_of_a_split_object_have_a_box_and_an_entry(tab, server):
    whole = boxes(tab, 5)
    tab.js("page.actions.go(5)")
    base = local(30, -3, 0, tab)
    with_places = (
        f"page.actions.places = [[{base[0] - 0.5}, {base[1]}, {base[2]}], [{base[0] + 0.5}, {base[1]}, {base[2]}]]"
    )
    tab.press("s")
    tab.js(with_places)
    tab.press("Enter")
    assert saved(tab).startswith("vehicle 5 split.")
    for again in (False, True):
        tab.until("page.model.objects.length === 6")
        first, second = boxes(tab, 5), boxes(tab, 6)
        assert first[1][0] - first[0][0] == pytest.approx(whole[1][0] - whole[0][0] - 1.0, abs=0.11)
        assert first[0][0] == pytest.approx(whole[0][0], abs=0.02) and second[1][0] == pytest.approx(
            whole[1][0], abs=0.02
        )
        assert entries(tab)[0] == "vehicle 6 split" and counts(tab)["kinds"]["vehicle"] == "2"
        assert tab.js(f"[-0.4, 0.4].map((d) => page.model.objectAt(5, [{base[0]} + d, {base[1]}, 0]))") == [5, 6]
        if not again:
            reload(tab, server)


def test_another_kind_changes_list_counts_colour_and_goes_on_to_the_next(tab, server):
    tab.js(f"page.cloud.look({local(20, 5, 4, tab)}, 14, 0, 0.6)")
    settle(tab)
    before, points = counts(tab), [pixels(tab, GREEN), pixels(tab, POLE)]
    assert points[0] > 1000
    tab.js("page.model.queue.sort((a, b) => (b.object_id === 4) - (a.object_id === 4)); page.actions.go(4)")
    following = tab.js("page.model.queue[1].object_id")
    tab.press("k")
    tab.until("document.querySelector('dialog[open]') !== null")
    tab.press("1")
    assert saved(tab).startswith("tree 4 is pole now. Saved at")
    tab.until(f"!page.model.busy && page.model.selected === {following}")
    for again in (False, True):
        tab.until("page.model.status(4) === 'changed'")
        tab.js(f"page.model.select(null); page.cloud.look({local(20, 5, 4, tab)}, 14, 0, 0.6)")
        settle(tab)
        now = counts(tab)
        assert (before["kinds"]["pole"], now["kinds"]["pole"]) == ("2", "3") and "tree" not in now["kinds"]
        assert now["statuses"]["changed"] == "1"
        assert (before["classes"][EVIL], before["classes"]["pole"]) == ("8,000", "8,000")
        assert (now["classes"][EVIL], now["classes"]["pole"]) == ("4,000", "12 k")  # the other crown is no object
        assert pixels(tab, GREEN) < 0.1 * points[0] and pixels(tab, POLE) > points[1] + 0.8 * points[0]
        tab.click("[data-list='decided']")
        assert entries(tab) == ["pole 4 changed to pole ann"]
        if not again:
            reload(tab, server)


def test_a_stroke_names_points_and_classes_and_the_counts_follow(tab, server, folder):
    tab.js(f"page.cloud.look({local(25, 0, 1, tab)}, 14, 0, 1.2); page.model.select(null)")
    settle(tab)
    road = tab.js("page.model.classCounts.get(11)")
    tab.press("p")
    tab.js("page.model.brush.class = 'wire'; page.model.saved = { text: '', kind: '' }")
    tab.drag((520, 420), (600, 440))
    text = saved(tab)
    n = int(re.match(r"([\d,]+) points: road to wire\. Saved at .* ms\)\. Undo U$", text)[1].replace(",", ""))
    for again in (False, True):
        tab.until(f"page.model.classCounts.get(14) === {n}")
        assert tab.js("page.model.classCounts.get(11)") == road - n
        assert counts(tab)["classes"]["wire"] == f"{n:,}"
        if not again:
            reload(tab, server)
    decide(tab, "u")
    tab.until(f"page.model.classCounts.get(11) === {road} && !page.model.classCounts.has(14)")


def test_undo_returns_to_the_object(tab):
    tab.js("page.actions.go(page.model.queue[0].object_id)")
    first, second = tab.js("page.model.queue.slice(0, 2).map((item) => item.object_id)")
    decide(tab, "a")
    tab.until(f"page.model.selected === {second}")
    decide(tab, "u")
    tab.until(f"page.model.selected === {first} && page.model.status({first}) === ''")
    assert re.match(rf"Undone: accept {first}\.", tab.js("page.model.saved.text"))


def test_messages_go_when_they_hold_no_more(tab):
    tab.js("page.model.select(null)")
    tab.press("a")
    assert tab.js("document.querySelector('#saved').textContent").startswith("Choose an object first")
    tab.js("page.model.select(1)")
    assert tab.js("document.querySelector('#saved').textContent") == ""
    tab.press("s")
    tab.press("Enter")
    assert "two bases or more" in tab.js("document.querySelector('#saved').textContent")
    tab.press("v")
    assert tab.js("document.querySelector('#saved').textContent") == ""


def test_a_click_of_a_split_that_hits_nothing_says_so(tab):
    tab.js(f"page.actions.go(1); page.cloud.look({local(0, 0, 3, tab)}, 10, 0, 0.05)")
    settle(tab)
    tab.press("s")
    click_at(tab, (700, 200))  # sky
    assert tab.js("document.querySelector('#saved').textContent") == "There is no point here: click on a point."
    assert tab.js("page.actions.places.length") == 0
    tab.press("v")
    assert tab.js("document.querySelector('#saved').textContent") == ""


def test_next_waits_for_the_list(tab):
    tab.js("page.model.select(null); window.kept = page.model.queue; page.model.queue = []; page.model.queued = false")
    tab.press("n")
    assert tab.js("document.querySelector('#saved').textContent") == "The list is being read."
    assert tab.js("page.model.selected") is None
    tab.js("page.model.queued = true; page.model.set('queue', 'queue', window.kept)")
    assert tab.js("[page.model.selected, document.querySelector('#saved').textContent]") == [
        tab.js("page.model.queue[0].object_id"), "",
    ]  # fmt: skip


def test_choosing_in_the_list_scrolls_to_the_buttons(tab):
    tab.js("page.actions.go(1)")
    tab.send("Emulation.setDeviceMetricsOverride", width=1200, height=420, deviceScaleFactor=1, mobile=False)
    tab.until("innerHeight === 420")
    tab.click("#queue li:last-child button")
    seen = "(() => { const b = document.querySelector('[data-action=Accept]').getBoundingClientRect(); const p = document.querySelector('aside.right').getBoundingClientRect(); return b.top >= p.top && b.bottom <= p.bottom; })()"
    tab.until(seen, seconds=5)
    tab.send("Emulation.setDeviceMetricsOverride", width=1200, height=800, deviceScaleFactor=1, mobile=False)


def test_two_tabs_see_each_other_and_each_undoes_its_own(tab, server, folder):
    with tab.another() as other:
        reload(other, server)
        follow_each_other(tab, other, folder)


def follow_each_other(tab, other, folder):
    tab.js("page.actions.go(1)")
    decide(tab, "a")
    other.until("page.model.status(1) === 'accepted'", seconds=4)
    other.js("page.actions.go(2)")
    decide(other, "r")
    tab.until("page.model.status(2) === 'rejected'", seconds=4)
    assert counts(tab)["statuses"] == counts(other)["statuses"]
    decide(tab, "u")  # its own, not the last one
    other.until("page.model.status(1) === '' && page.model.status(2) === 'rejected'", seconds=4)
    decide(tab, "u")
    assert tab.js("page.model.saved.text").startswith("Nothing of yours to undo")
    with open_corrections(folder) as store:
        payload = {"file": FILES[0], "points": list(range(500)), "class": "wire", "n_points": 68_000}
        store.add(Correction("paint", payload=payload), who="bob")  # another program
    for page in (tab, other):
        page.until("page.model.painted.size === 500 && page.model.classCounts.get(14) === 500", seconds=4)
    decide(other, "u")
    tab.until("page.model.status(2) === ''", seconds=4)
    assert errors(other) == ([], [])


def test_lines_are_listed_accepted_and_rejected(tab, server, folder):
    tab.click("[data-list='lines']")
    assert entries(tab) == ["kerb 1 95 m"]
    drawn = "page.cloud.marks.surveyed.children.length"
    tab.press("n")
    assert "kerb 1" in tab.js("document.querySelector('#chosen').innerText") and tab.js(drawn) == 1
    tab.press("r")
    assert saved(tab).startswith("kerb 1 rejected.")
    for again in (False, True):
        tab.until("page.model.lineStates[1] === 'rejected' && !page.model.busy")
        tab.js("page.model.select(null)")
        assert tab.js(drawn) == 0
        tab.click("[data-list='lines']")
        assert entries(tab) == ["kerb 1 rejected 95 m"]
        if not again:
            reload(tab, server)
    with open_corrections(folder) as store:
        assert [decision.correction.action for decision in store.current()] == ["reject_line"]
    decide(tab, "u")
    tab.until("page.model.line?.line_id === 1 && page.model.lineStates[1] === undefined")
    assert tab.js(drawn) == 1


def test_a_sample_is_marked_and_its_counts_are_estimates(tab, folder, tmp_path):
    assert tab.js("document.querySelector('#estimated').hidden")
    tab.until("!document.querySelector('#shown').textContent.includes('(a sample)')", seconds=5)
    from mlsroad_pipeline.review.page_server.export import export_page
    from mlsroad_pipeline.review.page_server.output_folder import OutputFolder

    whole = tmp_path / "without_tiles"
    shutil.copytree(folder, whole, ignore=shutil.ignore_patterns(".page"))
    target = export_page(OutputFolder.find(whole), tmp_path / "page.html", most=50_000)
    with tab.another() as sample:
        sample.open(target, width=1200, height=800)
        sample.until("window.page?.cloud.shown > 40000")
        assert "points drawn (a sample)" in sample.js("document.querySelector('#shown').textContent")
        assert sample.js("document.querySelector('#estimated').checkVisibility()")


def test_page_map_pictures_and_report_have_one_legend(tab):
    page = tab.js("page.model.survey.colours")
    assert (page["kinds"], page["lines"]) == (KIND_COLOURS, LINE_COLOURS)
    swatches = dict(
        tab.js(
            "[...document.querySelectorAll('#kinds li, #classes li')].map((li) => [li.querySelector('.name').textContent, li.querySelector('.swatch').style.background])"
        )
    )
    named = {name: f"rgb({', '.join(str(c) for c in bytes.fromhex(KIND_COLOURS[name][1:]))})" for name in KIND_COLOURS}
    assert {name: swatches[name] for name in named} == named
    names = ("road", "building", "pole", "sign", "tree", "vehicle", "low vegetation", "wire")
    pictures = dict(zip(names, map(rgb_to_hex, class_palette(names)), strict=False))
    codes = {
        "road": 11,
        "building": 6,
        "pole": 64,
        "sign": 65,
        "tree": 5,
        "vehicle": 66,
        "low vegetation": 3,
        "wire": 14,
    }
    assert {name: page["classes"][str(code)] for name, code in codes.items()} == pictures
    inventory = planted_inventory()
    frame = map_frame(np.zeros((0, 2)), inventory.objects[["x", "y"]].to_numpy())
    lines = {kind: [np.zeros((2, 2))] for kind in LINE_COLOURS}
    report = object_map_section("Map", inventory.objects, frame, {kind: 1 for kind in KIND_COLOURS}, lines=lines).body
    for kind, colour in KIND_COLOURS.items():
        assert f'style="background:{colour}"></i>{kind}' in report
    for kind, colour in LINE_COLOURS.items():
        assert f"#map .{kind}s{{stroke:{colour}}}" in report
    shown = scene_section(
        "Pictures", {"a": np.zeros((2, 2, 3), np.uint8)}, dict(zip(names, class_palette(names), strict=False))
    ).body
    assert all(f'<i style="background:{pictures[kind]}"></i>{kind}' in shown for kind in KIND_COLOURS)
    assert all(pictures[kind] == colour for kind, colour in KIND_COLOURS.items())


def test_the_map_of_the_page_draws_kinds_in_their_colours(tab):
    tab.js("page.map.fit()")
    settle(tab)
    box = tab.js(
        "(() => { const b = document.querySelector('.map canvas').getBoundingClientRect(); return [b.x, b.y, b.right, b.bottom].map(Math.round); })()"
    )
    picture = np.asarray(Image.open(io.BytesIO(tab.picture())).convert("RGB"))[box[1] : box[3], box[0] : box[2]]
    for kind, colour in KIND_COLOURS.items():
        assert (picture == tuple(bytes.fromhex(colour[1:]))).all(axis=2).sum() > 20, kind


def test_the_corrected_survey_is_delivered_into_a_new_folder(tab, folder):
    tab.js("page.actions.go(2)")
    decide(tab, "r")
    tab.click("#deliver")
    tab.click("[data-format='.dxf']")
    tab.click("#write")
    tab.until("document.querySelector('#delivered').textContent.includes('objects in')")
    text = tab.js("document.querySelector('#delivered').textContent")
    [made] = folder.glob("delivery-*")
    assert text.startswith(f"4 objects in {made}: ")
    assert sorted(path.suffix for path in made.iterdir()) == [".csv", ".dxf", ".gpkg", ".html"]
    import geopandas

    assert geopandas.read_file(made / next(p.name for p in made.glob("*.gpkg")), layer="objects")[
        "object_id"
    ].tolist() == [1, 3, 4, 5]
