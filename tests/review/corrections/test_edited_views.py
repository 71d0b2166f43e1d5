"""Edits in the layers of kinds, which are views of `objects`: they reach the table and come back as corrections."""

import shutil
import sqlite3
from contextlib import closing

import geopandas as gpd
import pyogrio
import pytest
from helpers.corrected import object_rows, write_inventory
from helpers.gdal_edits import opened
from typer.testing import CliRunner

from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.review.corrections import open_corrections


@pytest.fixture(scope="module")
def labelled(tmp_path_factory):
    folder = tmp_path_factory.mktemp("labelled")
    write_inventory(folder, object_rows())
    return folder


@pytest.fixture
def folder(labelled, tmp_path):
    return shutil.copytree(labelled, tmp_path / "out")


@pytest.fixture
def edited(folder, tmp_path):
    return shutil.copy(folder / "inventory.gpkg", tmp_path / "edited.gpkg")


def imported(path, folder):
    result = CliRunner().invoke(app, ["corrections", "import", str(path), str(folder)])
    assert result.exit_code == 0, result.output
    return " ".join(result.output.split())


def states(folder):
    with open_corrections(folder) as store:
        return {n: (s["status"], s["checked_class"]) for n, s in store.object_states().items()}


def added(folder):
    with open_corrections(folder) as store:
        found = [decision.correction for decision in store.current() if decision.correction.action == "add"]
    return [(one.kind, *(one.payload[axis] for axis in "xyz")) for one in found]


def test_edits_by_gdal_reach_the_table_and_come_back(folder, edited):
    with opened(edited, "poles") as poles:
        assert poles.can("RandomWrite") and poles.can("DeleteFeature") and poles.can("FastSpatialFilter")
        poles.change(1, status="accepted", wkt="POINT Z (500.5 900 12)")
        poles.delete(2)
        poles.add(wkt="POINT Z (515 903 12.5)", status="")
    with opened(edited, "signs") as signs:
        signs.change(3, checked_class="pole")
    objects = gpd.read_file(edited, layer="objects").set_index("object_id", drop=False)
    assert objects.loc[1, "status"] == "accepted" and objects.loc[1, "geometry"].x == 500.5
    assert objects.loc[3, "checked_class"] == "pole" and 2 not in objects.index
    assert objects["kind"].tolist()[-1] == "pole" and objects.geometry.iloc[-1].coords[0] == (515.0, 903.0, 12.5)
    assert len(gpd.read_file(edited, layer="poles", bbox=(514, 902, 516, 904))) == 1  # by the index of the table
    assert "5 new corrections" in imported(edited, folder)
    assert states(folder) == {1: ("accepted", "pole"), 2: ("rejected", ""), 3: ("changed", "pole")}
    assert added(folder) == [("pole", 515.0, 903.0, 12.5)]
    with open_corrections(folder) as store:
        assert store.object_states()[1]["x"] == 500.5
    assert "0 new corrections" in imported(edited, folder)


def test_an_edit_of_the_table_shows_in_the_view(edited):
    with opened(edited, "objects") as objects:
        objects.change(1, kind="sign", status="changed")
    signs = gpd.read_file(edited, layer="signs")
    assert signs["object_id"].tolist() == [1, 3] and signs["status"].fillna("").tolist() == ["changed", ""]
    assert gpd.read_file(edited, layer="poles")["object_id"].tolist() == [2]


def test_vehicles_keep_their_boxes_and_a_drawn_box_is_an_added_vehicle(folder, edited):
    with opened(edited, "vehicles") as vehicles:
        vehicles.change(5, status="accepted")
        vehicles.add(wkt="POLYGON Z ((540 890 12,544 890 12,544 892 12,540 892 12,540 890 12))")
    boxes = gpd.read_file(edited, layer="vehicles")
    assert boxes["status"].fillna("").tolist() == ["accepted", ""] and boxes.geometry.area.tolist() == pytest.approx(
        [2.0, 8.0]
    )
    assert "vehicle_boxes" not in set(pyogrio.list_layers(edited)[:, 0])
    imported(edited, folder)
    assert states(folder) == {5: ("accepted", "vehicle")} and added(folder) == [("vehicle", 542.0, 891.0, 12.0)]


def test_a_copied_vehicle_is_an_added_one(folder, edited):
    with opened(edited, "vehicles") as vehicles:
        vehicles.add(wkt="POLYGON Z ((540 890 12,544 890 12,544 892 12,540 892 12,540 890 12))", object_id=5)
    said = imported(edited, folder)
    assert added(folder) == [("vehicle", 542.0, 891.0, 12.0)] and states(folder) == {} and "Not compared" not in said


def test_a_moved_box_is_named(folder, edited):
    with opened(edited, "vehicles") as vehicles:
        vehicles.change(5, wkt="POLYGON Z ((540 890 12,544 890 12,544 892 12,540 892 12,540 890 12))")
    said = imported(edited, folder)
    assert "1 boxes of layer 'vehicles' were moved (object_id 5): move the points of 'objects'" in said
    assert states(folder) == {}


def test_a_statement_of_sqlite_on_a_view_reaches_the_table(folder, edited):
    with closing(sqlite3.connect(edited)) as base, base:
        base.create_function("ST_IsEmpty", 1, lambda shape: 0)  # GDAL's, in the triggers of the index
        for corner in ("MinX", "MaxX", "MinY", "MaxY"):
            base.create_function(f"ST_{corner}", 1, lambda shape: 0.0)
        base.execute("UPDATE trees SET status = 'rejected' WHERE object_id = 4")
        assert base.execute("SELECT status FROM objects WHERE object_id = 4").fetchall() == [("rejected",)]
    imported(edited, folder)
    assert states(folder) == {4: ("rejected", "")}


def test_a_changed_view_is_refused(folder, edited):
    with closing(sqlite3.connect(edited)) as base, base:
        base.execute("DROP VIEW trees")
        base.execute("CREATE VIEW trees AS SELECT * FROM objects")
    result = CliRunner().invoke(app, ["corrections", "import", str(edited), str(folder)])
    assert result.exit_code == 1 and "layer 'trees' is a view" in " ".join(result.output.split())
