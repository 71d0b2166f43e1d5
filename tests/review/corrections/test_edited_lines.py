"""Lines edited in a GeoPackage come back as decisions: moved, cut, joined, deleted, drawn, of another kind."""

import functools
import re
import shutil

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely
from helpers.corrected import object_rows
from typer.testing import CliRunner

from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_row, line_table
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.commands.app import app
from mlsroad_pipeline.inventory_files.geopackage import write_geopackage
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory, line_vertices
from mlsroad_pipeline.review.corrections import Correction, open_corrections
from mlsroad_pipeline.review.delivery.files import Delivery

PATH = Trajectory.from_positions(np.column_stack([np.linspace(495, 595, 50), np.full(50, 897.0), np.full(50, 14.0)]))
KERBS = [
    [[500.0, 895, 12.0], [510, 895, 12.1], [520, 895, 12.2]],
    [[521.0, 895, 12.2], [530, 895, 12.3]],
    [[540.0, 895, 12.3], [550, 895, 12.4]],
    [[560.0, 895, 12.3], [570, 895, 12.4]],
]
LANES = [[[500.0, 897, 12.0], [530, 897, 12.0]], [[540.0, 897, 12.0], [560, 897, 12.0]]]


@pytest.fixture(scope="module")
def labelled(tmp_path_factory):
    folder = tmp_path_factory.mktemp("labelled")
    rows = [line_row("kerb", np.array(kerb), PATH, height=0.12) for kerb in KERBS]
    rows += [line_row("lane_line", np.array(lane), PATH, score=0.8, width=0.15, pattern="solid") for lane in LANES]
    inventory = RoadInventory(object_rows(), "EPSG:25832", PATH, None, line_table(rows))
    write_geopackage(inventory, folder / "inventory.gpkg")
    return folder


@pytest.fixture
def folder(labelled, tmp_path):
    shutil.copytree(labelled, tmp_path / "out")
    shutil.copy(labelled / "inventory.gpkg", tmp_path / "edited.gpkg")
    return tmp_path / "out"


def edit(folder, layer, change):
    path = folder.parent / "edited.gpkg"
    frame = change(gpd.read_file(path, layer=layer))
    pyogrio.write_dataframe(frame, path, layer=layer, driver="GPKG", geometry_type="Unknown", promote_to_multi=False)
    return path


def reshaped(vertices, number=1):
    """Return an edit that gives a line other vertices."""

    def change(frame):
        shape = vertices if isinstance(vertices, shapely.Geometry) else shapely.LineString(vertices)
        return frame.assign(
            geometry=[shape if n == number else own for n, own in zip(frame["line_id"], frame.geometry, strict=True)]
        )

    return change


def with_rows(frame, shapes, **values):
    """Return a layer with further rows that have the attributes of its first one, as pasted in QGIS."""
    copies = [frame.iloc[:1].assign(**{"geometry": [shape], **values}) for shape in shapes]
    both = pd.concat([part.astype({"line_id": "object"}) for part in (frame, *copies)])
    return gpd.GeoDataFrame(both, crs=frame.crs).astype({"line_id": "Int64"})


def run(folder, *options):
    result = CliRunner().invoke(
        app, ["corrections", "import", str(folder.parent / "edited.gpkg"), str(folder), *options]
    )
    return result.exit_code, " ".join(result.output.split())


def actions(folder):
    with open_corrections(folder) as store:
        return [decision.correction.action for decision in store.current()]


def delivered(folder):
    """Return kind and vertices of the delivered lines by number."""
    lines = Delivery(folder).corrected.lines
    places = [np.round(vertices, 3).tolist() for vertices in line_vertices(lines)]
    return dict(zip(lines["line_id"].tolist(), zip(lines["kind"], places, strict=True), strict=True))


LISTED = {k + 1: ("kerb", kerb) for k, kerb in enumerate(KERBS)} | {
    k + 5: ("lane_line", lane) for k, lane in enumerate(LANES)
}
FIRST, SECOND = KERBS[0][:2], KERBS[0][1:]
MOVED = [[500.0, 895, 12.0], [510, 894.2, 12.1], [520, 895, 12.2]]
DRAWN = [[580.0, 893, 12.5], [590, 893, 12.6]]

EDITS = {
    "moved": (reshaped(MOVED), ["shape_line"], {1: ("kerb", MOVED)}),
    "vertex inserted without a height": (
        reshaped([[500, 895, 12.0], [505, 895.5, 0.0], [510, 895, 12.1], [520, 895, 12.2]]),
        ["shape_line"],
        {1: ("kerb", [[500, 895, 12.0], [505, 895.5, 12.05], [510, 895, 12.1], [520, 895, 12.2]])},
    ),
    "cut": (
        lambda frame: with_rows(reshaped(FIRST)(frame), [shapely.LineString(SECOND)]),
        ["cut_line"],
        {1: ("kerb", FIRST), 7: ("kerb", SECOND)},
    ),
    "cut twice": (
        lambda frame: with_rows(
            reshaped([[510, 895, 12.1], [515, 895, 12.15]])(frame),
            [shapely.LineString(FIRST), shapely.LineString([[515, 895, 12.15], KERBS[0][2]])],
        ),
        ["cut_line", "cut_line"],
        {
            1: ("kerb", FIRST),
            7: ("kerb", [[510, 895, 12.1], [515, 895, 12.15]]),
            8: ("kerb", [[515, 895, 12.15], KERBS[0][2]]),
        },
    ),
    "joined": (
        lambda frame: reshaped([*KERBS[0], *KERBS[1]])(frame)[frame["line_id"] != 2],
        ["join_lines"],
        {1: ("kerb", [*KERBS[0], *KERBS[1]]), 2: None},
    ),
    "deleted": (lambda frame: frame[frame["line_id"] != 3], ["reject_line"], {3: None}),
    "drawn": (
        lambda frame: with_rows(frame, [shapely.LineString(DRAWN)], line_id=None, kind=None),
        ["add_line"],
        {7: ("kerb", DRAWN)},
    ),
    "copied": (
        lambda frame: with_rows(frame, [shapely.LineString(DRAWN)]),
        ["add_line"],
        {7: ("kerb", DRAWN)},
    ),
    "other kind": (
        lambda frame: frame.assign(kind=["stop_line" if n == 3 else "kerb" for n in frame["line_id"]]),
        ["kind_line"],
        {3: ("stop_line", KERBS[2])},
    ),
    "other kind and moved": (
        lambda frame: reshaped(MOVED)(frame).assign(kind=["wire" if n == 1 else "kerb" for n in frame["line_id"]]),
        ["kind_line", "shape_line"],
        {1: ("wire", MOVED)},
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    "names",
    [
        ("moved", "other kind"),
        ("vertex inserted without a height", "deleted"),
        ("joined", "drawn"),
        ("cut",),
        ("cut twice",),
        ("copied",),
        ("other kind and moved",),
    ],
    ids=" and ".join,
)
def test_an_edit_is_the_decision_of_the_page_once(folder, names):
    """Edits of one file are of different lines."""
    made = [EDITS[name] for name in names]
    edit(folder, "kerbs", lambda frame: functools.reduce(lambda done, each: each[0](done), made, frame))
    expected = sorted(action for _, decisions, _ in made for action in decisions)
    code, said = run(folder, "--who", "ann")
    assert code == 0 and f"{len(expected)} new corrections" in said, said
    assert sorted(actions(folder)) == expected
    lines = LISTED | {n: line for _, _, result in made for n, line in result.items()}
    assert delivered(folder) == {n: line for n, line in lines.items() if line is not None}
    assert ("no height, or 0" in said) == ("height" in names[0])
    assert "0 new corrections" in run(folder)[1] and sorted(actions(folder)) == expected


def test_an_unedited_copy_holds_nothing_also_after_decisions_of_the_page(folder):
    assert "0 new corrections" in run(folder)[1]
    place = {"line": 1, "x": 500.0, "y": 895.0}
    other = {"line": 2, "kind": "kerb", "x": 521.0, "y": 895.0}
    with open_corrections(folder) as store:
        store.add(
            Correction("join_lines", kind="kerb", payload={**place, "other": other, "parts": [[*KERBS[0], *KERBS[1]]]}),
            who="a",
        )
        store.add(
            Correction("kind_line", kind="kerb", payload={"line": 3, "x": 540.0, "y": 895.0, "to": "wire"}), who="a"
        )
        store.add(Correction("reject_line", kind="kerb", payload={"line": 4, "x": 560.0, "y": 895.0}), who="a")
        store.add(Correction("add_line", kind="kerb", payload={"parts": [DRAWN]}), who="a")
    assert "0 new corrections" in run(folder)[1]
    whole = delivered(folder)
    target = folder.parent / "edited.gpkg"
    Delivery(folder).write([target], overwrite=True)  # the corrected inventory may be edited too
    assert "0 new corrections" in run(folder)[1]
    edit(folder, "kerbs", reshaped([*DRAWN, [600.0, 893, 12.6]], number=7))
    assert "shape_line 1" in run(folder)[1]
    assert delivered(folder) == whole | {7: ("kerb", [*DRAWN, [600.0, 893, 12.6]])}


def test_a_row_that_has_lost_its_number_is_its_line_while_its_shape_is_the_same(folder):
    edit(folder, "kerbs", lambda f: f.assign(line_id=f["line_id"].astype("Int64").mask(f["line_id"] == 2)))
    assert "0 new corrections" in run(folder)[1] and delivered(folder) == LISTED


def test_a_line_without_length_is_named(folder):
    edit(folder, "kerbs", reshaped([KERBS[0][0], KERBS[0][0]]))
    assert "1 rows of layer 'kerbs' are no single line (line_id 1)" in run(folder)[1] and actions(folder) == []


def test_what_cannot_be_compared_is_named_and_counted(folder):
    parts = shapely.MultiLineString([KERBS[0][:2], [[514.0, 890, 0], [516, 890, 0]]])
    edit(folder, "kerbs", lambda frame: with_rows(reshaped(parts)(frame), [shapely.Point(1, 2, 3)], line_id=None))
    code, said = run(folder)
    assert code == 0 and "0 new corrections" in said
    assert "2 rows of layer 'kerbs' are no single line (line_id 1, new)" in said
    assert actions(folder) == []


@pytest.mark.parametrize(
    ("change", "n"),
    [
        (lambda f: with_rows(f, [shapely.LineString([[0.0, 0, 0], [1, 0, 0]])], line_id=None), 2),
        (reshaped([*KERBS[0][:2], [0.0, 0, 12.2]]), 1),
        (lambda f: with_rows(f, [shapely.LineString([[500.0, 1090, 12], [510, 1090, 12]])], line_id=None), 0),
    ],
    ids=["drawn at the origin", "vertex at the origin", "195 m away"],
)
def test_lines_far_from_the_inventory_are_named(folder, change, n):
    edit(folder, "kerbs", change)
    code, said = run(folder)
    assert code == 0 and "1 new corrections" in said
    found = re.findall(r"(\d+) vertices of lines lie up to (\S+) m from the inventory, at \((\S+), 0\): check", said)
    assert found == ([(str(n), "1,025", "0")] if n else [])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda f: f.assign(kind="curb"),
            "layer 'kerbs' has a row of the kind 'curb': use kerb, wire, barrier, lane_line",
        ),
        (lambda f: f.assign(x=f["x"] + 5), "is not a copy of this inventory (line 1 of layer 'kerbs' is another one)"),
        (lambda f: f.drop(columns="line_id"), "layer 'kerbs' has no field 'line_id'"),
        (lambda f: f[:0], "lacks 4 of 6 lines, which would be rejected: is it whole? --many-deleted accepts it"),
        (reshaped([[500.0, 800, 12], [520, 800, 12]]), "line 1 was moved by 95 m, allowed are 20 m: delete its row"),
        (lambda f: f.to_crs("EPSG:25833"), "layer 'kerbs' is in ETRS89 / UTM zone 33N, the inventory in ETRS89"),
    ],
)
def test_errors_are_one_line_and_nothing_is_stored(folder, change, message):
    edit(folder, "kerbs", change)
    code, said = run(folder)
    assert code == 1 and message in said and actions(folder) == []


def test_many_deleted_lines_are_rejected_where_that_is_meant(folder):
    edit(folder, "kerbs", lambda frame: frame[:0])
    assert "reject_line 4" in run(folder, "--many-deleted")[1]
    assert sorted(delivered(folder)) == [5, 6]
