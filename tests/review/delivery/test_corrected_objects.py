"""Inventories after decisions: kinds, parts, merged and added objects, stations and sections."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from helpers.corrected import object_rows, write_inventory
from helpers.inventories import planted_inventory

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.inventory_files.geopackage import read_geopackage, write_geopackage
from mlsroad_pipeline.review.corrections import Correction, open_corrections
from mlsroad_pipeline.review.delivery.corrected_objects import (
    corrected_inventory,
    kind_of,
    kinds_of_classes,
    within_reach,
)

SCHEMES = {"own": {"classes": {"palms": {"members": ["palm"]}, "wall": {"members": ["wall"]}, "green": {"members": [
    "tree", "hedge"]}, "post or plate": {"members": ["post", "traffic_sign"]}}}}  # fmt: skip


@pytest.fixture
def decided(tmp_path):
    """Return a function that gives the states of decisions about an inventory."""

    def states(inventory, *corrections):
        write_inventory(tmp_path, inventory.objects)
        with open_corrections(tmp_path) as store:
            store.add_all(list(corrections), who="ann")
            return store.states()

    return states


def test_a_class_gives_the_kind_where_it_has_one():
    kinds = kinds_of_classes(SCHEMES)

    def of(name, listed="tree"):
        return kind_of({"status": "changed", "checked_class": name, "checked_kind": listed}, listed, kinds)

    assert (of("palms"), of("palms", "pole"), of("wall"), of("green"), of("pole")) == (
        "tree",
        "tree",
        "",
        "tree",
        "pole",
    )
    assert (of("post or plate"), of("a name of no scheme")) == ("tree", "tree")


def test_an_object_of_another_kind_moves_to_its_layer_without_the_measures_of_before(decided, tmp_path):
    inventory = planted_inventory()
    states = decided(inventory, Correction("other_kind", 6, kind="pole"), Correction("reject", 5))
    path = tmp_path / "corrected.gpkg"
    write_geopackage(corrected_inventory(inventory, states), path)
    found = read_geopackage(path).objects.set_index("object_id")
    assert found.loc[6, ["kind", "class", "status"]].tolist() == ["pole", "pole", "changed"]
    assert np.isnan(found.loc[6, "crown_diameter"]) and 5 not in found.index
    import geopandas

    assert set(geopandas.read_file(path, layer="poles")["object_id"]) == {1, 6}
    assert len(geopandas.read_file(path, layer="trees")) == len(geopandas.read_file(path, layer="vehicles")) == 0


def test_parts_of_a_split_object_share_its_outline(decided):
    inventory = planted_inventory()
    ring = "POLYGON ((391000 5820000, 391008 5820000, 391008 5820002, 391000 5820002, 391000 5820000))"
    row = inventory.objects["object_id"] == 5
    inventory.objects.loc[row, "footprint"] = ring
    bases = [[391_002.0, 5_820_001.0, 34.0], [391_006.0, 5_820_001.0, 34.5]]
    states = decided(inventory, Correction("split", 5, payload={"bases": bases}))
    found = corrected_inventory(inventory, states).objects.set_index("object_id")
    parts = found.loc[[5, 7]]
    assert parts["kind"].tolist() == ["vehicle"] * 2 and parts["status"].tolist() == ["split"] * 2
    np.testing.assert_allclose(
        parts[["x", "y", "length", "width"]], [[391_002, 5_820_001, 4, 2], [391_006, 5_820_001, 4, 2]]
    )
    np.testing.assert_allclose(parts["x_max"], [391_004, 391_008])
    areas = [shapely.from_wkt(text).area for text in parts["footprint"]]
    np.testing.assert_allclose(areas, [8, 8])
    assert (parts["point_count"] == 0).all() and parts["station"].notna().all()
    rejected = decided(inventory, Correction("reject", 5))  # the first part; the other one stays
    assert {5, 7} & set(corrected_inventory(inventory, rejected).objects["object_id"]) == {7}


def test_a_merged_object_has_the_outline_and_points_of_both(decided):
    inventory = planted_inventory()
    states = decided(inventory, Correction("merge", 1, payload={"objects": [2]}))
    found = corrected_inventory(inventory, states).objects.set_index("object_id")
    both = inventory.objects.iloc[:2]
    assert 2 not in found.index and found.loc[1, "point_count"] == both["point_count"].sum()
    assert found.loc[1, "x_max"] == both["x_max"].max() and found.loc[1, "status"] == "merged"
    again = decided(inventory, Correction("accept", 2))  # it stands for itself again
    found = corrected_inventory(inventory, again).objects.set_index("object_id")
    assert found.loc[1, "point_count"] == both["point_count"].iloc[0] and 2 in found.index


def test_moved_and_added_objects_have_stations_and_sections_count_what_is_delivered(decided):
    inventory = planted_inventory()
    place = {"x": 391_020.0, "y": 5_820_003.0, "z": 34.0}
    states = decided(
        inventory,
        *(Correction("add", kind="pole", payload=place), Correction("move_base", 1, payload=place)),
        *(Correction("reject", number) for number in (2, 3)),
    )
    found = corrected_inventory(inventory, states)
    rows = found.objects.set_index("object_id")
    assert rows.loc[[1, 7], "station"].tolist() == [20.0, 20.0] and rows.loc[[1, 7], "offset"].tolist() == [-3.0, -3.0]
    assert rows.loc[7, ["class", "status"]].tolist() == ["pole", "added"]
    assert found.sections[["pole", "sign"]].sum().tolist() == [2, 1]
    assert "kerb_length" not in inventory.sections or found.sections["kerb_length"].equals(
        inventory.sections["kerb_length"]
    )


def test_checked_leaves_out_what_nobody_looked_at(decided):
    inventory = replace(planted_inventory(), trajectory=None, sections=None)
    states = decided(inventory, Correction("accept", 2), Correction("reject", 3))
    found = corrected_inventory(inventory, states, checked=True)
    assert found.objects["object_id"].tolist() == [2] and found.objects["pole_id"].tolist() == [0]
    kept = corrected_inventory(inventory, states, checked=True, keep_rejected=True)
    assert kept.objects["status"].tolist() == ["accepted", "rejected"]


def test_rejected_lines_are_left_out_and_a_corridor_limits_objects_and_lines(decided):
    inventory = planted_inventory()
    kerb = inventory.lines[inventory.lines["kind"] == "kerb"].iloc[0]
    place = {"line": int(kerb["line_id"]), "x": float(kerb["x"]), "y": float(kerb["y"])}
    states = decided(inventory, Correction("reject_line", kind="kerb", payload=place))
    found = corrected_inventory(inventory, states)
    assert (
        set(found.lines["kind"]) == {*inventory.lines["kind"]} - {"kerb"} and found.sections["kerb_length"].sum() == 0
    )
    assert found.sections["wire_length"].sum() == 5.0
    assert len(corrected_inventory(inventory, states, checked=True).lines) == 0
    near = within_reach(found, 5.0)
    assert near.objects["offset"].abs().max() <= 5.0 and 0 < len(near.objects) < len(found.objects)
    assert near.sections["objects"].sum() == len(near.objects)
    with pytest.raises(DataError, match="no path"):
        within_reach(replace(inventory, trajectory=None), 5.0)


def test_without_measures_a_split_object_has_parts_at_its_bases(decided):
    objects = object_rows()
    inventory = replace(planted_inventory(), objects=objects, trajectory=None, sections=None, lines=None)
    bases = [[500.0, 900.0, 12.0], [501.0, 900.0, 12.0]]
    states = decided(inventory, Correction("split", 1, payload={"bases": bases}))
    found = corrected_inventory(inventory, states).objects.set_index("object_id").loc[[1, 6]]
    assert found[["x", "y", "z"]].to_numpy().tolist() == bases and (found["footprint"] == "").all()
