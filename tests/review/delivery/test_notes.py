"""Notes and attributes are delivered in every format, and come back from an edited GeoPackage."""

import csv
import json

import geopandas
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from ezdxf import readfile
from helpers.corrected import object_rows
from helpers.page_output import write_output
from typer.testing import CliRunner

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.inventory_files.geopackage import read_geopackage, write_geopackage
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory
from mlsroad_pipeline.review.corrections import Correction, open_corrections
from mlsroad_pipeline.review.corrections.line_decisions import corrected_lines

NOTE, LONG = "=1+1 leans, Größe?", "material_of_the_mast"
GIVEN = {
    2: {"note": NOTE, "attributes": {LONG: "steel", "material_of_the_base": "concrete"}},
    5: {"attributes": {LONG: "x"}},
}


def mlsroad(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("notes") / "out"
    write_output(place)
    inventory = read_geopackage(place / "inventory.gpkg")
    write_geopackage(
        RoadInventory(inventory.objects, "EPSG:25832", inventory.trajectory, None, inventory.lines),
        place / "inventory.gpkg",
    )
    with open_corrections(place) as store:
        store.add_all([Correction("note", number, payload=given) for number, given in GIVEN.items()], who="ann")
        store.add(Correction("note", 1, payload={"note": "taken back"}), who="ann")
        store.undo(3, who="ann")
        added = {"x": 505.0, "y": 901.0, "z": 12.0, "note": "new"}
        number = store.add(Correction("add", kind="pole", payload=added), who="ann")
        store.add(Correction("note", payload={"added": number, "attributes": {LONG: "wood"}}), who="ann")
    return place


@pytest.fixture(scope="module")
def delivered(folder, tmp_path_factory):
    place = tmp_path_factory.mktemp("delivered")
    (folder / ".mlsroad/0123456789ab/run.json").unlink()  # the inventory was replaced above
    names = ("a.gpkg", "a.parquet", "a.csv", "a.geojson", "a.fgb", "a.shp", "a.dxf")
    done = mlsroad("export", folder, "-o", *(place / name for name in names))
    assert done.exit_code == 0, done.output
    return place


EXPECTED = {2: (NOTE, "steel", "concrete"), 5: (None, "x", None), 6: (None, "wood", None)}


def rows_of(table, columns):
    table = table.set_index("object_id")[list(columns)]
    table = table[table.notna().any(axis=1)]
    return {
        n: tuple(None if pd.isna(value) else value for value in row)
        for n, row in zip(table.index, table.to_numpy(), strict=True)
    }


@pytest.mark.parametrize("name", ["a.gpkg", "a.parquet", "a.geojson", "a.fgb", "a.shp"])
def test_tables_of_a_gis_have_notes_and_attributes(delivered, name):
    path = delivered / name
    options = {"layer": "objects"} if name == "a.gpkg" else {}
    table = geopandas.read_parquet(path) if name == "a.parquet" else geopandas.read_file(path, **options)
    columns = ("note", f"attr_{LONG}", "attr_material_of_the_base")
    if name == "a.shp":
        columns = ("note", "a_material", "a_materia1")
        names = pd.read_csv(delivered / "a_fields.csv").set_index("shapefile_field")["field"]
        assert [names[column] for column in columns[1:]] == ["attr_material_of_the_base", f"attr_{LONG}"]
        columns = ("note", "a_materia1", "a_material")
    assert rows_of(table, columns) == EXPECTED
    if name == "a.gpkg":
        assert f"attr_{LONG}" in geopandas.read_file(path, layer="vehicles")
        assert "note" not in geopandas.read_file(path, layer="vehicles")  # no vehicle has one
        again = read_geopackage(path).objects
        assert again.loc[again["object_id"] == 2, "note"].tolist() == [NOTE]
    if name == "a.parquet":
        field = pq.read_schema(path).field(f"attr_{LONG}")
        assert field.metadata[b"alias"] == f"Attribute {LONG}".encode()


def test_csv_and_drawing_have_notes_and_attributes(delivered):
    with (delivered / "a.csv").open(encoding="utf-8", newline="") as stream:
        rows = {int(row["object_id"]): row for row in csv.DictReader(stream)}
    assert rows[2]["note"] == f"'{NOTE}"  # no formula
    assert [rows[n][f"attr_{LONG}"] for n in (1, 2, 5, 6)] == ["", "steel", "x", "wood"]
    assert len((delivered / "a.csvt").read_text(encoding="ascii").split(",")) == len(rows[2])
    found = {}
    for block in readfile(delivered / "a.dxf").modelspace().query("INSERT"):
        cells = {attribute.dxf.tag: attribute.dxf.text for attribute in block.attribs}
        found[int(cells["OBJECT_ID"])] = (cells.get("NOTE"), cells.get(f"ATTR_{LONG}".upper()))
    assert (found[2], found[5], found[1]) == ((NOTE, "steel"), (None, "x"), (None, None))


def test_an_own_schema_takes_notes_and_attributes(folder, delivered, tmp_path):
    schema = tmp_path / "own.yml"
    fields = {"No": "object_id", "Remark": "note", "Material": f"attr_{LONG}", "Other": "attr_colour"}
    schema.write_text(json.dumps({"layers": {"Mast": {"kind": "pole", "fields": fields}}}), encoding="utf-8")
    done = mlsroad("export", folder, "--schema", schema, "-o", tmp_path / "own.gpkg")
    assert done.exit_code == 0, done.output
    table = geopandas.read_file(tmp_path / "own.gpkg", layer="Mast").set_index("No")
    assert (table.loc[2, "Remark"], table.loc[6, "Material"]) == (NOTE, "wood") and table["Other"].isna().all()


def edited(delivered, target, change):
    objects = geopandas.read_file(delivered / "a.gpkg", layer="objects")
    change(objects)
    objects.to_file(target, layer="objects")
    return target


def test_an_edited_geopackage_brings_notes_back(folder, delivered, tmp_path):
    def change(objects):
        own = objects["object_id"]
        objects.loc[own == 2, "note"] = "stands upright"
        objects.loc[own == 3, f"attr_{LONG}"] = "tin"
        objects.loc[own == 5, f"attr_{LONG}"] = None  # an empty cell changes nothing
        objects["attr_Number"] = np.where(own == 1, 12.0, np.nan)

    path = edited(delivered, tmp_path / "edited.gpkg", change)
    done = mlsroad("corrections", "import", path, folder, "--who", "bob")
    assert "3 new corrections" in done.output and "note         3" in done.output, done.output
    with open_corrections(folder) as store:
        notes = store.states().notes
    assert notes[2] == ("stands upright", GIVEN[2]["attributes"])
    assert (notes[3], notes[1]) == (("", {LONG: "tin"}), ("", {"number": "12"}))
    assert notes[5].attributes == {LONG: "x"}
    again = mlsroad("corrections", "import", path, folder)
    assert "0 new corrections" in again.output
    listed = mlsroad("corrections", "list", folder).output
    assert "stands upright" in listed


def test_a_name_that_is_none_is_an_error(folder, delivered, tmp_path):
    path = edited(delivered, tmp_path / "edited.gpkg", lambda objects: objects.__setitem__("attr_two words", "x"))
    done = mlsroad("corrections", "import", path, folder)
    assert done.exit_code == 1 and "edited.gpkg: object 1: " in done.output.replace("\n", "")
    assert "'two words' is not the name of an attribute" in done.output


def test_notes_do_not_count_as_decisions(folder, delivered):
    with open_corrections(folder) as store:
        assert store.object_states() == {}
    done = mlsroad("export", folder, "--checked", "-o", delivered / "checked.gpkg")
    assert done.exit_code == 0, done.output
    assert geopandas.read_file(delivered / "checked.gpkg", layer="objects")["status"].tolist() == ["added"]


def test_the_report_lists_lines_after_the_decisions(tmp_path):
    from mlsroad_pipeline.label.report import _line_table, _lines_by_kind

    write_output(tmp_path / "out")
    inventory = read_geopackage(tmp_path / "out/inventory.gpkg")
    with open_corrections(tmp_path / "out") as store:
        parts = [[[500.0, 901.0, 12.0], [512.0, 901.0, 12.0]]]
        store.add(Correction("add_line", kind="stop_line", payload={"parts": parts}), who="ann")
        store.add(Correction("reject_line", kind="kerb", payload={"line": 1, "x": 495.0, "y": 895.0}), who="ann")
    table = corrected_lines(inventory.lines, tmp_path / "out", inventory.trajectory)
    assert table["status"].tolist() == ["rejected", "added"]
    assert list(_lines_by_kind(table)) == ["stop_line"]
    [section] = _line_table(table)
    assert "stop_line" in section.body and "added" in section.body and ">12<" in section.body
    assert "nan" not in section.body


def test_a_note_of_an_object_that_was_not_added_is_refused_and_one_that_was_taken_back_is_gone(tmp_path):
    write_output(tmp_path / "out")
    with open_corrections(tmp_path / "out") as store:
        with pytest.raises(ParameterError, match="no decision 7 in force has added"):
            store.add(Correction("note", payload={"added": 7, "note": "x"}), who="ann")
        number = store.add(Correction("add", kind="pole", payload={"x": 1.0, "y": 2.0, "z": 0.0}), who="ann")
        store.add(Correction("note", payload={"added": number, "note": "x"}), who="ann")
        store.undo(number, who="ann")
        assert store.states().notes_of_added == {}
    with pytest.raises(ParameterError, match="object_id must be a number"):
        Correction("accept", payload={"added": 1})


def test_states_of_objects_have_no_notes_of_others():
    from mlsroad_pipeline.review.corrections.inventory_columns import with_states
    from mlsroad_pipeline.review.corrections.states import Note, States

    noted = with_states(object_rows(), States(notes={3: Note("a", {"b": "c"})}))
    assert noted["note"].tolist() == ["", "", "a", "", ""] and noted["attr_b"].tolist()[2] == "c"
    assert [name for name in with_states(noted, States()) if name.startswith(("note", "attr"))] == []


def test_conflicting_notes_of_two_layers_are_an_error(folder, delivered, tmp_path):
    from mlsroad_pipeline.review.corrections.edited_inventory import corrections_of_inventory

    path = tmp_path / "edited.gpkg"
    for layer, text in (("objects", "one"), ("poles", "two")):
        table = geopandas.read_file(delivered / "a.gpkg", layer=layer)
        table.loc[table["object_id"] == 2, "note"] = text
        table.to_file(path, layer=layer)
    with open_corrections(folder) as store, pytest.raises(DataError, match="object 2 is edited in two ways"):
        states = store.states()
        corrections_of_inventory(
            path, store.objects(), states.of_objects, classes=(), system=None, notes_before=states.notes
        )
