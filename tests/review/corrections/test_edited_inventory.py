"""Corrections that come back from a GeoPackage edited in another program: statuses, classes, places, rows."""

import json
import shutil
import sqlite3
from contextlib import closing

import geopandas as gpd
import pyogrio
import pytest
import shapely
from helpers.corrected import object_rows, save_as_tables, write_inventory
from helpers.labelled import scheme
from typer.testing import CliRunner

from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.review.corrections import Correction, open_corrections


@pytest.fixture(scope="module")
def labelled(tmp_path_factory):
    folder = tmp_path_factory.mktemp("labelled")
    write_inventory(folder, object_rows())
    return folder


@pytest.fixture(scope="module")
def saved(labelled, tmp_path_factory):
    """The inventory as QGIS saves it."""
    path = tmp_path_factory.mktemp("saved") / "edited.gpkg"
    save_as_tables(labelled / "inventory.gpkg", path)
    return path


@pytest.fixture
def folder(labelled, saved, tmp_path):
    shutil.copytree(labelled, tmp_path / "out")
    shutil.copy(saved, tmp_path)
    return tmp_path / "out"


def edit(folder, layer, change):
    """Edit a layer of the copy as GDAL and QGIS do: read, change, write in its place."""
    path = folder.parent / "edited.gpkg"
    frame = change(gpd.read_file(path, layer=layer))
    pyogrio.write_dataframe(frame, path, layer=layer, driver="GPKG")
    return path


def run(*arguments):
    result = CliRunner().invoke(app, ["corrections", *map(str, arguments)])
    return result.exit_code, " ".join(result.output.split())


def with_copy(frame, **changes):
    """Return a layer with a copy of its first row, as pasted in QGIS."""
    copy = frame.iloc[:1].assign(**{"geometry": [shapely.Point(490.0, 880.0, 11.0)], **changes})
    both = gpd.pd.concat([part.astype({"object_id": "object"}) for part in (frame, copy)])
    return gpd.GeoDataFrame(both, crs=frame.crs).astype({"object_id": "Int64"})


def states(folder):
    with open_corrections(folder) as store:
        return {n: (s["status"], s["checked_class"]) for n, s in store.object_states().items()}


def test_edits_of_several_layers_come_back_once(folder):
    def poles(frame):
        frame.loc[frame["object_id"] == 1, "status"] = "accepted"
        frame.loc[frame["object_id"] == 2, "checked_class"] = "sign"
        frame.loc[frame["object_id"] == 1, "geometry"] = shapely.Point(500.5, 900.0, 12.0)
        return frame

    edit(folder, "poles", poles)
    edit(folder, "trees", lambda frame: frame[:0])
    path = edit(folder, "objects", lambda frame: frame.assign(kind=frame["kind"].replace("vehicle", "tree")))
    code, said = run("import", path, folder, "--who", "ann")
    assert (code, "5 new corrections" in said) == (0, True), said
    assert states(folder) == {
        1: ("accepted", "pole"), 2: ("changed", "sign"), 4: ("rejected", ""), 5: ("changed", "tree"),
    }  # fmt: skip
    with open_corrections(folder) as store:
        assert store.object_states()[1]["x"] == 500.5
        assert {decision.who for decision in store.current()} == {"ann"}
    assert "0 new corrections" in run("import", path, folder)[1]


def test_new_rows_are_added_objects_and_the_export_holds_them(folder):
    path = edit(folder, "objects", lambda frame: with_copy(frame, object_id=None))
    edit(folder, "signs", lambda frame: frame[:0])
    assert "2 new corrections" in run("import", path, folder)[1]
    assert "0 new corrections" in run("import", path, folder)[1]
    code, said = run("export", folder)
    assert (code, "5 objects, 5 were listed" in said) == (0, True), said
    table = gpd.read_file(folder / "corrected.gpkg", layer="objects").set_index("object_id")
    assert sorted(table.index) == [1, 2, 4, 5, 6]
    assert (table.loc[6, "status"], table.loc[6, "x"], table.loc[6, "kind"]) == ("added", 490.0, "pole")
    assert "exists: name another file" in run("export", folder)[1]
    assert run("export", folder, "--overwrite", "--keep-rejected")[0] == 0


def test_an_object_drawn_at_the_origin_is_named(folder):
    origin = {"geometry": [shapely.Point(0.0, 0.0)], "object_id": None}
    path = edit(folder, "objects", lambda frame: with_copy(frame, **origin))
    code, said = run("import", path, folder)
    assert (code, "1 new corrections" in said) == (0, True)
    assert "1 added objects lie up to 1,030 m from the inventory, at (0, 0): check them" in said


def test_the_export_has_added_vehicles_and_the_classes_that_users_gave(folder):
    with open_corrections(folder) as store:
        store.add(Correction("add", kind="vehicle", payload={"x": 510.0, "y": 905.0, "z": 12.0}), who="a")
        store.add(Correction("other_kind", 1, kind="sign"), who="a")
        store.add(Correction("other_kind", 4, payload={"class": "low vegetation"}), who="a")
        bases = [[510.0, 900.0, 12.0], [510.5, 900.0, 12.0]]
        store.add(Correction("split", 2, payload={"bases": bases}), who="a")
    code, said = run("export", folder)
    assert code == 0, said
    table = gpd.read_file(folder / "corrected.gpkg", layer="objects").set_index("object_id")
    kept = {n: (table.loc[n, "class"], table.loc[n, "kind"]) for n in (1, 2, 4, 6, 7)}
    assert kept.pop(7) == ("pole", "pole")
    assert kept == {1: ("sign", "sign"), 2: ("pole", "pole"), 4: ("low vegetation", "tree"), 6: ("vehicle", "vehicle")}
    vehicles = gpd.read_file(folder / "corrected.gpkg", layer="vehicles").set_index("object_id").geometry
    assert vehicles[6] is None and vehicles[5].area == pytest.approx(2.0)
    assert "0 new corrections" in run("import", folder / "corrected.gpkg", folder)[1]


def test_an_object_that_became_a_wall_is_not_rejected_by_the_delivered_inventory(folder):
    record = folder / ".mlsroad/run/run.json"
    record.parent.mkdir(parents=True)
    schemes = {"road_inventory": scheme()}
    settings = {"label": {"survey": "street.laz"}, "classes": {"schemes": schemes}}
    record.write_text(
        json.dumps({"state": "finished", "settings": settings, "summary": {"survey": "a"}, "outputs": []})
    )
    with open_corrections(folder) as store:
        store.add(Correction("other_kind", 1, payload={"class": "wall or fence"}), who="a")
        store.add(Correction("other_kind", 2, kind="sign"), who="a")
    assert run("export", folder)[0] == 0
    delivered = folder / "corrected.gpkg"
    assert gpd.read_file(delivered, layer="objects")["object_id"].tolist() == [2, 3, 4, 5]
    assert "0 new corrections" in run("import", delivered, folder)[1]
    with closing(sqlite3.connect(delivered)) as base, base:
        base.execute("DELETE FROM objects WHERE object_id = 2")
    assert "reject 1" in run("import", delivered, folder)[1]
    assert states(folder) == {1: ("changed", "wall or fence"), 2: ("rejected", "")}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.assign(status="fine"), "unknown status 'fine' of object 1: use accepted, rejected, changed"),
        (lambda f: f.assign(status="changed"), "status changed without another checked_class"),
        (lambda f: f.assign(x=f["x"] + 5), "is not a copy of this inventory"),
        (lambda f: f[:1], "lacks 4 of 5 objects"),
        (lambda f: f.to_crs("EPSG:25833"), "is in ETRS89 / UTM zone 33N, the inventory in ETRS89 / UTM zone 32N"),
        (lambda f: f.set_geometry(f.translate(xoff=30.0)), "object 1 was moved by 30 m, allowed are 20 m"),
        (
            lambda f: f.assign(kind="Tree"),
            "object 1: correction 'other_kind': unknown class 'Tree': use one of pole, sign, tree, vehicle",
        ),
        (
            lambda f: f.assign(checked_class="lamp-post"),
            "object 1: correction 'other_kind': unknown class 'lamp-post': use",
        ),
        (lambda f: with_copy(f, object_id=None, kind=None), "an added row of layer 'objects' has the kind ''"),
        (lambda f: with_copy(f, kind="bollard"), "has the kind 'bollard': use pole, sign, vehicle, tree"),
        (lambda f: f.drop(columns="kind"), "layer 'objects' has no field 'kind'"),
    ],
)
def test_edits_that_cannot_be_understood_are_one_line(folder, change, message):
    code, said = run("import", edit(folder, "objects", change), folder)
    assert (code, message in said) == (1, True), said
    assert states(folder) == {}


def test_a_pasted_feature_is_an_added_object(folder):
    path = edit(folder, "objects", with_copy)
    pyogrio.write_dataframe(
        with_copy(gpd.read_file(path, layer="vehicles"), geometry=[shapely.box(485, 880, 487, 884)]),
        path, layer="vehicles", driver="GPKG",
    )  # fmt: skip
    assert "2 new corrections" in run("import", path, folder)[1]
    with open_corrections(folder) as store:
        added = [decision.correction for decision in store.states().added]
    assert [(a.kind, a.payload["x"], a.payload["y"]) for a in added] == [("pole", 490, 880), ("vehicle", 486, 882)]


def test_a_layer_without_geometry_is_one_line(folder):
    path = folder.parent / "edited.gpkg"
    table = gpd.pd.DataFrame(gpd.read_file(path, layer="poles").drop(columns="geometry"))
    pyogrio.write_dataframe(table, path, layer="poles", driver="GPKG")
    code, said = run("import", path, folder)
    assert (code, "layer 'poles' has no geometry" in said) == (1, True), said


def test_layers_that_contradict_each_other_are_one_line(folder):
    edit(folder, "objects", lambda frame: frame.assign(status=["accepted", None, None, None, None]))
    path = edit(folder, "poles", lambda frame: frame.assign(status=["rejected", None]))
    assert "object 1 is edited in two ways (accept; reject)" in run("import", path, folder)[1]


def test_damaged_and_foreign_files_are_one_line(folder):
    path = folder.parent / "edited.gpkg"
    path.write_bytes(b"no database" * 99)
    assert "not a GeoPackage" in run("import", path, folder)[1]
    path.unlink()
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("CREATE TABLE other (x)")
    code, said = run("import", path, folder)
    assert (code, "edited.gpkg" in said) == (1, True)
    assert "read from .gpkg, .laz and .las" in run("import", folder / "inventory.parquet", folder)[1]


def test_list_prints_each_decision_and_whether_it_matches(folder):
    assert "has no corrections" in run("list", folder)[1]
    path = edit(folder, "objects", lambda frame: frame.assign(status=["accepted", None, None, None, "rejected"]))
    run("import", path, folder, "--who", "ann")
    write_inventory(folder, object_rows()[:3])
    code, said = run("list", folder)
    assert (code, "2 decisions, 1 match no object" in said, "ann" in said) == (0, True, True), said


def moved(frame, wrap=lambda shape: shape):
    """Return a layer whose first point lies 2 m to the east, as another geometry."""
    shapes = [shapely.Point(p.x + 2 * (k == 0), p.y, p.z) for k, p in enumerate(frame.geometry)]
    return frame.set_geometry(gpd.GeoSeries([wrap(shape) for shape in shapes], index=frame.index, crs=frame.crs))


def only(folder, *layers):
    """Leave the named layers in the copy alone."""
    path = folder.parent / "edited.gpkg"
    frames = {layer: gpd.read_file(path, layer=layer) for layer in layers}
    path.unlink()
    for layer, frame in frames.items():
        pyogrio.write_dataframe(frame, path, layer=layer, driver="GPKG")


def test_a_base_moved_in_a_multipoint_is_read(folder):
    only(folder, "poles")
    code, said = run("import", edit(folder, "poles", lambda f: moved(f, lambda p: shapely.MultiPoint([p]))), folder)
    assert code == 0 and "1 new corrections" in said and "Not compared" not in said
    with open_corrections(folder) as store:
        (decision,) = store.current()
    assert decision.correction.action == "move_base" and decision.correction.payload["x"] == pytest.approx(502.0)


def test_names_cut_by_a_shapefile_are_read(folder):
    def cut(frame):
        frame.loc[0, "checked_class"] = "sign"
        return frame.rename(columns={"checked_class": "checked_cl"})

    code, said = run("import", edit(folder, "objects", cut), folder)
    assert code == 0 and "1 new corrections" in said and "other_kind 1" in said and "Not compared" not in said


@pytest.mark.parametrize(
    ("change", "note"),
    [
        (lambda f: f.drop(columns="checked_class"), "layer 'objects' has no field 'checked_class'"),
        (lambda f: f.drop(columns="status"), "layer 'objects' has no field 'status'"),
        (lambda f: f.set_geometry(gpd.GeoSeries([None] * 5, crs=f.crs)), "5 objects of layer 'objects' have no single point (object_id 1, 2, 3, 4, 5)"),
        (lambda f: f.set_geometry(gpd.GeoSeries([shapely.Point(), *f.geometry[1:]], crs=f.crs)), "1 objects of layer 'objects' have no single point (object_id 1)"),
        (lambda f: f.set_geometry(gpd.GeoSeries([shapely.LineString([(0, 0), (9, 9)]), *f.geometry[1:]], crs=f.crs)), "1 objects of layer 'objects' have no single point (object_id 1)"),
        (lambda f: f.set_geometry(gpd.GeoSeries([shapely.MultiPoint([(0, 0), (9, 9)]), *f.geometry[1:]], crs=f.crs)), "1 objects of layer 'objects' have no single point (object_id 1)"),
    ],
)  # fmt: skip
def test_what_cannot_be_compared_is_named_and_counted(folder, change, note):
    code, said = run("import", edit(folder, "objects", change), folder)
    assert (code, "0 new corrections" in said, "Not compared, not as it stands, or far away (1):" in said) == (
        0,
        True,
        True,
    )
    assert note in said


def drop_triggers(base):
    """Drop the triggers of GDAL, which call functions of its own."""
    for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
        base.execute(f'DROP TRIGGER "{name}"')


def test_broken_geometry_is_named(folder):
    only(folder, "poles")
    path = folder.parent / "edited.gpkg"
    with closing(sqlite3.connect(path)) as base, base:
        drop_triggers(base)
        base.execute("UPDATE poles SET geom = substr(geom, 1, 20) WHERE object_id = 2")
        base.execute("UPDATE poles SET geom = x'0011' WHERE object_id = 1")
    code, said = run("import", path, folder)
    assert code == 0 and "2 objects of layer 'poles' have no single point (object_id 1, 2)" in said


def test_a_view_in_place_of_a_layer_is_refused(folder):
    path = folder.parent / "edited.gpkg"
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("ALTER TABLE poles RENAME TO other")
        base.execute("CREATE VIEW poles AS SELECT fid, object_id, kind, x, y, z, status FROM other")
    code, said = run("import", path, folder)
    assert code == 1 and "layer 'poles' is a view, not a table" in said
    assert states(folder) == {}


@pytest.mark.parametrize("z", [0.0, None])
def test_points_drawn_anew_at_height_zero_get_the_height_of_the_ground(folder, z):
    def flat(frame):
        points = [shapely.Point(p.x + 2, p.y) if z is None else shapely.Point(p.x + 2, p.y, z) for p in frame.geometry]
        return with_copy(frame.set_geometry(gpd.GeoSeries(points, crs=frame.crs)), geometry=[points[0]])

    only(folder, "poles")
    code, said = run("import", edit(folder, "poles", flat), folder)
    assert code == 0 and "3 rows have no height, or 0: the height of the nearest object" in said
    with open_corrections(folder) as store:
        heights = [decision.correction.payload["z"] for decision in store.current()]
    assert heights == [12.0] * 3


def test_a_copy_without_its_log_is_warned_of(folder):
    path = folder.parent / "edited.gpkg"
    with closing(sqlite3.connect(path)) as base:
        drop_triggers(base)
        base.commit()
        base.execute("PRAGMA journal_mode = WAL")
        base.execute("UPDATE objects SET status = 'accepted' WHERE object_id = 1")
        base.commit()
        shutil.copy(path, folder.parent / "alone.gpkg")
    code, said = run("import", folder.parent / "alone.gpkg", folder)
    assert code == 0 and "alone.gpkg-wal is missing, which may hold the last edits" in said
