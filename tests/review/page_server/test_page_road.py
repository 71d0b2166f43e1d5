"""The page lists places of a measured road, flies to them and keeps what is decided; types and shapes are searched."""

import json

import pandas as pd
import pytest
from helpers.page_output import write_output
from helpers.page_tab import decide, entries, reload
from helpers.roads import write_planted_road

from mlsroad_pipeline.execution.run_folder import entries_of
from mlsroad_pipeline.execution.run_identity import finished_record
from mlsroad_pipeline.inventory_files.geopackage import read_geopackage, write_geopackage
from mlsroad_pipeline.review.compared_entries import inventory_digest

pytestmark = pytest.mark.filterwarnings("ignore:'crs' was not provided:UserWarning")  # the survey has none


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("road") / "out"
    write_output(place)
    found = read_geopackage(place / "inventory.gpkg")
    found.objects.loc[found.objects["object_id"] == 1, "pole_type"] = "utility"
    found.objects.loc[found.objects["kind"] == "sign", "panel_shape"] = "round"
    write_geopackage(found, place / "inventory.gpkg")
    (path,) = place.glob(".mlsroad/*/run.json")
    run = json.loads(path.read_text(encoding="utf-8"))
    [entry] = entries_of([str(place / "inventory.gpkg")])
    run["outputs"] = [{**entry, "path": e["path"]} if e["path"] == "inventory.gpkg" else e for e in run["outputs"]]
    path.write_text(json.dumps(run), encoding="utf-8")
    write_planted_road(place, inventory=inventory_digest(finished_record(place)))
    return place


def test_places_are_listed_flown_to_decided_and_delivered(tab, server, folder):
    tab.js("document.querySelector('[data-list=road]').click()")
    assert entries(tab) == [
        "station 6.5 intruded: tree 4, 3.10 m above the road, 1.0 m right",
        "station 12.5 intruded: sign, 3.40 m above the road, 0.5 m left",
        "station 15.5 low: tree, 3.80 m above the road, 2.5 m left",
    ]
    tab.press("n")
    assert tab.js("location.hash") == "#road=6.5"
    origin = tab.js("page.model.survey.origin")
    target = "page.cloud.target"
    wanted = [a - b for a, b in zip((506.5, 896.0, 15.1), origin, strict=True)]
    tab.until(f"Math.hypot({target}[0] - {wanted[0]}, {target}[1] - {wanted[1]}, {target}[2] - {wanted[2]}) < 0.5")
    decide(tab, "a")
    assert tab.js("page.model.entry.name") == "12.5"
    decide(tab, "r")
    reload(tab, server)
    tab.js("page.actions.showList('road'); document.querySelector('#rest').click()")
    listed = entries(tab)
    assert listed[1:3] == [
        "station 6.5 intruded: tree 4, 3.10 m above the road, 1.0 m right right",
        "station 12.5 intruded: sign, 3.40 m above the road, 0.5 m left wrong",
    ]
    assert listed[3] == "station 0 measured: width 6.50 m, crossfall 2.50 %, clearance 3.10 m" and len(listed) == 6
    tab.press("Escape")
    tab.js("document.querySelector('#deliver').click()")
    tab.js("document.querySelector('[data-format=\".csv\"]').click(); document.querySelector('#write').click()")
    tab.until("document.querySelector('#delivered').textContent.includes('delivery-')")
    (delivery,) = folder.glob("delivery-*")
    (table,) = delivery.glob("*_intrusions.csv")
    found = pd.read_csv(table, keep_default_na=False)
    assert list(zip(found["place"], found["checked"], strict=True)) == [(6.5, "right"), (15.5, "")]


def names(tab):
    return tab.js("[...document.querySelectorAll('#kinds li .name')].map((name) => name.textContent)")


def test_types_and_shapes_are_searched_and_filtered(tab):
    assert names(tab)[-2:] == ["pole, utility", "sign, round"]
    tab.js("page.actions.showList('objects')")
    for word, kind in (("utility", "pole"), ("round", "sign")):
        tab.js(f"page.model.set('queue', 'search', '{word}')")
        assert [entry.rsplit(" ", 1)[0].split(" ")[0] for entry in entries(tab)] == [kind], word
    tab.js("page.model.set('queue', 'search', '')")
    tab.click("#kinds li:last-child .only")
    shown = "page.model.objects.filter((object) => page.model.shown(object)).map((object) => object.kind)"
    assert tab.js(shown) == ["sign"]
    tab.click("#kinds li:last-child .only")
    tab.click("#kinds li:nth-last-child(2) input")
    assert "pole" in tab.js(shown) and 1 not in tab.js(shown.replace(".kind", ".id"))
