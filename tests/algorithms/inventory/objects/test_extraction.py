"""The inventory: planted objects with known measures, and surveys cut anywhere."""

import re
import weakref
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from references.inventory import planted_box, planted_pole, planted_tree

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.objects import merging
from mlsroad_pipeline.algorithms.inventory.objects.extraction import SceneObjects, extract_objects
from mlsroad_pipeline.algorithms.inventory.objects.merging import merge_across_scenes, merge_scenes
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule
from mlsroad_pipeline.algorithms.inventory.objects.table import FIELDS, OBJECT_FIELDS
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

UTM = np.array([583_000.0, 4_477_000.0, 120.0])
KINDS = ("pole", "sign", "vehicle", "tree")
RULES = {kind: ObjectRule.of_kind(kind, label) for label, kind in enumerate(KINDS, start=1)}
SLOPE = 0.03  # the planted ground rises along x


def ground(xyz):
    return SLOPE * xyz[..., 0]


def on_ground(x, y, above=0.0):
    return np.array([x, y, SLOPE * x + above])


@pytest.fixture(scope="module")
def street():
    """Poles, signs, cars and trees along 60 m, several of them exactly on the borders at 20 and 40 m."""
    parts = [
        (1, planted_pole(on_ground(5, 4), 8.0)),
        (1, planted_pole(on_ground(20, 4), 6.0, tilt_degrees=4, azimuth_degrees=90)),  # leans over the border
        (1, planted_pole(on_ground(40, -4), 3.0)),
        (2, planted_box(on_ground(40, -3.9, 2.2), 0.6, 0.02, 0.6, azimuth_degrees=90)),
        (2, planted_box(on_ground(50, -6, 2.5), 0.9, 0.02, 0.6, azimuth_degrees=0)),  # hangs on nothing
        (3, planted_box(on_ground(20, 0, 0.2), 4.4, 1.8, 1.5, azimuth_degrees=90)),
        (3, planted_box(on_ground(30, 2, 0.2), 4.4, 1.8, 1.5, azimuth_degrees=120)),
        (3, planted_box(on_ground(40, 1, 0.2), 12.0, 2.5, 3.2, azimuth_degrees=80)),  # longer than the buffers
        (4, planted_tree(on_ground(12, 9), 8.0, 2.0)),
        (4, planted_tree(on_ground(20.3, 9), 7.0, 2.4)),
        (4, planted_tree(on_ground(38.5, 9), 9.0, 2.6)),
        (4, planted_tree(on_ground(43.5, 9), 8.5, 2.6)),  # its crown touches the one before
        (1, np.array([[25.0, 5.0, 1.0], [25.0, 5.0, 1.1]])),  # too few points
        (1, planted_pole(on_ground(28, 5, 4.0), 2.0)),  # hangs in the air
        (3, planted_box(on_ground(55, 0), 1.0, 1.0, 0.3)),  # too low
    ]
    xyz = np.concatenate([points for _, points in parts])
    labels = np.concatenate([np.full(len(points), label) for label, points in parts])
    order = np.random.default_rng(1).permutation(len(xyz))
    return xyz[order], labels[order], np.random.default_rng(2).random(len(xyz))


def inventory(street, *, trajectory=None, **how):
    """Cut a street at x values, extract each scene with its buffers, merge."""
    return merge_across_scenes(cut_street(street, **how)[::-1], classes=RULES, trajectory=trajectory)


def cut_street(street, *, cuts=(), buffer=2.0, shift=0.0, known_ground=True):
    """Cut a street at x values and extract each scene with its buffers."""
    xyz, labels, confidence = street
    borders = [-np.inf, *cuts, np.inf]
    pieces = []
    for i, (low, high) in enumerate(pairwise(borders)):
        near = (xyz[:, 0] >= low - buffer) & (xyz[:, 0] < high + buffer)
        core = (xyz[near, 0] >= low) & (xyz[near, 0] < high)
        height = xyz[near, 2] - ground(xyz[near]) if known_ground else None
        pieces.append(
            extract_objects(
                xyz[near] + shift,
                labels[near],
                confidence[near],
                classes=RULES,
                core=core,
                origin=UTM - shift,
                height_above_ground=height,
                scene=f"scene_{i:05d}",
            )
        )
    return pieces


@pytest.fixture(scope="module")
def table(street):
    return inventory(street)


def of_kind(table, kind):
    return table[table["kind"] == kind].reset_index(drop=True)


def test_every_planted_object_is_found_once_and_false_ones_are_not(table):
    assert table.groupby("kind").size().to_dict() == {"pole": 3, "sign": 2, "vehicle": 3, "tree": 4}
    assert table["object_id"].tolist() == list(range(1, 13))
    assert {name: str(table[name].dtype) for name in OBJECT_FIELDS} == OBJECT_FIELDS


def test_poles_have_their_base_height_and_tilt(table):
    poles = of_kind(table, "pole")
    expected = np.array([on_ground(5, 4), on_ground(20, 4), on_ground(40, -4)]) + UTM
    np.testing.assert_allclose(poles[["x", "y", "z"]], expected, atol=0.02)
    np.testing.assert_allclose(poles["height"], [8, 6, 3], atol=0.04)
    np.testing.assert_allclose(poles["tilt"], [0, 4, 0], atol=0.2)
    np.testing.assert_allclose(poles["clearance"], 0, atol=0.05)
    np.testing.assert_allclose(poles["width"], [0.12, 0.12 + 6 * np.tan(np.radians(4)), 0.12], atol=0.05)
    np.testing.assert_allclose(poles["diameter"], 0.12, atol=0.005)
    np.testing.assert_allclose(poles["lean_azimuth"], [np.nan, 90, np.nan], atol=2)
    assert (poles["visible_share"] == 1).all()
    assert poles[["length", "heading", "facing", "panel_width", "crown_diameter"]].isna().all(axis=None)


def test_an_arm_and_a_lamp_do_not_move_the_axis():
    arm = np.column_stack([np.linspace(0, 2.5, 120), np.zeros(120), np.full(120, 7.9)])
    lamp = planted_box([2.5, 0, 7.8], 0.8, 0.3, 0.2, step=0.03)
    xyz = np.concatenate([planted_pole(np.zeros(3), 8.0), arm, lamp])
    table = inventory((xyz, np.ones(len(xyz), int), np.ones(len(xyz))))
    assert len(table) == 1
    np.testing.assert_allclose(table[["x", "y"]].to_numpy()[0] - UTM[:2], 0, atol=0.02)
    assert table["tilt"][0] < 0.2
    assert table["width"][0] == pytest.approx(2.71, abs=0.03)


def test_a_pole_hidden_in_the_middle_is_one_pole():
    pole = planted_pole(np.zeros(3), 6.0)
    seen = pole[(pole[:, 2] < 2.0) | (pole[:, 2] > 2.8)]
    table = inventory((seen, np.ones(len(seen), int), np.ones(len(seen))))
    assert table["point_count"].tolist() == [len(seen)]


def test_vehicles_have_their_box(table):
    cars = of_kind(table, "vehicle")
    np.testing.assert_allclose(cars[["x", "y"]] - UTM[:2], [[20, 0], [30, 2], [40, 1]], atol=0.03)
    np.testing.assert_allclose(cars["z"] - UTM[2], [0.6, 0.9, 1.2], atol=0.07)
    np.testing.assert_allclose(cars["length"], [4.4, 4.4, 12.0], atol=0.06)
    np.testing.assert_allclose(cars["width"], [1.8, 1.8, 2.5], atol=0.06)
    np.testing.assert_allclose(cars["height"], [1.7, 1.7, 3.4], atol=0.07)
    np.testing.assert_allclose(cars["heading"], [90, 120, 80], atol=0.5)
    assert (cars["visible_share"] > 0.95).all()
    np.testing.assert_allclose(cars["clearance"], 0.2, atol=0.07)


@pytest.mark.parametrize(("length", "found"), [(1.1, 0), (1.4, 1)])
def test_what_is_too_short_is_no_vehicle(rng, length, found):
    box = rng.random((4000, 3)) * [length, 0.3, 1.0]
    rules = {"vehicle": ObjectRule.of_kind("vehicle", 1)}
    objects = extract_objects(box, np.ones(len(box), int), np.ones(len(box)), classes=rules)
    assert len(merge_across_scenes([objects], classes=rules)) == found


def test_signs_know_their_pole_and_clearance(table):
    signs, poles = of_kind(table, "sign"), of_kind(table, "pole")
    assert signs["pole_id"].tolist() == [poles["object_id"][2], 0]
    np.testing.assert_allclose(signs["clearance"], [2.2, 2.5], atol=0.03)
    np.testing.assert_allclose(signs["height"], [2.8, 3.1], atol=0.03)
    np.testing.assert_allclose(signs["width"], [0.6, 0.9], atol=0.03)
    np.testing.assert_allclose(signs["z"] - UTM[2], [1.2, 1.5], atol=0.03)
    np.testing.assert_allclose(signs["panel_bottom"], [2.2, 2.5], atol=0.03)
    np.testing.assert_allclose(signs["panel_height"], 0.6, atol=0.03)
    np.testing.assert_allclose(signs["panel_width"], [0.6, 0.9], atol=0.03)


def test_a_panel_faces_away_from_the_pole_that_it_hangs_on(table):
    signs = of_kind(table, "sign")  # the first is 0.1 m north of its pole, the second hangs on nothing
    assert signs["facing_from"].tolist() == ["pole", "unknown"]
    np.testing.assert_allclose((signs["facing"] + 1) % 360, [1, 91], atol=0.5)


def test_trees_that_touch_are_split(table):
    trees = of_kind(table, "tree")
    np.testing.assert_allclose(trees[["x", "y"]] - UTM[:2], [[12, 9], [20.3, 9], [38.5, 9], [43.5, 9]], atol=0.1)
    np.testing.assert_allclose(trees["height"], [8, 7, 9, 8.5], atol=0.15)
    np.testing.assert_allclose(trees["width"], [4, 4.8, 5, 5], atol=0.6)
    np.testing.assert_allclose(trees["crown_diameter"], [4, 4.8, 5, 5], atol=0.5)
    np.testing.assert_allclose(trees["diameter"].dropna(), 0.3, atol=0.02)
    assert len(trees["diameter"].dropna()) >= 3


def test_confidence_is_the_mean_and_count_the_number_of_points(street, table):
    xyz, labels, confidence = street
    first = (labels == 1) & (np.abs(xyz[:, 0] - 5) < 1)
    assert table["point_count"][0] == first.sum()
    assert table["score"][0] == pytest.approx(confidence[first].mean(), abs=1e-4)


@pytest.mark.parametrize(
    ("cuts", "buffer"),
    [([20.0, 40.0], 2.0), ([20.0], 0.7), (list(np.arange(2.0, 60.0, 3.0)), 1.0), ([38.0, 39.0, 40.0, 41.0], 5.0)],
)
def test_a_cut_survey_gives_the_uncut_inventory(street, table, cuts, buffer):
    whole = table.drop(columns="scene")
    cut = inventory(street, cuts=cuts, buffer=buffer).drop(columns="scene")
    pd.testing.assert_frame_equal(cut, whole, rtol=0, atol=1e-9)


def test_objects_belong_to_the_scene_that_holds_their_foot(street):
    table = inventory(street, cuts=[20.1])  # one pole has its foot before the border and its top after it
    assert of_kind(table, "pole")["scene"].tolist() == ["scene_00000", "scene_00000", "scene_00001"]


def test_without_a_trajectory_there_is_no_station(table):
    assert table[["station", "offset"]].isna().all(axis=None)


def test_station_and_offset(street):
    path = Trajectory.from_positions(np.array([[0.0, 0, 0], [60, 0, 0]]) + UTM)
    table = inventory(street, trajectory=path)
    np.testing.assert_allclose(table["station"], table["x"] - UTM[0], atol=1e-3)
    np.testing.assert_allclose(table["offset"], UTM[1] - table["y"], atol=1e-3)


def test_without_the_ground_the_lowest_part_is_the_base(street):
    table = inventory(street, known_ground=False)
    assert table["clearance"].isna().all()
    poles = of_kind(table, "pole")
    np.testing.assert_allclose(poles["height"].to_numpy()[[0, 1]], [8, 6], atol=0.06)
    cars = of_kind(table, "vehicle")
    np.testing.assert_allclose(cars["height"], [1.5, 1.5, 3.2], atol=0.03)
    assert len(poles) == 4  # the hanging one cannot be distinguished from a standing one


def test_local_zero_does_not_matter(street, table):
    moved = inventory(street, shift=np.array([7.3, -11.9, 2.2]))
    pd.testing.assert_frame_equal(moved, table, rtol=0, atol=0.02)


def test_order_of_points_does_not_matter(street, table):
    reverse = tuple(column[::-1] for column in street)
    pd.testing.assert_frame_equal(inventory(reverse), table, rtol=0, atol=1e-9)


def test_input_is_not_modified(street):
    before = [column.copy() for column in street]
    inventory(street)
    for column, old in zip(street, before, strict=True):
        np.testing.assert_array_equal(column, old)


class _OneAtATime(Sequence):
    """Pieces that are made when they are asked for; tells how many are alive."""

    def __init__(self, pieces):
        self.pieces, self.alive, self.most = pieces, weakref.WeakSet(), 0

    def __len__(self):
        return len(self.pieces)

    def __getitem__(self, index):
        piece = _Piece(*vars(self.pieces[index]).values())
        self.alive.add(piece)
        self.most = max(self.most, len(self.alive))
        return piece


class _Piece(SceneObjects):
    __hash__ = object.__hash__


def test_few_voxels_at_a_time_give_the_same_table(street, monkeypatch):
    pieces = cut_street(street, cuts=(12.0, 25.0, 31.5, 40.0))
    whole = merge_across_scenes(pieces, classes=RULES)
    assert sum(len(piece.fragments) for piece in pieces) > 100
    for batch in (1, 10, 100):
        monkeypatch.setattr(merging, "BATCH", batch)
        scenes = _OneAtATime(pieces)
        pd.testing.assert_frame_equal(merge_across_scenes(scenes, classes=RULES), whole)
        assert scenes.most <= 2  # the one at hand, and the one before until its name is taken again


@pytest.mark.parametrize("cuts", [(), (20.0, 40.0), (12.0, 25.0, 31.5, 40.0, 43.4)])
def test_every_object_has_the_points_that_it_counts(street, cuts, monkeypatch):
    xyz = street[0]
    pieces = cut_street(street, cuts=cuts)
    for batch in (merging.BATCH, 1):
        monkeypatch.setattr(merging, "BATCH", batch)
        objects, numbers = merge_scenes(pieces, classes=RULES)
        core = [(xyz[:, 0] >= low) & (xyz[:, 0] < high) for low, high in pairwise([-np.inf, *cuts, np.inf])]
        number = np.zeros(len(xyz), np.int64)
        for piece, inside in zip(pieces, core, strict=True):
            number[inside] = numbers[piece.scene][piece.part]
        assert (number == 0).sum() > 1000  # of objects that violate a rule
        counts = np.bincount(number, minlength=len(objects) + 1)[1:]
        assert counts.tolist() == objects["point_count"].tolist()
        for row in objects.to_dict("records"):
            mine = xyz[number == row["object_id"]] + UTM
            sides = [[row[f"{axis}_{end}"] for axis in "xyz"] for end in ("min", "max")]
            np.testing.assert_allclose(sides, [mine.min(axis=0), mine.max(axis=0)], atol=6e-4)


def test_every_field_is_in_the_data_dictionary():
    page = (Path(__file__).parents[4] / "docs/inventory_fields.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1] for line in page.split("## Fields")[1].split("\n## ")[0].splitlines() if "|" in line]
    assert set(re.findall(r"`(\w+)`", " ".join(rows))) == set(FIELDS)


def test_nothing_to_find():
    piece = extract_objects(np.zeros((0, 3)), [], [], classes=RULES)
    table = merge_across_scenes([piece], classes=RULES)
    assert len(table) == 0
    assert {name: str(table[name].dtype) for name in OBJECT_FIELDS} == OBJECT_FIELDS
    pd.testing.assert_frame_equal(merge_across_scenes([], classes=RULES), table)
    unlabelled = extract_objects(np.zeros((9, 3)), np.full(9, -1), np.ones(9), classes=RULES)
    assert len(unlabelled.objects) == len(unlabelled.fragments) == 0


def test_bad_input_is_named(street):
    xyz, labels, confidence = street
    good = {"classes": RULES}
    with pytest.raises(DataError, match="NaN or infinite"):
        extract_objects(np.full((3, 3), np.nan), [1, 1, 1], [1, 1, 1], **good)
    with pytest.raises(DataError, match=r"labels must have shape \(3,\)"):
        extract_objects(np.zeros((3, 3)), [1, 1], [1, 1, 1], **good)
    with pytest.raises(DataError, match="confidence at row 1 is nan"):
        extract_objects(np.zeros((3, 3)), [1, 1, 1], [1, np.nan, 1], **good)
    with pytest.raises(DataError, match="height_above_ground at row 0 is inf"):
        extract_objects(np.zeros((1, 3)), [1], [1], height_above_ground=[np.inf], **good)
    with pytest.raises(DataError, match=r"core must have shape \(1,\)"):
        extract_objects(np.zeros((1, 3)), [1], [1], core=[True, False], **good)
    piece = extract_objects(xyz, labels, confidence, **good)
    cut = extract_objects(xyz, labels, confidence, core=xyz[:, 0] < 30, **good)
    with pytest.raises(DataError, match="scene 'scene_00000' comes twice"):
        merge_across_scenes([piece, piece], **good)
    far = replace(piece, scene="far", fragments=cut.fragments.assign(i=cut.fragments["i"] + 2**32))
    with pytest.raises(DataError, match="voxels from those of another scene"):
        merge_across_scenes([cut, far], **good)
    with pytest.raises(DataError, match="class 'vehicle', which has no rule"):
        merge_across_scenes([piece], classes={name: RULES[name] for name in ("pole", "sign", "tree")})


def test_oakland_poles_are_plausible(real_data):
    codes = (1103, 1104, 1106, 1107, 1108, 1110, 1112, 1114, 1115, 1116)
    found = []
    for path in sorted(real_data("oakland").glob("*.gz"))[4:7]:
        block = pd.read_csv(path, sep=r"\s+", comment="#", header=None).to_numpy()
        pick = np.isin(block[:, 3], codes)
        rules = {"pole": ObjectRule.of_kind("pole", tuple(codes), tolerance=0.5, min_height=2.0)}
        piece = extract_objects(block[pick, :3], block[pick, 3].astype(int), np.ones(pick.sum()), classes=rules)
        found.append(merge_across_scenes([piece], classes=rules))
    poles = pd.concat(found)
    assert len(poles) >= 5
    assert poles["height"].between(2, 15).all()
    assert (poles["tilt"].dropna() < 10).mean() > 0.8
