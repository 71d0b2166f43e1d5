"""Axes, circles, panels and boxes of objects: closed forms, brute force, and hidden parts."""

import numpy as np
import pytest
import shapely
from references.inventory import (
    closeness,
    least_rectangle_area,
    planted_box,
    planted_pole,
    planted_sign,
    planted_tree,
    seen_cylinder,
)
from scipy.optimize import least_squares
from scipy.spatial import ConvexHull

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.objects.axes import fit_axis, fit_circle
from mlsroad_pipeline.algorithms.inventory.objects.boxes import convex_hull, oriented_box, polygon_area, vehicle_box
from mlsroad_pipeline.algorithms.inventory.objects.extraction import measure_points
from mlsroad_pipeline.algorithms.inventory.objects.fragments import join_voxels
from mlsroad_pipeline.algorithms.inventory.objects.measures import MEASURES
from mlsroad_pipeline.algorithms.inventory.objects.panels import fit_panel
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule
from mlsroad_pipeline.algorithms.inventory.objects.trunks import find_trunks
from mlsroad_pipeline.algorithms.inventory.objects.voxel_sums import voxelise

UTM = np.array([583_000.0, 4_477_000.0, 120.0])
RULES = {kind: ObjectRule.of_kind(kind, 1) for kind in ("pole", "sign", "vehicle", "tree")}


def voxels_of(points):
    """Return the voxels of an object above a flat ground."""
    n = len(points)
    table, _ = voxelise(
        points, group=np.zeros(n, np.int32), core=np.ones(n, bool), confidence=np.ones(n),
        height_above_ground=points[:, 2], origin=np.zeros(3), resolution=RULES["tree"].resolution,
    )  # fmt: skip
    return join_voxels(table.assign(object=0, scene=0), resolution=RULES["tree"].resolution)[0]


def turned(xy, degrees):
    """Turn points clockwise."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.column_stack([xy[:, 0] * c + xy[:, 1] * s, xy[:, 1] * c - xy[:, 0] * s])


def apart(one, other, circle=360.0):
    return abs((one - other + circle / 2) % circle - circle / 2)


def test_hull_is_that_of_qhull(rng):
    for n in (3, 10, 200, 5000):
        xy = rng.normal(0, 1, (n, 2)) if n % 2 else rng.uniform(0, 1, (n, 2)).round(2)
        hull, reference = convex_hull(xy), ConvexHull(xy)
        assert {tuple(p) for p in hull} == {tuple(p) for p in xy[reference.vertices]}
        assert polygon_area(hull) == pytest.approx(reference.volume)
        assert shapely.Polygon(hull).exterior.is_ccw


@pytest.mark.parametrize("n", [1, 2, 30])
def test_hull_of_a_line_has_its_ends(n, rng):
    along = np.sort(rng.uniform(-1, 1, n))
    hull = convex_hull(np.column_stack([along, 2 * along])[rng.permutation(n)])
    assert len(hull) <= 2
    assert set(hull[:, 0]) == {along[0], along[-1]}
    assert polygon_area(hull) == 0
    assert len(convex_hull(np.ones((7, 2)))) == 1


def test_oriented_box_is_the_least_of_all(rng):
    for _ in range(5):
        xy = rng.normal(0, [3, 1], (60, 2))
        _, length, width, _ = oriented_box(convex_hull(xy))
        assert length * width <= least_rectangle_area(xy) * (1 + 1e-9)
        assert length * width == pytest.approx(least_rectangle_area(xy), rel=2e-3)


@pytest.mark.parametrize("azimuth", [0.0, 33.3, 89.99, 90.0, 151.0, 179.5])
def test_oriented_box_of_a_rectangle_is_it(azimuth, rng):
    corners = turned(np.array([[0.75, 2.0], [-0.75, 2.0], [-0.75, -2.0], [0.75, -2.0]]), azimuth) + [5.0, 7.0]
    centre, length, width, found = oriented_box(convex_hull(corners))
    np.testing.assert_allclose([*centre, length, width], [5, 7, 4, 1.5], atol=1e-9)
    assert apart(found, azimuth, 180) < 1e-6


def sides(rng, *, n=900, noise=0.01):
    """One long and one short side of a car, 4.4 by 1.8 m, its length to the north."""
    long = np.column_stack([np.full(n, 0.9), rng.uniform(-2.2, 2.2, n)])
    short = np.column_stack([rng.uniform(-0.9, 0.9, n // 3), np.full(n // 3, -2.2)])
    return np.concatenate([long, short]) + rng.normal(0, noise, (n + n // 3, 2))


@pytest.mark.parametrize("azimuth", [0.0, 12.3, 77.0, 90.0, 140.0])
def test_a_car_seen_from_two_sides_has_its_heading(azimuth, rng):
    xy = turned(sides(rng), azimuth)
    strays = np.array([[2.0, 1.0], [-1.5, 1.2], [-1.2, 0.8], [0.2, 6.0]])  # a mirror, an aerial, a mixed pixel
    xy = np.concatenate([xy, turned(strays, azimuth)])
    centre, length, width, heading = vehicle_box(xy + UTM[:2])
    assert apart(heading, azimuth, 180) < 0.2
    np.testing.assert_allclose([length, width], [4.4, 1.8], atol=0.06)
    np.testing.assert_allclose(centre - UTM[:2], [0, 0], atol=0.05)


def test_vehicle_box_maximises_the_closeness(rng):
    xy = np.concatenate([turned(sides(rng, n=240, noise=0.03), 25.0), turned(rng.uniform(-0.8, 0.8, (60, 2)), 25.0)])
    heading = vehicle_box(xy)[3]
    best = max(closeness(xy - xy.mean(axis=0), degrees) for degrees in np.arange(0, 90, 0.25))
    assert closeness(xy - xy.mean(axis=0), 90.0 - heading) >= 0.97 * best


@pytest.mark.parametrize(("tilt", "lean"), [(0.0, 0.0), (1.0, 200.0), (4.0, 90.0), (8.0, 310.0)])
def test_axis_of_a_pole_with_arm_lamp_and_sign(tilt, lean, rng):
    shaft = seen_cylinder(np.zeros(3), 8.0, 0.08, tilt=tilt, lean=lean, noise=0.005)
    top = np.array([np.sin(np.radians(lean)), np.cos(np.radians(lean)), 0]) * np.tan(np.radians(tilt)) * 8.0
    arm = np.column_stack([np.linspace(0, 2.5, 300), np.zeros(300), np.full(300, 7.9)]) + top
    lamp = rng.uniform([2, -0.2, 7.8], [2.8, 0.2, 8.0], (600, 3)) + top
    sign = rng.uniform([0.1, -0.4, 2.2], [0.12, 0.4, 3.0], (500, 3))
    axis = fit_axis(np.concatenate([shaft, arm, lamp, sign]) + UTM)
    assert abs(axis.tilt - tilt) < 0.3
    if tilt:
        assert apart(axis.direction, lean) < 12.0 / tilt
    np.testing.assert_allclose(axis.at(UTM[2]) - UTM[:2], [0, 0.05], atol=0.03)  # its middle is nearer to the viewer
    assert axis.share > 0.85


def test_foliage_around_a_third_of_a_pole_does_not_bend_its_axis(rng):
    shaft = seen_cylinder(np.zeros(3), 6.0, 0.06, tilt=2.0, lean=45.0, arc=360)
    leaves = rng.uniform([0.0, -0.5, 4.0], [1.5, 0.5, 6.0], (4000, 3))
    assert abs(fit_axis(np.concatenate([shaft, leaves])).tilt - 2.0) < 0.3


def test_what_is_too_low_has_no_axis(rng):
    assert fit_axis(rng.uniform(0, 0.45, (500, 3))) is None
    assert fit_axis(np.zeros((2, 3))) is None
    assert fit_axis(rng.uniform(0, [8, 8, 0.6], (500, 3))) is None


@pytest.mark.parametrize(("radius", "arc"), [(0.05, 360), (0.1, 180), (0.25, 130), (0.5, 120)])
def test_circle_of_a_shaft_seen_from_one_side(radius, arc):
    xy = seen_cylinder(np.zeros(3), 1.0, radius, arc=arc, noise=0.004, n=400, seen_from=70)[:, :2]
    middle = xy.mean(axis=0)
    found = fit_circle(xy - middle, reach=0.6)
    np.testing.assert_allclose(found.centre + middle, 0, atol=0.012)
    assert found.diameter == pytest.approx(2 * radius, abs=0.02)
    assert found.arc == pytest.approx(arc / 360, abs=2 / 18)  # of eighteen parts
    reference = least_squares(lambda p: np.hypot(*(xy - middle - p[:2]).T) - p[2], [*found.centre, radius])
    np.testing.assert_allclose([*found.centre, found.diameter / 2], reference.x, atol=0.004)


def test_circle_among_clutter(rng):
    circle = seen_cylinder(np.zeros(3), 1.0, 0.12, noise=0.003, n=300)[:, :2]
    found = fit_circle(np.concatenate([circle, rng.uniform(0.2, 0.45, (80, 2))]), reach=0.3)
    assert found.diameter == pytest.approx(0.24, abs=0.01)


def test_no_circle_where_there_is_none(rng):
    wall = np.column_stack([np.linspace(-0.4, 0.4, 200), rng.normal(0, 0.003, 200)])
    assert fit_circle(wall, reach=0.3) is None
    assert fit_circle(rng.uniform(-0.3, 0.3, (400, 2)), reach=0.3) is None
    assert fit_circle(rng.uniform(-0.3, 0.3, (9, 2)), reach=0.3) is None
    narrow = seen_cylinder(np.zeros(3), 1.0, 0.3, arc=50, noise=0.004, n=300)[:, :2]
    assert fit_circle(narrow - [0, 0.3], reach=0.6) is None


@pytest.mark.parametrize("facing", [0.0, 37.0, 90.0, 181.0, 275.0, 359.0])
@pytest.mark.parametrize("disc", [True, False])
def test_panel_of_a_sign_on_its_post(facing, disc):
    panel = fit_panel(planted_sign(UTM, facing=facing, disc=disc))
    assert panel.faces
    assert apart(panel.normal, facing) < 1.5
    assert panel.bottom - UTM[2] == pytest.approx(2.2, abs=0.04)
    assert panel.top - UTM[2] == pytest.approx(2.9, abs=0.04)
    assert panel.width == pytest.approx(0.7, abs=0.04)
    turn = np.radians(facing)
    np.testing.assert_allclose(panel.centre - UTM, [0.06 * np.sin(turn), 0.06 * np.cos(turn), 2.55], atol=0.03)


def test_a_panel_without_a_post_has_no_front():
    sign = planted_sign(np.zeros(3), facing=200.0, disc=False)
    panel = fit_panel(sign[sign[:, 2] > 2.2])
    assert not panel.faces
    assert apart(panel.normal, 20.0) < 1.0
    assert panel.normal < 180
    middle = planted_sign(np.zeros(3), facing=200.0, standoff=0.0)  # nor one in the middle of its post
    assert apart(fit_panel(middle[:, :]).normal, 20.0, 180) < 1.0


def test_a_post_is_no_panel():
    assert fit_panel(seen_cylinder(np.zeros(3), 2.5, 0.03)) is None
    assert fit_panel(np.zeros((3, 3))) is None


def test_a_standing_sign_is_measured_at_the_foot_of_its_post():
    xyz = planted_sign([3.0, 4.0, 0.0], facing=120.0)
    row = measure_points(xyz, RULES["sign"], height_above_ground=xyz[:, 2], origin=UTM)
    np.testing.assert_allclose([row["x"] - UTM[0], row["y"] - UTM[1], row["z"] - UTM[2]], [3, 4, 0], atol=0.03)
    assert row["height"] == pytest.approx(2.9, abs=0.02)
    assert (row["panel_bottom"], row["panel_height"]) == pytest.approx((2.2, 0.7), abs=0.04)
    assert row["facing_from"] == "post"
    assert row["tilt"] < 0.6


def test_a_board_on_two_posts_stands_between_them(rng):
    posts = [seen_cylinder([x, 0.06, 0.0], 2.0, 0.03, n=500) for x in (-0.7, 0.7)]
    board = rng.uniform([-1.2, -0.004, 1.6], [1.2, 0.004, 2.8], (4000, 3))
    xyz = np.concatenate([*posts, board])
    row = measure_points(xyz, RULES["sign"], height_above_ground=xyz[:, 2])
    np.testing.assert_allclose([row["x"], row["y"]], [0, 0.06], atol=0.06)
    assert row["panel_width"] == pytest.approx(2.4, abs=0.05)
    assert row["panel_bottom"] == pytest.approx(1.6, abs=0.06)


def test_a_pole_seen_from_one_side_stands_at_its_axis():
    xyz = seen_cylinder([2.0, 1.0, 0.0], 7.0, 0.14, tilt=1.5, lean=250.0, seen_from=30.0, noise=0.004, n=6000)
    row = measure_points(xyz, RULES["pole"], height_above_ground=xyz[:, 2], origin=UTM)
    np.testing.assert_allclose([row["x"] - UTM[0], row["y"] - UTM[1]], [2, 1], atol=0.02)
    assert row["diameter"] == pytest.approx(0.28, abs=0.02)
    assert row["tilt"] == pytest.approx(1.5, abs=0.15)
    assert apart(row["lean_azimuth"], 250.0) < 5


def test_what_was_not_seen_is_nan(rng):
    upright = planted_pole(np.zeros(3), 6.0)
    row = measure_points(upright, RULES["pole"], height_above_ground=upright[:, 2])
    assert np.isnan(row["lean_azimuth"])  # what stands upright leans nowhere
    blob = rng.uniform(0, [0.4, 0.4, 0.4], (60, 3))
    row = measure_points(blob, RULES["pole"])
    assert all(np.isnan(row[name]) for name in ("tilt", "lean_azimuth", "diameter", "clearance", "facing"))
    half = upright[upright[:, 2] > 3.0]
    row = measure_points(half, RULES["pole"], height_above_ground=half[:, 2])
    assert row["clearance"] == pytest.approx(3.0, abs=0.1)
    row = measure_points(np.zeros((1, 3)), RULES["tree"])
    assert (row["footprint"], row["point_count"]) == ("", 1)


def test_share_of_the_sides_of_a_car_that_was_seen():
    car = planted_box([0, 0, 0.2], 4.4, 1.8, 1.5, azimuth_degrees=90)
    one_side = car[(car[:, 1] < -0.85) & (car[:, 2] < 1.5)]
    whole, part = (measure_points(xyz, RULES["vehicle"])["visible_share"] for xyz in (car, one_side))
    assert whole > 0.95
    two = measure_points(car[(car[:, 1] < -0.85) | (car[:, 0] < -2.15)], RULES["vehicle"])
    assert part <= 1 and 0.4 < two["visible_share"] < 0.75
    assert apart(two["heading"], 90.0, 180) < 1.0  # its points are 7 cm apart


def test_a_tree_has_crown_and_trunk():
    tree = planted_tree(np.array([5.0, 5.0, 0.0]), 8.0, 2.0)
    row = measure_points(tree, RULES["tree"], height_above_ground=tree[:, 2])
    assert row["crown_diameter"] == pytest.approx(4.0, abs=0.3)
    assert row["diameter"] == pytest.approx(0.3, abs=0.02)
    area = shapely.from_wkt(row["footprint"]).area
    assert area == pytest.approx(np.pi / 4 * row["crown_diameter"] ** 2, rel=0.02)


def test_a_hanging_branch_is_not_the_base_of_a_bush(rng):
    angle, radius = rng.uniform(0, 2 * np.pi, 4000), 0.9 * np.sqrt(rng.random(4000))
    bush = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0, 4, 4000)])
    branch = rng.normal(0, 0.05, (300, 3)) + np.column_stack(
        [np.full(300, 1.9), np.zeros(300), np.linspace(0.3, 3, 300)]
    )
    points = np.concatenate([bush, branch]) + [5, 5, 0]
    assert [round(trunk.x) for trunk in find_trunks(voxels_of(points))] == [7]
    row = measure_points(points, RULES["tree"], height_above_ground=points[:, 2])
    assert np.hypot(row["x"] - 5, row["y"] - 5) < 0.15


def test_low_branches_mark_the_base_where_the_trunk_is_hidden(rng):
    crown = rng.normal(0, 1.0, (3000, 3)) + [0, 0, 6]
    crown = crown[crown[:, 0] > -0.5]  # the far side is not seen
    skirt = rng.normal(0, [0.2, 0.2, 0.3], (300, 3)) + [0, 0, 2.5]
    points = np.concatenate([crown[crown[:, 2] > 4], skirt])
    row = measure_points(points, RULES["tree"], height_above_ground=points[:, 2])
    assert np.hypot(row["x"], row["y"]) < 0.1


@pytest.mark.parametrize("kind", list(RULES))
def test_order_place_and_direction_of_the_points(kind, rng):
    shapes = {
        "pole": seen_cylinder(np.zeros(3), 6.0, 0.1, tilt=3.0, lean=70.0, noise=0.003),
        "sign": planted_sign(np.zeros(3), facing=70.0),
        "vehicle": planted_box([0, 0, 0.2], 4.4, 1.8, 1.5, azimuth_degrees=70.0),
        "tree": planted_tree(np.zeros(3), 6.0, 1.5),
    }
    xyz = shapes[kind]
    before = xyz.copy()
    row = measure_points(xyz, RULES[kind], height_above_ground=xyz[:, 2])
    other = rng.permutation(len(xyz))
    again = measure_points(xyz[other], RULES[kind], height_above_ground=xyz[other, 2])
    np.testing.assert_array_equal(xyz, before)
    for name in MEASURES:
        assert again[name] == pytest.approx(row[name], abs=1e-6, nan_ok=True), name
    far = measure_points(xyz, RULES[kind], height_above_ground=xyz[:, 2], origin=UTM + 0.37)
    east = np.column_stack([turned(xyz[:, :2], 90.0), xyz[:, 2]])
    quarter = measure_points(east, RULES[kind], height_above_ground=xyz[:, 2])
    for name in ("height", "width", "length", "tilt", "diameter", "crown_diameter", "panel_bottom", "panel_width"):
        tolerance = {"crown_diameter": 0.2, "tilt": 0.15}.get(name, 0.06)
        for changed in (far, quarter):
            assert changed[name] == pytest.approx(row[name], abs=tolerance, nan_ok=True), name
    for name, circle in (("heading", 180.0), ("lean_azimuth", 360.0), ("facing", 360.0)):
        if not np.isnan(row[name]):
            assert apart(far[name], row[name], circle) < 2
            assert apart(quarter[name], row[name] + 90.0, circle) < 2


def test_bad_input_is_named():
    with pytest.raises(DataError, match="without points"):
        measure_points(np.zeros((0, 3)), RULES["pole"])
    with pytest.raises(DataError, match="height_above_ground at row 0 is nan"):
        measure_points(np.zeros((1, 3)), RULES["pole"], height_above_ground=[np.nan])
    with pytest.raises(DataError, match="NaN or infinite"):
        measure_points([[0, 0, np.inf]], RULES["pole"])
