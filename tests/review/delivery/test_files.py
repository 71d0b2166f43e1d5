"""Files of a delivery: every format has the corrected objects and points; nothing of others is replaced."""

import csv
import re
import shutil
from xml.etree import ElementTree as ET

import ezdxf
import geopandas
import laspy
import numpy as np
import pyogrio
import pytest
from helpers.page_output import FILES, ORIGIN, write_output
from helpers.wiring import REPOSITORY
from typer.testing import CliRunner

from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.review.corrections import Correction, open_corrections
from mlsroad_pipeline.review.delivery.page_order import FORMATS

pytestmark = pytest.mark.filterwarnings("ignore:'crs' was not provided:UserWarning")  # the survey has none
N_POINTS = 68_000


def mlsroad(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Output with a tree that is a pole, a rejected and a split pole, a missing tree and two strokes."""
    place = tmp_path_factory.mktemp("delivery") / "out"
    write_output(place)
    bases = [[*(ORIGIN[:2] + [dx, 0]), 12.0] for dx in (-0.02, 0.05)]
    with open_corrections(place) as store:
        store.add(Correction("other_kind", 4, kind="pole"), who="ann")
        store.add(Correction("reject", 2), who="bob")
        store.add(Correction("split", 1, payload={"bases": bases}), who="ann")
        store.add(Correction("add", kind="tree", payload={"x": 520.0, "y": 901.0, "z": 12.0}), who="ann")
        taken_back = store.add(Correction("accept", 3), who="bob")
        store.undo(taken_back, who="bob")
        for name, points, given in (
            (FILES[0], range(50), "wire"),
            (FILES[0], range(25), "pole"),
            (FILES[1], [7], "wire"),
        ):
            payload = {"file": name, "points": list(points), "class": given, "n_points": N_POINTS}
            store.add(Correction("paint", payload=payload), who="ann")
    return place


EXPECTED = {1: "pole", 3: "sign", 4: "pole", 5: "vehicle", 6: "pole", 7: "tree"}
"""Number and kind of the delivered objects."""


@pytest.mark.parametrize("suffix", ["gpkg", "parquet", "csv", "fgb", "shp", "gml"])
def test_tables_have_the_corrected_objects(folder, tmp_path, suffix):
    target = tmp_path / f"mine.{suffix}"
    done = mlsroad("export", folder, "-o", target)
    assert done.exit_code == 0, done.output
    if suffix == "parquet":
        found = geopandas.read_parquet(target)
    else:
        found = pyogrio.read_dataframe(target, layer="objects" if suffix == "gpkg" else None)
    assert dict(zip(found["object_id"].astype(int), found["kind"], strict=True)) == EXPECTED
    status = dict(zip(found["object_id"].astype(int), found["status"].fillna(""), strict=True))
    assert (status[1], status[4], status[6], status[7]) == ("split", "changed", "split", "added")
    assert sorted(path.name for path in tmp_path.iterdir())[0] == ("mine.cpg" if suffix == "shp" else f"mine.{suffix}")
    assert all(path.name.startswith("mine") for path in tmp_path.iterdir())


def test_opendrive_has_the_corrected_objects_and_lines(folder, tmp_path):
    done = mlsroad("export", folder, "-o", tmp_path / "mine.xodr")
    assert done.exit_code == 0, done.output
    road = ET.parse(tmp_path / "mine.xodr").find("road")
    kinds = {int(node.get("id")): node.get("subtype") for node in road.find("objects") if node.get("id").isdigit()}
    assert kinds | {int(node.get("id")): "sign" for node in road.find("signals")} == EXPECTED
    assert [node.get("id") for node in road.iter("object")][-1] == "line_1"
    said = " ".join(done.output.split())
    assert " mine.xodr has no geoReference" in said and ".mlsroad-" not in said


def test_the_page_offers_every_format():
    source = (REPOSITORY / "page/src/deliver.ts").read_text(encoding="utf-8")
    assert set(re.findall(r'\["(\.[\w.]+)", ', source)) == set(FORMATS) - {".json"}


def test_several_files_after_one_option_and_a_drawing(folder, tmp_path):
    done = mlsroad("export", folder, "-o", tmp_path / "a.dxf", tmp_path / "b.csv", "--checked")
    assert done.exit_code == 0, done.output
    blocks = ezdxf.readfile(tmp_path / "a.dxf").modelspace().query("INSERT")
    assert sorted(block.dxf.name for block in blocks) == ["POLE", "POLE", "POLE", "TREE"]
    with (tmp_path / "b.csv").open() as stream:
        assert [row["object_id"] for row in csv.DictReader(stream)] == ["1", "4", "6", "7"]
    assert "4 objects, 5 were listed" in done.output


def test_points_have_the_classes_and_objects_of_the_decisions(folder, tmp_path):
    before = [laspy.read(folder / name) for name in FILES]
    done = mlsroad("export", folder, "-o", f"{tmp_path}/laz/")
    assert done.exit_code == 0, done.output
    after = [laspy.read(tmp_path / "laz" / name) for name in FILES]
    for old, new in zip(before, after, strict=True):
        for name in ("X", "Y", "Z", "intensity", "red", "original_classification"):
            np.testing.assert_array_equal(old[name], new[name])
    codes, numbers = np.asarray(after[0].classification), np.asarray(after[0].object_id)
    own = np.asarray(before[0].object_id)
    assert set(codes[:25]) == {64} and set(codes[25:50]) == {14} and codes[50] == 11
    assert set(codes[own == 2]) == {1} and set(numbers[own == 2]) == {0}  # rejected, without a class
    assert set(codes[own == 4]) == {64} and set(numbers[own == 4]) == {4}  # a tree that is a pole
    x = np.asarray(before[0].x) - ORIGIN[0]
    np.testing.assert_array_equal(numbers[own == 1], np.where(x[own == 1] > 0.015, 6, 1))
    changed = np.flatnonzero(np.asarray(before[1].classification) != after[1].classification)
    assert changed.tolist() == [7]
    confidence = np.asarray(after[0].confidence)
    assert (confidence[0], confidence[own == 2][0]) == (1.0, 0.0) and confidence[60] == np.float32(0.8)


def test_the_protocol_names_decisions_users_and_what_is_left(folder, tmp_path):
    done = mlsroad("export", folder, "-o", tmp_path / "check.html")
    assert done.exit_code == 0, done.output
    page = re.sub(r"<[^>]+>", " ", (tmp_path / "check.html").read_text(encoding="utf-8"))
    text = " ".join(page.split())
    assert "decisions in force 7 taken back 1" in text
    # listed, looked at, right, wrong, other kind, added, left, delivered
    assert "pole 2 2 1 1 0 2 0 3 0.50 (0.50 to 0.50) 1.00 (1.00 to 1.00)" in text
    assert "sign 1 0 0 0 0 0 1 1 – – –" in text and "tree 1 1 0 0 1 1 0 1" in text
    assert "kerb 1 95" in text
    assert "&lt;i&gt;survey.laz" in page and "http" not in page.replace("http-equiv", "")
    with (tmp_path / "check_decisions.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["who"] for row in rows] == ["ann", "bob", "ann", "ann", "bob", "ann", "ann", "ann"]
    assert [bool(row["taken_back_utc"]) for row in rows] == [k == 4 for k in range(8)]
    assert (rows[5]["points"], rows[5]["given"], rows[5]["object"]) == ("50", "wire", "")


def last_line(done):
    return done.output.strip().splitlines()[-1]


def test_nothing_is_replaced_and_errors_leave_no_file(folder, tmp_path):
    kept = tmp_path / "kept_lines.csv"
    kept.write_text("mine")
    state = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and ".sqlite" not in path.name}
    cases = {
        (tmp_path / "kept.csv",): "kept_lines.csv exists: name another file with -o, or replace it with --overwrite",
        (folder / "inventory.gpkg", "--overwrite"): "is a result of label or a file of the survey: choose another name",
        (folder / FILES[0], "--overwrite"): "is a result of label",
        (tmp_path / "x.pdf",): "unknown format '.pdf': the name of a delivered file ends in .gpkg",
        (kept / "x.csv",): "kept_lines.csv is a file, not a folder",
        (tmp_path / "none/x.csv",): "none does not exist: create the folder first",
        (tmp_path / "x.laz",): f"the survey has 2 labelled files: name a folder for them, such as {tmp_path}/x/",
        (tmp_path / "y.csv", tmp_path / "x.geojson"): "GeoJSON needs longitudes and latitudes",
    }
    for targets, message in cases.items():
        done = mlsroad("export", folder, "-o", *targets)
        assert done.exit_code == 1 and message in last_line(done), (targets, done.output)
        assert [path.name for path in tmp_path.iterdir()] == ["kept_lines.csv"] and kept.read_text() == "mine"
    assert {path: path.read_bytes() for path in state} == state
    assert mlsroad("export", tmp_path, "-o", tmp_path / "z.csv").exit_code == 1
    assert mlsroad("export", folder, tmp_path / "z.csv").exit_code == 2
    assert mlsroad("export", folder, "-o", tmp_path / "kept.csv", "--overwrite").exit_code == 0
    assert kept.read_text() != "mine"


@pytest.mark.parametrize("ending", ["-wal", "-shm", "-journal"])
def test_a_geopackage_that_a_program_has_open_is_not_replaced(folder, tmp_path, ending):
    target = tmp_path / "mine.gpkg"
    assert mlsroad("export", folder, "-o", target).exit_code == 0
    before = target.read_bytes()
    (tmp_path / f"mine.gpkg{ending}").write_bytes(b"rows that are not in the database yet")
    done = mlsroad("export", folder, "-o", target, "--overwrite")
    assert (
        done.exit_code == 1
        and f"is open in another program, or was not closed by it (there is mine.gpkg{ending})" in (last_line(done))
    )
    assert target.read_bytes() == before


def test_a_folder_without_the_record_of_label_is_warned_of(folder, tmp_path):
    copied = shutil.copytree(folder, tmp_path / "copied")
    shutil.rmtree(copied / ".mlsroad")
    done = mlsroad("export", copied, "-o", tmp_path / "x.gpkg")
    assert done.exit_code == 0 and "has no record of label in .mlsroad" in " ".join(done.output.split())


def test_a_survey_without_a_reference_system_names_the_file_that_was_asked_for(folder, tmp_path):
    done = mlsroad("export", folder, "-o", tmp_path / "mine.geojson")
    assert f"{tmp_path}/mine.geojson: GeoJSON needs" in last_line(done) and "label.export" not in done.output
