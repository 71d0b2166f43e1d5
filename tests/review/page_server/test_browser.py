"""The page in Chromium: points are drawn, filtered, corrected and painted, and a reload shows what was saved."""

import json
import re
import shutil

import geopandas
import pytest
from helpers.browser import browser_page
from helpers.page_output import EVIL, served, write_output
from helpers.page_tab import POLE, READY, ROAD, decide, errors, pixels, saved, settle
from typer.testing import CliRunner

from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.review.corrections import open_corrections
from mlsroad_pipeline.review.page_server.access import RedirectFile


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("browser") / "out"
    write_output(place)
    return place


@pytest.fixture(scope="module")
def opened(folder, tmp_path_factory):
    """Server and tab with the page; the tests share them and follow each other."""
    with browser_page(tmp_path_factory.mktemp("chromium")) as tab, served(folder) as server:
        tab.open(server.address, width=1200, height=800)
        tab.until(READY)
        settle(tab)
        yield server, tab


def test_points_are_drawn_in_the_colours_of_their_classes(opened):
    _, tab = opened
    assert 30_000 < tab.js("page.cloud.shown") <= 136_000
    assert pixels(tab, ROAD) > 20_000
    assert tab.js("document.querySelector('h1').textContent") == "<i>survey.laz"
    tab.press("t")
    settle(tab)
    assert pixels(tab, ROAD) > 20_000
    tab.press("h")


def test_hidden_classes_and_kinds_are_not_drawn(opened):
    _, tab = opened
    tab.click("#classes li:first-child input")  # the most frequent class is the road
    settle(tab)
    assert pixels(tab, ROAD) < 3000  # grey of the toolbar
    tab.click("#classes li:first-child input")
    settle(tab)
    assert pixels(tab, ROAD) > 20_000
    tab.js(
        "(() => { const s = document.querySelector('#score'); s.value = 0.55; s.dispatchEvent(new Event('input')); })()"
    )
    # Scores 0.9, 0.6 and 0.95 stay.
    assert tab.js("document.querySelector('#expected').textContent") == "3 of 5 objects, about 2.5 right (82 %)"
    tab.js(
        "(() => { const s = document.querySelector('#score'); s.value = 0; s.dispatchEvent(new Event('input')); })()"
    )


def test_a_click_on_a_mark_shows_the_object_with_reasons_and_photo(opened):
    _, tab = opened
    tab.js("(() => { page.cloud.focus(1); page.model.select(null); })()")
    settle(tab)
    place = tab.js(
        "(() => { const o = page.model.byId.get(1);"
        " const p = page.cloud.project([o.place[0], o.place[1], o.place[2] + o.height + 0.6]); const b = page.cloud.canvas.getBoundingClientRect();"
        " return [b.x + p.x, b.y + p.y]; })()"
    )
    tab.drag(place, place, steps=1)
    text = tab.js("document.querySelector('#chosen').innerText")
    assert "pole 1" in text and "reaches the ground" in text and "<b>bold</b>" in text
    tab.until("document.querySelector('.photo')?.naturalWidth === 40")


@pytest.mark.filterwarnings("ignore:'crs' was not provided:UserWarning")  # the survey has none
def test_keys_decide_and_a_reload_shows_it(opened, folder):
    server, tab = opened
    tab.js("page.actions.go(1)")
    decide(tab, "a")
    tab.js("page.actions.go(5)")
    decide(tab, "r")
    decide(tab, "u")
    with open_corrections(folder) as store:
        assert [(d.correction.action, d.correction.object_id, d.who) for d in store.current()] == [("accept", 1, "ann")]
    import_edited(folder)
    tab.open(f"http://127.0.0.1:{server.port}/", width=1200, height=800)
    tab.until(READY)
    tab.until("page.model.decisions.length === 2")
    assert tab.js("[page.model.status(1), page.model.status(2), page.model.status(5)]") == ["accepted", "rejected", ""]
    assert "2 of 5 looked at" in tab.js("document.querySelector('#progress').textContent")
    tab.press("?")
    assert tab.js("document.querySelector('dialog.help').innerText.includes('next object or place to look at')")
    tab.press("Escape")
    tab.js("document.querySelector('dialog')?.close()")


def import_edited(folder):
    """Reject object 2 in a copy of the GeoPackage with GDAL, as QGIS does, and import the copy as users do."""
    copy = folder.with_name("edited.gpkg")
    shutil.copy(folder / "inventory.gpkg", copy)
    objects = geopandas.read_file(copy, layer="objects")
    objects.loc[objects["object_id"] == 2, "status"] = "rejected"
    objects.to_file(copy, layer="objects")
    done = CliRunner().invoke(app, ["corrections", "import", str(copy), str(folder), "--who", "bob"])
    assert (done.exit_code, "1 new corrections" in done.output) == (0, True), done.output


def test_a_fast_second_key_decides_nothing_about_the_next_object(opened, folder):
    _, tab = opened
    with open_corrections(folder) as store:
        before = store.current()
    tab.js("page.actions.go(page.model.queue[0].object_id)")
    first, second = tab.js("page.model.queue.slice(0, 2).map((item) => item.object_id)")
    tab.js("page.actions.accept(); page.actions.reject()")
    tab.until(f"!page.model.busy && page.model.selected === {second}")
    assert tab.js(f"[page.model.status({first}), page.model.status({second})]") == ["accepted", ""]
    decide(tab, "u")
    with open_corrections(folder) as store:
        assert store.current() == before


def test_the_brush_paints_points_and_undo_takes_it_back(opened, folder):
    _, tab = opened
    tab.js("(() => { page.cloud.look([25, 10, 1], 14, 0, 1.2); page.model.select(null); })()")
    settle(tab)
    tab.press("p")
    tab.js(
        "(() => { const s = document.querySelector('#brush-class'); s.value = 'pole'; s.dispatchEvent(new Event('change')); })()"
    )
    before = pixels(tab, POLE)
    tab.js("page.model.saved = {text: '', kind: ''}")
    tab.drag((520, 420), (600, 440))
    saved(tab)
    settle(tab)
    with open_corrections(folder) as store:
        stroke = store.current()[-1].correction
    assert (stroke.action, stroke.payload["class"]) == ("paint", "pole")
    assert tab.js("page.model.painted.size") >= len(stroke.payload["points"]) > 20
    assert pixels(tab, POLE) > before + 200
    tab.until("!page.model.busy")
    tab.js("(() => { page.model.saved = {text: '', kind: ''}; page.model.brush.class = 'wire'; })()")
    tab.drag((520, 420), (600, 440))  # over points that are painted
    assert re.match(r"[\d,]+ points: pole to wire\. Saved at ", saved(tab))
    with open_corrections(folder) as store:
        over = store.current()[-1].correction
    assert over.payload["class"] == "wire" and set(over.payload["points"]) & set(stroke.payload["points"])
    decide(tab, "u")
    decide(tab, "u")
    settle(tab)
    assert pixels(tab, POLE) < before + 50
    tab.press("v")


def test_keys_answer_about_the_most_uncertain_points(opened, folder):
    _, tab = opened
    tab.press("j")
    tab.until("page.model.groups.length > 1")
    tab.press("n")
    tab.until("page.model.highlighted.size > 0")
    settle(tab)
    group, following = tab.js("page.model.groups.slice(0, 2)")
    assert "points are marked" in tab.js("document.querySelector('#chosen').innerText")
    rows = tab.js("[...page.model.highlighted]")
    decide(tab, "a")
    with open_corrections(folder) as store:
        stroke = store.current()[-1].correction
    assert stroke.payload["class"] == tab.js(f"page.model.className({group['code']})")
    assert len(stroke.payload["points"]) == len(rows)
    tab.until(f"String(page.model.group?.place) === '{','.join(map(str, following['place']))}'")
    tab.press("r")  # leaves it out, and writes nothing
    tab.until(f"!page.model.groups.some((group) => String(group.place) === '{','.join(map(str, following['place']))}')")
    tab.press("u")
    tab.until(f"String(page.model.groups[0].place) === '{','.join(map(str, following['place']))}'")
    tab.js("page.actions.goGroup(page.model.groups[0])")
    tab.press("r")
    tab.until(f"!page.model.groups.some((group) => String(group.place) === '{','.join(map(str, following['place']))}')")
    tab.press("k")
    assert "What are the marked points?" in tab.js("document.querySelector('dialog').innerText")
    tab.press("Escape")
    tab.js("document.querySelector('dialog')?.close()")
    tab.js("page.actions.answer(page.model.groups[0], page.model.className(page.model.groups[0].code))")
    tab.until("page.model.decisions.at(-1)?.action === 'paint' && !page.model.busy")
    decide(tab, "u")
    decide(tab, "u")
    tab.until(f"page.model.groups.some((group) => String(group.place) === '{','.join(map(str, group['place']))}')")
    tab.press("j")
    tab.js("page.model.select(null)")
    assert tab.js("[page.model.list, page.model.highlighted.size]") == ["objects", 0]


def test_long_and_cancelled_strokes_are_saved(opened):
    _, tab = opened
    tab.js(
        """(() => {
        const { model, cloud } = page, { canvas } = cloud, own = [model.paint, cloud.pick, { ...model.brush }];
        window.sent = [];
        model.paint = async (stroke) => { sent.push([stroke.places.length, stroke.only]); return true; };
        let x = 0;
        cloud.pick = () => ({ place: [x++, 0, 0], code: x });
        canvas.setPointerCapture = canvas.releasePointerCapture = () => {};
        const fire = (name) => canvas.dispatchEvent(new PointerEvent(name, { button: 0, clientX: 500, clientY: 400 }));
        page.actions.tool("paint");
        for (const [moves, end] of [[160, "pointerup"], [4, "pointercancel"]]) {
          fire("pointerdown");
          for (let i = 0; i < moves; i++) fire("pointermove");
          fire(end);
        }
        Object.assign(model.brush, { cluster: true, only: false });
        fire("pointerdown");
        fire("pointerup");
        [model.paint, cloud.pick] = own;
        Object.assign(model.brush, own[2]);
        delete canvas.setPointerCapture;
        delete canvas.releasePointerCapture;
        page.actions.tool("look");
        })()"""
    )
    lengths, classes = zip(*tab.js("window.sent"), strict=True)
    assert lengths[0] == 150 and 5 <= lengths[1] < 150 and lengths[2] >= 3 and lengths[3:] == (1,)
    assert classes[0] == classes[1] == 1 and None not in classes  # the class under the first place


def test_nothing_of_the_names_was_executed_and_nothing_was_asked_elsewhere(opened):
    _, tab = opened
    assert tab.js(f"document.querySelector('#classes').innerText.includes({json.dumps(EVIL)})")
    assert tab.js("window.hacked") is None
    assert errors(tab) == ([], [])


def test_a_decision_that_the_server_did_not_answer_is_not_shown_as_saved(opened, folder):
    server, tab = opened
    server.process.kill()
    server.process.wait()
    tab.js("page.model.saved = {text: '', kind: ''}; page.actions.go(4)")
    tab.press("a")
    assert saved(tab) == "Not saved: The server does not answer. Start it again: mlsroad open"
    assert tab.js("[page.model.saved.kind, page.model.status(4)]") == ["bad", ""]
    with open_corrections(folder) as store:
        assert 4 not in [decision.correction.object_id for decision in store.current()]


def test_an_exported_page_draws_its_points_without_a_server(folder, tmp_path):
    from mlsroad_pipeline.review.page_server.export import export_page
    from mlsroad_pipeline.review.page_server.output_folder import OutputFolder

    target = export_page(OutputFolder.find(folder), tmp_path / "page.html", most=50_000)
    with browser_page(tmp_path / "chromium") as tab:
        tab.open(target, width=1200, height=800)
        tab.until("window.page?.cloud.shown > 40000")
        settle(tab)
        assert pixels(tab, ROAD) > 20_000
        tab.until("page.model.status(2) === 'rejected'")
        tab.js("page.actions.go(3)")
        tab.press("a")
        assert "a copy to look at" in saved(tab)
        assert tab.js("window.hacked") is None
        found = [message for message in tab.messages if '"source": "rendering"' not in message]
        assert (found, [a for a in tab.addresses if not a.startswith(("file:", "data:", "blob:"))]) == ([], [])


def test_a_browser_that_starts_with_the_redirect_file_shows_the_page_and_may_reload_it(folder, tmp_path):
    with browser_page(tmp_path / "chromium") as tab, served(folder) as server:
        file = RedirectFile(server.address, tmp_path)
        tab.send("Page.enable")
        tab.send("Page.navigate", url=file.path.as_uri())  # it is left at once, so that there is no waiting for it
        tab.until(f"location.protocol === 'http:' && {READY}")
        assert tab.js("location.href") == f"http://127.0.0.1:{server.port}/"
        tab.send("Page.reload")
        tab.until(READY)
        assert "token" not in tab.js("document.referrer")
