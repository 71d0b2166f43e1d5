"""The command `mlsroad road` on a planted labelled street: measures, layers, sections across the road, errors."""

import json

import ezdxf
import geopandas as gpd
import laspy
import numpy as np
import pandas as pd
import pytest
from helpers.corrected import object_rows
from helpers.labelled import scheme as configured_scheme
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_row, line_table
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.execution.run_folder import entries_of
from mlsroad_pipeline.inventory_files.geopackage import write_geopackage
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory

ORIGIN = np.array([389_000.0, 5_819_000.0, 35.0])
LENGTH, LEFT, RIGHT, KERB = 60, 4.0, -2.5, 0.12  # metres; y is positive on the left
SLOPE, CROSSFALL = 0.03, 0.025
SCHEME = ClassScheme.from_config("road_inventory", configured_scheme())
CODES = dict(zip(SCHEME.classes, SCHEME.codes(SCHEME).tolist(), strict=True))
BRANCH, SIGN = 7, 3  # numbers of the object above the road and of a sign


def surface(x, y):
    step = np.where((y > LEFT) | (y < RIGHT), KERB, 0.0)
    return SLOPE * x + CROSSFALL * y + step


def street_points():
    """Return points, codes and objects: a street with kerbs, a branch at 20 to 22 m, a lorry, a stray point."""
    rng = np.random.default_rng(11)
    ground = np.column_stack([rng.uniform(-2, LENGTH + 2, 400_000), rng.uniform(-8, 8, 400_000)])
    z = surface(*ground.T) + rng.normal(0, 0.003, len(ground))
    branch = np.column_stack([rng.uniform(20, 22, 600), rng.uniform(0.2, 0.8, 600)])
    low = surface(*branch.T) + np.append(3.2, rng.uniform(3.2, 4.0, 599))
    lorry = rng.uniform([40, 1, 2.4], [47, 3, 3.6], (2000, 3)) + [0, 0, 1.2]
    stray = np.array([[50.5, 0.0, surface(50.5, 0.0) + 2.2]])
    parts = [np.column_stack([ground, z]), np.column_stack([branch, low]), lorry, stray]
    kinds = [CODES[name] for name in ("paved ground", "tree", "vehicle", "tree")]
    codes = np.repeat(kinds, [len(part) for part in parts])
    codes[: len(ground)][np.abs(ground[:, 1]) > 6] = CODES["natural ground"]
    return np.concatenate(parts) + ORIGIN, codes, np.where(np.arange(len(codes)) < len(ground), 0, BRANCH)


def write_street(folder, *, trajectory=True):
    """Write the output of a finished run of `label`, and return the points."""
    xyz, codes, objects = street_points()
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.scales, las.header.offsets = [0.001] * 3, ORIGIN
    las.add_extra_dim(laspy.ExtraBytesParams("object_id", "u4"))
    las.xyz, las.classification, las.object_id = xyz, codes, objects
    folder.mkdir()
    las.write(str(folder / "street.laz"))
    path = Trajectory.from_positions(np.array([[0.0, 0, 2.5], [LENGTH, 0, 2.5 + SLOPE * LENGTH]]) + ORIGIN)
    ends = np.array([0.0, LENGTH])
    kerbs = [np.column_stack([x, np.full(2, y), np.zeros(2)]) + ORIGIN for x, y in ((ends, LEFT), (ends[::-1], RIGHT))]
    lines = line_table([line_row("kerb", kerb, path) for kerb in kerbs])
    objects = object_rows()
    values = [*(ORIGIN + [30, 1.2, surface(30, 1.2)]), 5.0, 270.0, "post"]
    objects.loc[objects["object_id"] == SIGN, ["x", "y", "z", "panel_centre", "facing", "facing_from"]] = values
    inventory = RoadInventory(objects, "EPSG:25833", path if trajectory else None, None, lines)
    write_geopackage(inventory, folder / "inventory.gpkg")
    schemes = {"road_inventory": configured_scheme()}
    run = {
        "format": 1, "state": "finished",
        "settings": {"label": {"method": "pool", "scheme": SCHEME.name}, "classes": {"schemes": schemes, "codings": {}}},
        "summary": {"survey": "street.laz", "classes": {"paved ground": 1, "tree": 1}, "method": "pool", "model": "pool"},
        "outputs": [{**entry, "path": name} for name in ("street.laz", "inventory.gpkg")
                    for entry in entries_of([str(folder / name)])],
    }  # fmt: skip
    record = folder / ".mlsroad/0123456789ab/run.json"
    record.parent.mkdir(parents=True)
    record.write_text(json.dumps(run), encoding="utf-8")
    return np.asarray(las.xyz)


@pytest.fixture(scope="module")
def street(run, tmp_path_factory):
    """The street, its points and the finished command."""
    place = tmp_path_factory.mktemp("road")
    xyz = write_street(place / "street")
    done = run("road", "street", "--envelope", "3.0x3.5", "--at", "21,30.5", cwd=place)
    assert done.returncode == 0, done.stderr
    return place, xyz, done


@pytest.fixture(scope="module")
def table(street):
    return pd.read_csv(street[0] / "street/road/road.csv")


def test_a_planted_road_is_measured(table):
    inner = table.iloc[3:-3]
    assert len(table) == LENGTH and table["station"].tolist() == (np.arange(LENGTH) + 0.5).tolist()
    assert inner["width"].to_numpy() == pytest.approx(np.full(len(inner), LEFT - RIGHT), abs=0.01)
    assert set(inner["left_edge"]) == set(inner["right_edge"]) == {"kerb"}
    assert inner["crossfall"].to_numpy() == pytest.approx(np.full(len(inner), 100 * CROSSFALL), abs=0.05)
    assert inner["slope"].to_numpy() == pytest.approx(np.full(len(inner), 100 * SLOPE), abs=0.05)
    assert inner[["rut_left", "rut_right"]].to_numpy().max() < 5.0


def test_the_lowest_branch_counts_but_neither_a_lorry_nor_a_stray_point(table):
    under = table[table["clearance"].notna()]
    assert set(under["station"]) == {20.5, 21.5} and set(under["clearance_class"]) == {"tree"}
    assert under["clearance"].min() == pytest.approx(3.2, abs=0.02) and set(under["clearance_object"]) == {BRANCH}
    inside = table[table["envelope"] == "intruded"]
    assert set(inside["station"]) <= {20.5, 21.5} and inside["intrusion"].min() == pytest.approx(3.2, abs=0.02)
    assert set(table["envelope"]) == {"free", "intruded"}


def test_layers_and_sections_have_the_measures(street, table):
    place = street[0] / "street/road"
    layers = {n: gpd.read_file(place / "road.gpkg", layer=n) for n in ("road", "road_widths", "road_sections")}
    assert layers["road"].crs is not None and layers["road"].length.sum() == pytest.approx(LENGTH, abs=0.01)
    widths = layers["road_widths"]
    assert widths.length.to_numpy() == pytest.approx(widths["width"].to_numpy(), abs=0.002)
    section = pd.read_csv(place / "road_sections.csv").iloc[0]
    assert section["width"] == table["width"].median() and section["least_clearance"] == table["clearance"].min()
    assert layers["road_sections"]["crossfall"].tolist() == [section["crossfall"]]
    (place_of_branch,) = gpd.read_file(place / "road.gpkg", layer="intrusions").to_dict("records")
    inside = table[table["envelope"] == "intruded"]
    assert place_of_branch["from_station"] == inside["station"].min() - 0.5 and place_of_branch["state"] == "intruded"
    assert place_of_branch["to_station"] == inside["station"].max() + 0.5
    assert place_of_branch["height"] == inside["intrusion"].min() and place_of_branch["object_id"] == BRANCH
    lowest = inside.loc[inside["intrusion"].idxmin()]
    assert place_of_branch["geometry"].z == pytest.approx(lowest["z"] + lowest["intrusion"], abs=0.002)
    places = pd.read_csv(place / "road_places.csv")
    assert (places["state"] == "measured").sum() == LENGTH / 10
    assert places["reason"].str.startswith("width 6.50 m, crossfall 2.5").sum() >= 5
    assert "Along the path" in (place / "road.html").read_text()


@pytest.mark.parametrize("station", [21.0, 30.5])
def test_sections_across_the_road_are_points_of_the_cloud(street, station):
    place, xyz, _ = street
    name = place / f"street/road/section_{station:09.2f}"
    points = pd.read_csv(f"{name}.csv")
    expected = xyz[np.abs(xyz[:, 0] - ORIGIN[0] - station) <= 0.2499]
    places = points[["x", "y", "z"]].to_numpy()
    assert cKDTree(xyz).query(places)[0].max() < 0.002 and cKDTree(places).query(expected)[0].max() < 0.002
    assert points["offset"].to_numpy() == pytest.approx(ORIGIN[1] - points["y"].to_numpy(), abs=0.002)
    drawing = ezdxf.readfile(f"{name}.dxf")
    assert not drawing.audit().errors
    drawn = np.array([point.dxf.location for point in drawing.modelspace().query("POINT")])
    assert len(drawn) > 300 and np.all(drawn[:, 2] == 0)
    assert cKDTree(points[["offset", "z"]].to_numpy()).query(drawn[:, :2])[0].max() < 0.01
    (line,) = drawing.modelspace().query("LWPOLYLINE")
    profile = np.array([vertex[:2] for vertex in line])
    assert profile[:, 1] == pytest.approx(surface(station, -profile[:, 0]) + ORIGIN[2], abs=0.15)
    assert "<svg" in name.with_suffix(f"{name.suffix}.svg").read_text(encoding="utf-8")
    assert f"Station {station:.2f} m" in [text.dxf.text for text in drawing.modelspace().query("TEXT")]


def test_measures_are_not_replaced_unasked_and_are_the_same_again(run, street):
    place, _, done = street
    assert "Measured 60 m of road" in done.stdout and "intruded in" in done.stdout
    again = run("road", "street", cwd=place)
    assert again.returncode == 1 and "holds measures of a road" in again.stderr and again.stderr.count("\n") == 1
    other = run("road", "street", "--envelope", "3.0x3.5", "-o", "other", cwd=place)
    assert other.returncode == 0, other.stderr
    for name in ("road.csv", "road_sections.csv", "road.gpkg"):
        assert (place / "other" / name).read_bytes() == (place / "street/road" / name).read_bytes()


def test_sections_of_earlier_measures_go(run, street):
    place = street[0]
    for at in ("20,40", "30"):
        done = run("road", "street", "--at", at, "-o", "again", "--overwrite", cwd=place)
        assert done.returncode == 0, done.stderr
        (place / "again/section_notes.txt").write_text("mine")
    names = {path.name for path in (place / "again").glob("section_*")}
    assert names == {"section_notes.txt", *(f"section_000030.00.{end}" for end in ("csv", "svg", "dxf"))}
    assert not (place / "street/corrections.sqlite").exists()


def test_a_section_at_the_end_of_the_path_is_drawn(run, street):
    done = run("road", "street", "--at", "60", "-o", "end", cwd=street[0])
    assert done.returncode == 0, done.stderr
    points = pd.read_csv(street[0] / "end/section_000060.00.csv")
    assert len(points) > 300 and points["station"].min() >= LENGTH - 0.25


def test_a_sign_behind_a_branch_is_seen_from_nearby_alone(street):
    """The branch above x = 20 to 22 hides the sign at x = 30 from eyes before x = 10; its voxels reach further."""
    place = street[0] / "street/road"
    (sign,) = pd.read_csv(place / "road_signs.csv").to_dict("records")
    assert sign["object_id"] == SIGN and sign["station"] == 30.0 and sign["offset"] == -1.2
    assert sign["sight_end"] == "hidden" and sign["hidden_by"] == "tree" and 15 < sign["sight"] < 21
    way = gpd.read_file(place / "road.gpkg", layer="sight").iloc[0]
    assert way.geometry.length == pytest.approx(sign["sight"], abs=1.5) and way["hidden_by"] == "tree"
    assert "Sight to signs" in (place / "road.html").read_text()


def test_without_a_path_the_main_axis_or_a_named_path_serves(run, street):
    place = street[0]
    write_street(place / "without", trajectory=False)
    done = run("road", "without", cwd=place)
    assert done.returncode == 0 and "The survey has no path" in " ".join(done.stdout.split())
    named = pd.DataFrame([[*ORIGIN], [*(ORIGIN + [LENGTH, 0, 2])]], columns=list("xyz"))
    named.to_csv(place / "path.csv", index=False)
    done = run("road", "without", "--path", "path.csv", "-o", "named", cwd=place)
    assert done.returncode == 0 and "no path" not in done.stdout
    widths = [pd.read_csv(place / folder / "road.csv")["width"].median() for folder in ("without/road", "named")]
    assert widths == pytest.approx([LEFT - RIGHT] * 2, abs=0.02)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("none",), 1, "none does not exist"),
        (("street", "-o", "x", "--at", "75"), 1, "--at 75: the path has stations from 0 to 60"),
        (("street", "-o", "x", "--path", "none.csv"), 1, "none.csv does not exist"),
        (("street", "-o", "x", "--path", "far.csv"), 1, "no paved ground within 1.5 m of the path"),
        (("street", "-o", "x", "--path", "trees.csv"), 1, "trees.csv is not a path: 8 of 8 steps turn back"),
        (("street", "-o", "far.csv"), 1, "far.csv is a file: name a folder with --output"),
        (("street", "-o", "far.csv/x"), 1, "far.csv is a file: name a folder with --output"),
        (("street", "--at", "12,b"), 2, "'b' is not a station"),
        (("street", "--envelope", "4.5"), 2, "'4.5' must be width x height"),
        (("street", "--envelope", "0x3"), 2, "'0x3' must be width x height"),
    ],
)
def test_errors_name_the_value(run, street, arguments, code, message):
    place = street[0]
    far = pd.DataFrame([[0.0, 0, 0], [50, 0, 0]], columns=list("xyz"))
    far.to_csv(place / "far.csv", index=False)
    trees = pd.DataFrame({"x": np.tile([5.0, 50.0], 5), "y": np.arange(10.0), "z": 0.0}) + ORIGIN
    trees.to_csv(place / "trees.csv", index=False)
    done = run("road", *arguments, cwd=place)
    plain = " ".join(done.stderr.replace("│", " ").split())
    assert done.returncode == code and message in plain and not (place / "x").exists()
