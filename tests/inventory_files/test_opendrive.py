"""OpenDRIVE read again: its structure, and places of objects and lines computed from its own geometry alone."""

import math
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd
import pytest
from helpers.inventories import UTM, planted, planted_inventory
from pyproj import Transformer

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_KINDS
from mlsroad_pipeline.algorithms.inventory.objects.table import OBJECT_FIELDS
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.inventory_files.opendrive import write_opendrive
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory, line_vertices

ROAD = ["planView", "elevationProfile", "lanes", "objects", "signals"]


def bend():
    """Return an inventory on both sides of a bend of 90 degrees, driven with noise, with objects beyond its ends."""
    rng = np.random.default_rng(3)
    angle = np.linspace(0, np.pi / 2, 400)
    path = np.column_stack([30 * np.sin(angle), 30 - 30 * np.cos(angle), 36.5 + angle])
    path[:, :2] += [391_000, 5_820_000] + rng.normal(0, 0.01, (400, 2))
    places = rng.uniform([-20, -25], [60, 60], (60, 2)) + [391_000, 5_820_000]
    kinds = ["pole", "tree", "sign", "vehicle"] * 15
    more = {
        "diameter": 0.25,
        "crown_diameter": 6.0,
        "length": 4.5,
        "heading": 30.0,
        "facing": 200.0,
        "facing_from": "post",
    }
    rows = [
        planted(k + 1, kind, **more) | {"x": x, "y": y, "z": 34 + 0.1 * (k % 7)}
        for k, (kind, (x, y)) in enumerate(zip(kinds, places.tolist(), strict=True))
    ]
    objects = pd.DataFrame(rows)[list(OBJECT_FIELDS)].astype(OBJECT_FIELDS)
    return RoadInventory(objects, UTM, Trajectory.from_positions(path))


@pytest.fixture(scope="module", params=["straight", "bend"])
def both(request, tmp_path_factory):
    """Return an inventory and the root of its file."""
    inventory = planted_inventory() if request.param == "straight" else bend()
    target = tmp_path_factory.mktemp(request.param) / "x.xodr"
    write_opendrive(inventory, target)
    first = target.read_bytes()
    write_opendrive(inventory, target)
    assert target.read_bytes() == first
    return inventory, ET.parse(target).getroot()


def number(node, name):
    return float(node.get(name))


def piece_at(road, s):
    """Return place and heading of the reference line, from the attributes of its pieces."""
    own = [piece for piece in road.find("planView") if number(piece, "s") <= s + 1e-9][-1]
    way, heading, arc = s - number(own, "s"), number(own, "hdg"), own.find("arc")
    x, y = number(own, "x"), number(own, "y")
    if arc is None:
        return x + way * math.cos(heading), y + way * math.sin(heading), heading
    k = number(arc, "curvature")
    turned = heading + k * way
    return x + (math.sin(turned) - math.sin(heading)) / k, y - (math.cos(turned) - math.cos(heading)) / k, turned


def world(road, s, t, above):
    x, y, heading = piece_at(road, s)
    record = [entry for entry in road.find("elevationProfile") if number(entry, "s") <= s][-1]
    z = number(record, "a") + number(record, "b") * (s - number(record, "s")) + above
    return [x - t * math.sin(heading), y + t * math.cos(heading), z]


def place_of(road, node, z="zOffset"):
    return world(road, number(node, "s"), number(node, "t"), number(node, z))


def test_the_structure_is_that_of_the_format(both):
    inventory, root = both
    header, road = root.find("header"), root.find("road")
    assert (root.tag, header.get("revMajor"), header.get("revMinor")) == ("OpenDRIVE", "1", "7")
    there, here = (
        Transformer.from_crs(system, "OGC:CRS84", always_xy=True).transform(391_000, 5_820_000)
        for system in (header.find("geoReference").text, UTM)
    )
    assert there == pytest.approx(here, abs=1e-7) and here[0] == pytest.approx(13.4, abs=0.1)
    objects = inventory.objects
    assert number(header, "west") <= objects["x"].min() + 1e-4 and objects["y"].max() <= number(header, "north") + 1e-4
    assert [child.tag for child in road] == ROAD and road.get("junction") == "-1"
    pieces = list(road.find("planView"))
    ends = [number(piece, "s") + number(piece, "length") for piece in pieces]
    np.testing.assert_allclose(ends, [*(number(piece, "s") for piece in pieces[1:]), number(road, "length")], atol=2e-4)
    for piece, end in zip(pieces[1:], ends, strict=False):  # each begins where the one before ends, in its direction
        x, y, heading = piece_at(road, end - 1e-6)
        assert math.dist((x, y), (number(piece, "x"), number(piece, "y"))) < 1e-3
        assert abs(math.remainder(heading - number(piece, "hdg"), math.tau)) < 1e-3
    heights = [number(entry, "s") for entry in road.find("elevationProfile")]
    assert heights[0] == 0 and heights == sorted(set(heights))
    [lane] = road.findall("lanes/laneSection/right/lane")
    assert (lane.get("id"), lane.get("type")) == ("-1", "none") and number(lane.find("width"), "a") > 0
    items = [*road.find("objects"), *road.find("signals")]
    identifiers = [node.get("id") for node in items]
    assert len(identifiers) == len(set(identifiers)) == len(objects) + len(LINE_KINDS) * (inventory.lines is not None)
    assert all(0 <= number(node, "s") <= number(road, "length") for node in items)
    needed = {"id", "s", "t", "zOffset", "dynamic", "orientation", "type", "subtype"}
    assert all(needed <= set(node.attrib) for node in road.find("signals"))


def test_objects_and_signals_lie_within_a_centimetre_of_the_inventory(both):
    inventory, root = both
    road = root.find("road")
    items = {node.get("id"): node for node in [*road.find("objects"), *road.find("signals")]}
    for row in inventory.objects.to_dict("records"):
        bottom = row["panel_bottom"] if row["panel_bottom"] > 0 else 0.0
        found = place_of(road, items[str(row["object_id"])])
        assert math.dist(found, (row["x"], row["y"], row["z"] + bottom)) < 0.01, row["object_id"]


def test_lines_are_open_outlines(both):
    inventory, root = both
    if inventory.lines is None:
        assert root.find(".//outline") is None
        return
    road = root.find("road")
    for row, vertices in zip(inventory.lines.to_dict("records"), line_vertices(inventory.lines), strict=True):
        [own] = [node for node in road.find("objects") if node.get("id") == f"line_{row['line_id']}"]
        outline = own.find("outlines/outline")
        assert (own.get("subtype"), outline.get("closed")) == (row["kind"], "false")
        np.testing.assert_allclose([place_of(road, corner, "dz") for corner in outline], vertices, atol=0.01)
        assert {data.get("code"): data.get("value") for data in own.findall("userData")}["score"] == "0.75"


def test_sizes_and_directions(both):
    inventory, root = both
    road, bent = root.find("road"), inventory.lines is None
    for node in [*road.find("objects"), *road.find("signals")]:
        if node.get("id").startswith("line"):
            continue
        row = inventory.objects.set_index("object_id").loc[int(node.get("id"))]
        assert {data.get("code") for data in node.findall("userData")} >= {"class", "score", "point_count"}
        heading = piece_at(road, number(node, "s"))[2]
        if row["kind"] == "vehicle":
            assert (node.get("type"), node.get("subtype"), number(node, "length")) == ("obstacle", "vehicle", 4.5)
            azimuth = 90 - math.degrees(heading + number(node, "hdg"))
            assert math.remainder(azimuth - row["heading"], 360) == pytest.approx(0, abs=0.01)
        elif row["kind"] == "sign" and row["facing_from"] == "post":
            driven = heading + (math.pi if node.get("orientation") == "-" else 0.0)
            assert abs(number(node, "hOffset")) <= math.pi / 2 + 1e-9
            front = 90 - math.degrees(driven + number(node, "hOffset")) + 180
            assert math.remainder(front - row["facing"], 360) == pytest.approx(0, abs=0.01)
        elif row["kind"] == "sign":
            assert node.get("orientation") == "none"
        elif bent:
            assert number(node, "radius") == (3.0 if row["kind"] == "tree" else 0.125)
    [signal] = [node for node in road.find("signals") if node.get("id") == "2"] if not bent else [None]
    if not bent:
        assert signal.find("reference").attrib == {"elementType": "object", "elementId": "1"}


def test_the_road_is_as_high_as_the_bases_of_the_objects(both):
    inventory, root = both
    road = root.find("road")
    near = [
        n for n in [*road.find("objects"), *road.find("signals")] if abs(number(n, "t")) <= 15 and n.get("id").isdigit()
    ]
    kinds = inventory.objects.set_index("object_id")["panel_bottom"].fillna(0.0)
    above = [number(node, "zOffset") - kinds[int(node.get("id"))] for node in near]
    assert np.median(above) == pytest.approx(0, abs=1e-3)


def test_a_survey_without_a_path_has_no_road(tmp_path):
    objects = planted_inventory().objects
    with pytest.raises(DataError, match=r"x\.xodr: OpenDRIVE places objects along a road, and the survey has no path"):
        write_opendrive(RoadInventory(objects, UTM), tmp_path / "x.xodr")
    assert not list(tmp_path.iterdir())


def test_without_a_system_there_is_no_geo_reference(tmp_path, caplog):
    inventory = planted_inventory()
    write_opendrive(RoadInventory(inventory.objects[:0], None, inventory.trajectory), tmp_path / "x.xodr")
    root = ET.parse(tmp_path / "x.xodr").getroot()
    assert root.find("header/geoReference") is None and not list(root.find("road/objects"))
    assert "has no geoReference" in caplog.text
