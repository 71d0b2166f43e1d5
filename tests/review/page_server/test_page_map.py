"""Map with a background, also large; section with a grid and a scale; both in the exported page."""

import io

import numpy as np
import pytest
from helpers.backgrounds import write_geotiff
from helpers.page_output import ORIGIN
from helpers.page_tab import READY, settle
from PIL import Image

from mlsroad_pipeline.inventory_files.geopackage import read_geopackage
from mlsroad_pipeline.reporting.clouds.pictures import map_frame
from mlsroad_pipeline.reporting.html.objects import object_map_section
from mlsroad_pipeline.review.page_server.background import Background
from mlsroad_pipeline.review.page_server.export import export_page
from mlsroad_pipeline.review.page_server.output_folder import OutputFolder

RED, BLUE = (230, 20, 20), (20, 20, 230)


@pytest.fixture(scope="module")
def ortho(tmp_path_factory):
    """Red west of the middle of the survey (easting 545), blue east of it, 0.5 m per pixel."""
    path = tmp_path_factory.mktemp("ortho") / "ortho <b>.tif"
    picture = np.full((400, 500, 3), BLUE, np.uint8)
    picture[:, :290] = RED  # 400 m + 290 x 0.5 m
    write_geotiff(path, picture, ORIGIN[0] - 100, ORIGIN[1] + 100, 0.5)
    return path


@pytest.fixture(scope="module")
def options(ortho):
    return ("--background", str(ortho))


def opened_at(tab, server):
    tab.open(f"http://127.0.0.1:{server.port}/", width=1200, height=800)
    tab.until(READY)


def map_picture(tab):
    box = tab.js(
        "(() => { const b = document.querySelector('.map canvas').getBoundingClientRect(); return [b.x, b.y, b.right, b.bottom].map(Math.round); })()"
    )
    picture = np.asarray(Image.open(io.BytesIO(tab.picture())).convert("RGB")).astype(int)
    return picture[box[1] : box[3], box[0] : box[2]]


def like(picture, colour):
    return np.abs(picture - colour).max(axis=2) < 25


def middle_column(tab):
    """Return the column of the map at easting 545."""
    return tab.js("Math.round(page.map.at(545 - page.model.survey.origin[0], 0)[0])")


def check_halves(tab):
    tab.until("page.map.background.sheet !== null")
    settle(tab)
    picture, middle = map_picture(tab), middle_column(tab)
    red, blue = like(picture, RED), like(picture, BLUE)
    assert red[:, : middle - 2].mean() > 0.5 and blue[:, middle + 2 :].mean() > 0.5
    assert not red[:, middle + 2 :].any() and not blue[:, : middle - 2].any()


def test_the_background_is_under_the_map_where_it_belongs(tab):
    tab.js("page.map.fit()")
    check_halves(tab)
    tab.js("page.map.zoom(6); page.cloud.moveTo(page.model.survey.first.bounds[0][0] + 50, 5)")
    tab.until("page.map.background.sheet.picture.naturalWidth > 0")
    check_halves(tab)
    tab.js("[...document.querySelectorAll('.map-buttons button')].find((b) => b.textContent === 'Background').click()")
    settle(tab)
    assert not like(map_picture(tab), RED).any()


def test_the_background_is_served_to_the_page_alone_and_wrong_requests_are_refused(tab, server):
    assert server.ask("/background?area=400,800,600,1000&size=100,100")[0] == 401
    ask = "fetch('/background?{0}').then(async (a) => [a.status, a.headers.get('content-type'), a.status === 200 ? '' : (await a.json()).error])"
    assert tab.js(ask.format("area=420,820,600,990&size=90,85"))[:2] == [200, "image/jpeg"]
    for query, words in (
        ("area=420,820,600&size=9,9", "4 numbers"), ("area=420,820,400,900&size=9,9", "west, south"), ("area=420,820,600,990&size=9,9999", "from 1 to 2048"), ("size=9,9", "4 numbers"),
    ):  # fmt: skip
        status, _, error = tab.js(ask.format(query))
        assert status == 409 and words in error
    tab.messages.clear()  # the refusals are in the console


def test_the_report_has_the_background_under_its_map(tab, server, folder):
    path = folder / "report.html"
    before, objects = path.read_bytes(), read_geopackage(folder / "inventory.gpkg").objects
    places = objects[["x", "y"]].to_numpy()
    white = np.full((6, 8, 3), 255, np.uint8)
    counts = objects["kind"].value_counts().to_dict()
    section = object_map_section("Map", objects, map_frame(places, places), counts, background=white)
    path.write_text(f"<meta charset=utf-8>{section.body}", encoding="utf-8")
    tab.open(f"http://127.0.0.1:{server.port}/report", width=1200, height=800)
    address = "document.querySelector('image[data-layer=cloud]').href.baseVal"
    assert tab.js(address).startswith(("data:image/jpeg", "data:image/png"))
    assert tab.js("document.querySelector('.legend').innerText.includes('ortho <b>.tif')")
    path.write_bytes(before)
    assert tab.messages == []
    opened_at(tab, server)  # the sandbox of the report has no storage


def test_the_map_can_be_made_larger_and_small_again(tab):
    small = map_picture(tab).shape
    tab.press("g")
    tab.until("document.querySelector('.map canvas').getBoundingClientRect().width > 500")
    tab.js("page.map.fit()")
    check_halves(tab)
    assert tab.js("document.querySelector('main.cloud').clientHeight") > 250  # the cloud stays
    tab.press("g")
    tab.until("document.querySelector('.map canvas').getBoundingClientRect().width < 500")
    assert map_picture(tab).shape == small
    assert tab.js("document.querySelector('.right').previousElementSibling.classList.contains('map')")


def test_a_section_has_a_grid_with_numbers_and_a_scale(tab):
    tab.js("page.cloud.look([25, 0, 1], 30, 0, 0.6)")
    tab.press("x")
    settle(tab)
    step, metre = tab.js(
        "(() => { const { section, survey } = page.model, t = page.cloud.target; const at = (d) => page.cloud.project([section.place[0] + Math.cos(section.heading) * d,"
        " section.place[1] - Math.sin(section.heading) * d, t[2]]); return [page.grid.step, Math.hypot(at(1).x - at(0).x, at(1).y - at(0).y)]; })()"
    )
    assert step * metre >= 55 and step in (1, 2, 5, 10)
    grid = np.array(
        tab.js(
            "(() => { const c = page.grid.canvas; const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
            " return [c.width, c.height, ...Array.from({ length: c.width * c.height }, (_, i) => d[4 * i + 3])]; })()"
        )
    )
    width, height, alpha = grid[0], grid[1], grid[2:].reshape(grid[1], grid[0])
    columns = np.flatnonzero((alpha[80:-70] > 20).mean(axis=0) > 0.95)  # upright lines
    starts = columns[np.flatnonzero(np.diff(columns, prepend=-10) > 2)]
    assert len(starts) > 4 and np.diff(starts) == pytest.approx(step * metre, abs=2.5)
    rows = np.flatnonzero((alpha[:, 20:-20] > 20).mean(axis=1) > 0.9)
    assert len(rows) > 2 and width > height / 4
    bar = np.flatnonzero(alpha[height - 46] > 150)  # the scale
    assert bar[-1] - bar[0] == pytest.approx(step * metre, abs=3) and bar[-1] == pytest.approx(width - 12, abs=2)
    tab.js("page.cloud.zoom(0.2)")
    settle(tab)
    assert tab.js("page.grid.step") < step
    tab.press("x")
    settle(tab)
    assert tab.js("page.grid.canvas.hidden") and tab.js("page.grid.step") == 0


def test_an_exported_page_has_its_background(tab, folder, ortho, tmp_path):
    target = export_page(
        OutputFolder.find(folder), tmp_path / "page.html", most=50_000, background=Background(ortho, None)
    )
    with tab.another() as copy:
        copy.open(target, width=1200, height=800)
        copy.until("window.page?.cloud.shown > 40000")
        copy.js("page.map.fit()")
        check_halves(copy)
        assert [a for a in copy.addresses if not a.startswith(("file:", "data:", "blob:"))] == []
