"""Sight to signs on a planted straight road: from the start, up to a wall, from behind, and past a bend."""

import numpy as np
import pandas as pd
import pytest

from mlsroad_pipeline.algorithms.inventory.road.sight import FARTHEST, joined, sight_table, standing
from mlsroad_pipeline.algorithms.inventory.road.stations import RoadPath
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

ORIGIN = np.array([389_000.0, 5_819_000.0, 35.0])
CLASSES = ["paved ground", "tree", "building"]


def path_of(xy):
    return RoadPath.along(Trajectory.from_positions(np.column_stack([xy, np.full(len(xy), 2.0)]) + ORIGIN))


def straight(length=200.0):
    x = np.arange(0.0, length + 0.1, 0.5)
    return path_of(np.column_stack([x, np.zeros(len(x))]))


def sign(number, x, y, facing, source="post"):
    return {"object_id": number, "x": ORIGIN[0] + x, "y": ORIGIN[1] + y, "z": ORIGIN[2], "panel_centre": 2.4,
            "facing": facing, "facing_from": source}  # fmt: skip


def wall(x, y_low, y_high, label, top=4.0):
    y, z = (a.ravel() for a in np.meshgrid(np.arange(y_low, y_high, 0.05), np.arange(0.4, top, 0.05)))
    xyz = np.column_stack([np.full(len(y), x), y, z]) + ORIGIN
    return standing(xyz, np.full(len(y), label, np.uint8))


def table(path, signs, *things):
    found = joined([standing(np.zeros((0, 3)), np.zeros(0, np.uint8)), *things])
    return sight_table(pd.DataFrame(signs), path, np.full(len(path), ORIGIN[2]), found, CLASSES)


def test_a_free_sign_is_seen_from_the_start_or_the_limit():
    found = table(straight(), [sign(1, 60, -4, 270.0), sign(2, 180, -4, 270.0)])
    assert found["object_id"].tolist() == [1, 2] and found["sight_end"].tolist() == ["start", "limit"]
    assert found["sight"].tolist() == pytest.approx([59.5, FARTHEST], abs=1.0)
    assert found["offset"].tolist() == pytest.approx([4, 4]) and set(found["hidden_by"]) == {""}


@pytest.mark.parametrize(("low", "label"), [(2.0, "tree"), (1.0, "building")])
def test_a_wall_beside_the_lane_hides_a_sign_from_where_the_line_of_sight_meets_it(low, label):
    """A sign at x = 60, 4 m to the right; a wall at x = 40 from `low` to 4 m to the right of the path."""
    found = table(straight(), [sign(1, 60, -4, 270.0)], wall(40, -4.0, -low, CLASSES.index(label))).iloc[0]
    expected = 20.0 * 4.0 / (4.0 - low)  # similar triangles: nearer, the line of sight passes left of the wall
    assert found["sight_end"] == "hidden" and found["hidden_by"] == label
    assert found["sight"] == pytest.approx(expected, abs=1.5)
    assert found["hidden_x"] == pytest.approx(ORIGIN[0] + 40, abs=0.5)


def test_a_wall_that_ends_before_the_line_of_sight_or_is_low_hides_nothing():
    low = wall(40, -4.0, 0.0, 1, top=1.0)
    beyond = wall(40, -8.0, -4.2, 1)
    single = standing(np.array([[40.0, -2.0, 1.7]]) + ORIGIN, np.array([1], np.uint8))
    found = table(straight(), [sign(1, 60, -4, 270.0)], low, beyond, single)
    assert found["sight_end"].tolist() == ["start"]


def test_only_fronts_that_face_the_path_have_a_row():
    signs = [sign(1, 60, -4, 90.0), sign(2, 60, -4, 0.0), sign(3, 60, -4, 90.0, "unknown"), sign(4, 60, -30, 270.0)]
    missing = sign(5, 60, -4, 270.0) | {"panel_centre": np.nan}
    found = table(straight(), [*signs, missing])
    assert found["object_id"].tolist() == [3]


def test_the_sight_ends_where_the_path_comes_around_a_corner():
    x = np.arange(0.0, 60.1, 0.5)
    corner = np.concatenate([np.column_stack([np.zeros(121), x - 60]), np.column_stack([x, np.zeros(121)])[1:]])
    found = table(path_of(corner), [sign(1, 40, -4, 270.0)]).iloc[0]
    assert found["sight_end"] == "turn" and found["sight"] == pytest.approx(40, abs=4)


def test_points_of_several_readings_add_up():
    xyz = np.array([[0.1, 0.1, 0.1], [5.1, 0.1, 0.1]]) + ORIGIN
    once = standing(xyz, np.array([1, 2], np.uint8))
    both = joined([once, once])
    assert both.count.tolist() == [2, 2] and len(once.key) == 2 and sorted(both.label.tolist()) == [1, 2]
