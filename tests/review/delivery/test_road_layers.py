"""Measures of the road in every delivered format, with the decisions about its places; those of other labels are left out."""

import csv
import shutil
from dataclasses import replace

import ezdxf
import geopandas as gpd
import numpy as np
import pytest
import shapely
from helpers.page_output import write_output
from helpers.roads import STATIONS, planted_road, write_planted_road
from typer.testing import CliRunner

from mlsroad_pipeline.algorithms.inventory.road.table import ROAD_LAYERS
from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.execution.run_identity import finished_record
from mlsroad_pipeline.inventory_files.geopackage import read_geopackage, write_geopackage
from mlsroad_pipeline.inventory_files.vector_files import short_name
from mlsroad_pipeline.review.compared_entries import compared_entries, inventory_digest
from mlsroad_pipeline.review.corrections import Correction, open_corrections

pytestmark = pytest.mark.filterwarnings("ignore:'crs' was not provided:UserWarning")  # the survey has none


def mlsroad(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Output with a measured road: the tree is right, the sign is wrong, nobody looked at the low branch."""
    place = tmp_path_factory.mktemp("road") / "out"
    write_output(place)
    write_planted_road(place, inventory=inventory_digest(finished_record(place)))
    with open_corrections(place) as store:
        asked = [entry for entry in compared_entries(place)[0]["road"] if entry.asks]
        for entry, checked in zip(asked[:2], ("right", "wrong"), strict=True):
            payload = {"table": "road", "entry": entry.name, "state": entry.state, "x": entry.x, "y": entry.y}
            store.add(Correction("check", None, entry.kind, {**payload, "checked": checked}), who="ann")
    return place


def delivered(folder, target, *options):
    done = mlsroad("export", folder, "-o", target, *options)
    assert done.exit_code == 0, done.output
    return done.output


@pytest.mark.parametrize("suffix", ["gpkg", "fgb", "gml", "shp", "geojson"])
def test_layers_are_those_that_were_measured(folder, tmp_path, suffix):
    if suffix == "geojson":
        folder = _in_system(folder, tmp_path)
    target = tmp_path / f"mine.{suffix}"
    delivered(folder, target)
    for name in ROAD_LAYERS:
        expected = gpd.read_file(folder / "road/road.gpkg", layer=name)
        place = target if suffix == "gpkg" else tmp_path / f"mine_{name}.{suffix}"
        assert place.is_file(), name
        if len(expected) == 0:
            continue
        found = gpd.read_file(place, layer=name) if suffix == "gpkg" else gpd.read_file(place)
        if name == "intrusions":
            expected = expected[expected["place"] != "12.5"].assign(checked=["right", ""])
        assert len(found) == len(expected), name
        columns = [column for column in expected if column != "geometry"]
        own = found.rename(columns={short_name(column): column for column in columns})
        own = own if expected.crs is None else own.to_crs(expected.crs)
        own = own.sort_values(columns[0]) if suffix == "fgb" else own  # in the order of its index
        expected = expected.sort_values(columns[0]) if suffix == "fgb" else expected
        for column in columns:
            known, given = (frame[column].astype(object).fillna("").tolist() for frame in (expected, own))
            assert [str(v) for v in given] == [str(v) for v in known], (name, column)
        places = [shapely.get_coordinates(frame.geometry.to_numpy(), include_z=True) for frame in (expected, own)]
        np.testing.assert_allclose(places[1], places[0], atol=2e-3, err_msg=name)


def _in_system(folder, place):
    """Return a copy of the output with a reference system, which GeoJSON needs."""
    copy = place / "out"
    shutil.copytree(folder, copy)
    found = read_geopackage(copy / "inventory.gpkg")
    write_geopackage(replace(found, crs="EPSG:25833"), copy / "inventory.gpkg")
    write_planted_road(copy, inventory=inventory_digest(finished_record(copy)), crs="EPSG:25833")
    record = next(copy.glob(".mlsroad/*/run.json"))
    record.unlink()  # names the inventory of before
    return copy


def test_csv_and_drawing_have_the_measures(folder, tmp_path):
    delivered(folder, tmp_path / "mine.csv")
    with (tmp_path / "mine_road.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == STATIONS and rows[6]["clearance"] == "3.1" and rows[6]["clearance_object"] == "4"
    with (tmp_path / "mine_intrusions.csv").open() as stream:
        places = [(row["place"], row["state"], row["checked"]) for row in csv.DictReader(stream)]
    assert places == [("6.5", "intruded", "right"), ("15.5", "low", "")]
    assert (tmp_path / "mine_road_sections.csv").is_file() and (tmp_path / "mine_sight.csv").is_file()
    delivered(folder, tmp_path / "mine.dxf")
    drawing = ezdxf.readfile(tmp_path / "mine.dxf")
    assert not drawing.audit().errors
    space = drawing.modelspace()
    widths = space.query('POLYLINE[layer=="road_widths"]')
    ends = np.array([[vertex.dxf.location for vertex in line.vertices] for line in widths])
    table, _ = planted_road()
    assert len(ends) == table["width"].notna().sum()
    assert np.hypot(*(ends[:, 1] - ends[:, 0])[:, :2].T) == pytest.approx(np.full(len(ends), 6.5))
    assert set(ends[..., 2].ravel()) == {12.0}
    assert [text.dxf.text for text in space.query('TEXT[layer=="intrusions"]')] == ["intruded 3.10 m", "low 3.80 m"]
    point = space.query('POINT[layer=="intrusions"]')[0].dxf.location
    assert tuple(point) == pytest.approx((506.5, 896.0, 15.1))


@pytest.mark.parametrize(
    ("option", "states"),
    [("--checked", [("6.5", "right")]), ("--keep-rejected", [("6.5", "right"), ("12.5", "wrong"), ("15.5", "")])],
)
def test_places_are_left_out_like_objects(folder, tmp_path, option, states):
    delivered(folder, tmp_path / "mine.gpkg", option)
    found = gpd.read_file(tmp_path / "mine.gpkg", layer="intrusions")
    assert list(zip(found["place"], found["checked"].fillna(""), strict=True)) == states


def test_the_protocol_counts_the_places(folder, tmp_path):
    delivered(folder, tmp_path / "check.html")
    assert "States of road" in (tmp_path / "check.html").read_text(encoding="utf-8")
    with (tmp_path / "check_road_places.csv").open() as stream:
        checked = [row["checked"] for row in csv.DictReader(stream)]
    assert checked == ["", "right", "", "wrong", "", ""]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ("labels", "is older than the labels of the survey"),
        ("layers", "road.gpkg is damaged"),
        ("table", "is damaged ("),
    ],
)
def test_measures_of_other_labels_or_damaged_ones_are_named_and_left_out(folder, tmp_path, damage, message):
    copy = tmp_path / "out"
    shutil.copytree(folder, copy)
    if damage == "labels":
        write_planted_road(copy, inventory="of before")
    elif damage == "layers":
        (copy / "road/road.gpkg").write_bytes(b"no database" * 100)
    else:
        path = copy / "road/road_places.csv"
        path.write_text(path.read_text()[:-5])
    output = " ".join(delivered(copy, tmp_path / "mine.gpkg").split())
    assert message in output and "measure the road again with --overwrite" in output
    assert "no measures of the road are written" in output
    with pytest.raises(Exception, match="road"):
        gpd.read_file(tmp_path / "mine.gpkg", layer="road")
