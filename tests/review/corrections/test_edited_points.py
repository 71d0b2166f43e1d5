"""Corrections from a LAZ whose classes were edited: in order, reordered, cut; points that are none of the file."""

import json
import shutil

import laspy
import numpy as np
import pytest
from helpers.corrected import object_rows, write_inventory
from helpers.labelled import scheme
from typer.testing import CliRunner

from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.execution.run_folder import entries_of
from mlsroad_pipeline.review.corrections import Correction, open_corrections


@pytest.fixture
def folder(tmp_path):
    """A folder as `label` leaves it: a record, an inventory and a labelled file with names of classes."""
    out = tmp_path / "out"
    (out / ".mlsroad" / "run").mkdir(parents=True)
    write_inventory(out, object_rows())
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.scales = [0.001] * 3
    las.x, las.y, las.z = np.random.default_rng(0).uniform(0, 30, (3, 400))
    las.classification = np.repeat([2, 5, 6, 64], 100)
    entries = np.zeros(256, dtype=[("code", "u1"), ("name", "S15")])
    entries["code"] = np.arange(256)
    for code, name in {2: b"ground", 5: b"tree", 6: b"building", 64: b"pole"}.items():
        entries["name"][code] = name
    las.vlrs.append(laspy.VLR("LASF_Spec", 0, "Classification Lookup", entries.tobytes()))
    las.write(out / "street.laz")
    record = {
        "state": "finished",
        "settings": {"label": {"survey": "street.laz"}},
        "summary": {"model": {"name": "general", "version": "1"}, "method": "boosted_trees"},
        "outputs": [{**entry, "path": "street.laz"} for entry in entries_of([str(out / "street.laz")])],
    }
    (out / ".mlsroad" / "run" / "run.json").write_text(json.dumps(record))
    return out


def run(*arguments):
    result = CliRunner().invoke(app, ["corrections", "import", *map(str, arguments)])
    return result.exit_code, " ".join(result.output.split())


def edited(folder, change, name="street.laz"):
    las = laspy.read(folder / "street.laz")
    las = change(las) or las
    path = folder.parent / name
    las.write(path)
    return path


def repaint(las):
    las.classification[[5, 7, 150]] = [6, 6, 64]


def painted(folder):
    with open_corrections(folder) as store:
        return {d.correction.payload["class"]: d.correction.payload["points"] for d in store.states().painted}


@pytest.mark.parametrize("order", ["same", "reversed and cut"])
def test_changed_classes_become_painted_points_once(folder, order):
    def change(las):
        repaint(las)
        if order != "same":
            las.points = las.points[np.arange(380)[::-1]]
        return las

    with open_corrections(folder) as store:  # unchanged in the copy
        store.add(Correction("paint", payload={"file": "street.laz", "points": [9], "class": "tree"}), who="a")
    path = edited(folder, change)
    code, said = run(path, folder)
    assert (code, "2 new corrections" in said) == (0, True), said
    assert ("in order" in said) == (order == "same")
    assert painted(folder) == {"tree": [9], "building": [5, 7], "pole": [150]}
    assert "0 new corrections" in run(path, folder)[1]


def test_files_that_are_no_copies_are_one_line(folder):
    def shifted(las):
        las.x = las.x + 1.0

    code, said = run(edited(folder, shifted), folder)
    assert (code, "400 of 400 points are not in" in said) == (1, True), said

    def strange(las):
        las.classification[3] = 77

    assert "class 77 has no name; known are 2 ground, 5 tree" in run(edited(folder, strange), folder)[1]
    assert "name the labelled file" in run(edited(folder, repaint, "other.laz"), folder)[1]
    assert run(edited(folder, repaint, "other.laz"), folder, "--file", "street.laz")[0] == 0


def test_codes_are_the_classes_of_the_model(folder):
    """The names of standard codes, such as high vegetation, are none of the model."""
    record = folder / ".mlsroad" / "run" / "run.json"
    given = json.loads(record.read_text())
    given["settings"]["classes"] = {"schemes": {name: scheme(name) for name in ("common", "road_inventory", "asprs")}}
    given["summary"]["classes"] = {"natural ground": 100, "tree": 100, "building": 100, "wall or fence": 100}
    las = laspy.read(folder / "street.laz")
    entries = np.zeros(256, dtype=[("code", "u1"), ("name", "S15")])
    entries["code"] = np.arange(256)
    for code in (1, 2, 3, 5, 6, 7, 11, 14, *range(64, 71)):
        entries["name"][code] = f"code {code}".encode()
    las.vlrs[:] = [laspy.VLR("LASF_Spec", 0, "Classification Lookup", entries.tobytes())]
    las.write(folder / "street.laz")
    given["outputs"] = [{**entry, "path": "street.laz"} for entry in entries_of([str(folder / "street.laz")])]
    record.write_text(json.dumps(given))

    def change(las):
        las.classification[:7] = [11, 5, 3, 14, 7, 67, 1]

    path = edited(folder, change)
    assert "7 new corrections" in run(path, folder)[1]
    assert painted(folder) == {
        "paved ground": [0], "tree": [1], "low vegetation": [2], "wire": [3], "low noise": [4], "street furniture": [5],
        "unclassified": [6],
    }  # fmt: skip
    assert "0 new corrections" in run(path, folder)[1]
    shutil.copy(path, folder / "street.laz")
    assert "street.laz was edited since it was written" in run(path, folder)[1]


def test_strokes_on_a_file_with_other_points_are_kept_and_listed(folder):
    path = edited(folder, repaint)
    run(path, folder)
    las = laspy.read(folder / "street.laz")
    las.points = las.points[:300]
    las.write(folder / "street.laz")
    result = CliRunner().invoke(app, ["corrections", "list", str(folder)])
    assert "2 strokes are about files that are missing or have other points" in " ".join(result.output.split())


@pytest.mark.parametrize("point_format", [1, 3])
def test_point_formats_that_cannot_hold_the_classes_are_refused(folder, point_format):
    las = laspy.read(folder / "street.laz")
    old = laspy.LasData(laspy.LasHeader(point_format=point_format, version="1.2"))
    old.header.scales = las.header.scales
    old.x, old.y, old.z = las.x, las.y, las.z
    old.classification = np.asarray(las.classification) & 31  # what programs write: 64 becomes 0
    path = folder.parent / "street.laz"
    old.write(path)
    code, said = run(path, folder)
    assert code == 1 and f"points of format {point_format}, which keeps classes up to 31" in said
    assert painted(folder) == {}
