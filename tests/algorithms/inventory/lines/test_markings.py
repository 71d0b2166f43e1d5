"""Markings: planted paint, what is no paint, scenes that are cut, scanners, kinds."""

import time

import numpy as np
import pandas as pd
import pytest
import shapely

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_row, line_table
from mlsroad_pipeline.algorithms.inventory.lines.markings.brightness import scanner_pass_of
from mlsroad_pipeline.algorithms.inventory.lines.markings.kinds import beyond_kerb, markings_of
from mlsroad_pipeline.algorithms.inventory.lines.markings.marking_lines import (
    _without_straight,
    join_markings,
    marking_stripes,
    no_stripes,
)
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

ORIGIN = np.array([391_000.0, 5_820_000.0, 34.0])
PATH = Trajectory.from_positions(np.array([[0.0, 0.0, 2.0], [30.0, 0.0, 2.0]]) + ORIGIN)
SOLID = (0.0, 30.0, 3.44, 3.56)  # from and to along and across the road
STOP = (20.0, 20.4, -3.0, 0.0)
BARS = [(24.0, 27.0, y, y + 0.5) for y in np.arange(-3.0, 3.0, 1.0)]
DASHES = [(x, x + 3.0, -1.06, -0.94) for x in (1.0, 9.0)]


def road(paint, *, contrast=6.0, turn=0.0, border=0.0, step=0.0, density=400, seed=3):
    """Return points and intensities of a road of 30 m by 8 m along the x axis, noise 1; `border` and `step` at y = 0."""
    rng = np.random.default_rng(seed)
    n = 240 * density
    x, y = rng.uniform(0, 30, n), rng.uniform(-4, 4, n)
    on = np.zeros(n, dtype=bool)
    for low, high, right, left in paint:
        on |= (x >= low) & (x < high) & (y >= right) & (y < left)
    # Intensity falls with the range from the vehicle, as it does on recordings.
    intensity = 100 - 3 * np.abs(y) + contrast * on + border * (y > 0) + rng.normal(0, 1, n)
    z = 0.02 * y + step * np.clip(y / 0.05, 0, 1) + rng.normal(0, 0.004, n)
    if step:
        intensity += 8 * ((y > 0) & (y < 0.1))
    c, s = np.cos(turn), np.sin(turn)
    return np.column_stack([x * c - y * s, x * s + y * c, z]), intensity


def salt(share, density):
    """Return points of which few, at random, have an intensity other than 0."""
    rng = np.random.default_rng(2)
    xyz, _ = road([], density=density)
    return xyz, np.where(rng.random(len(xyz)) < share, rng.integers(1, 255, len(xyz)), 0.0)


def stripes(xyz, intensity, *, scanner_pass=None, core=None, labels=None, **options):
    n = len(xyz)
    return marking_stripes(
        *(
            xyz,
            np.zeros(n),
            np.zeros(n, dtype=int) if labels is None else labels,
            intensity,
            np.zeros(n, dtype=int) if scanner_pass is None else scanner_pass,
        ),
        is_paved=np.array([True, False]),
        is_ground=np.array([True, True]),
        core=np.ones(n, dtype=bool) if core is None else core,
        origin=ORIGIN,
        **options,
    )


def vertices(table):
    return [shapely.get_coordinates(shapely.from_wkt(text), include_z=True) - ORIGIN for text in table["line"]]


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_a_solid_line_is_found_in_place(turn):
    table = join_markings([stripes(*road([SOLID], turn=turn))])
    assert table["kind"].tolist() == ["lane_line"] and table["pattern"].tolist() == ["solid"]
    assert table["length"][0] == pytest.approx(30.0, abs=0.6)
    assert table["width"][0] == pytest.approx(0.12, abs=0.06) and table["score"][0] > 0.9
    (line,) = vertices(table)
    across = line[:, 1] * np.cos(turn) - line[:, 0] * np.sin(turn)
    np.testing.assert_allclose(across, 3.5, atol=0.07)


def test_kinds_of_markings_along_the_path():
    table = join_markings([stripes(*road([SOLID, STOP, *BARS, *DASHES]))], PATH)
    by_kind = {kind: rows for kind, rows in table.groupby("kind")}
    assert set(by_kind) == {"lane_line", "stop_line", "crossing"}
    crossing, stop = by_kind["crossing"].iloc[0], by_kind["stop_line"].iloc[0]
    assert len(by_kind["crossing"]) == len(by_kind["stop_line"]) == 1
    assert crossing["length"] == pytest.approx(5.5, abs=0.6) and crossing["width"] == pytest.approx(3.0, abs=0.4)
    assert stop["length"] == pytest.approx(3.0, abs=0.4) and stop["width"] == pytest.approx(0.4, abs=0.11)
    dashed = by_kind["lane_line"][by_kind["lane_line"]["pattern"] == "dashed"].sort_values("from_station")
    np.testing.assert_allclose(dashed["from_station"], [1.0, 9.0], atol=0.4)
    np.testing.assert_allclose(dashed["to_station"], [4.0, 12.0], atol=0.4)
    np.testing.assert_allclose(dashed["offset"], 1.0, atol=0.05)


@pytest.mark.parametrize(
    "cloud",
    [
        *(road([]), road([], border=6.0), road([], step=0.1), road([SOLID], contrast=1.0)),
        *(road([], density=2000), road([], density=4000), salt(0.05, 400), salt(0.2, 100)),
    ],
    ids=[
        *("no paint", "border of two surfaces", "bright face of a kerb", "little contrast"),
        *("peak below the path", "peak of many points", "few bright points", "more bright points"),
    ],
)
def test_what_is_no_marking(cloud):
    assert len(join_markings([stripes(*cloud)])) == 0


def test_scanners_with_other_units_are_compared_with_themselves():
    xyz, intensity = road([SOLID])
    scanner_pass = np.arange(len(xyz)) % 2
    table = join_markings(
        [stripes(xyz, np.where(scanner_pass == 1, 40 * intensity + 5000, intensity), scanner_pass=scanner_pass)]
    )
    assert table["length"].sum() == pytest.approx(30.0, abs=0.8)
    together = np.where(scanner_pass == 1, 400 * intensity, intensity)
    assert len(join_markings([stripes(xyz, together)])) == 0


@pytest.mark.parametrize(
    ("names", "apart"),
    [(("source",), True), (("file",), True), (("scanner", "source"), True), (("scanner",), False)],
    ids=["source", "file", "source and one scanner", "one scanner"],
)
def test_sources_of_one_place_are_scanners_and_files_side_by_side_are_one(names, apart):
    xyz, intensity = road([SOLID])
    head = np.random.default_rng(1).integers(0, 2, len(xyz))
    columns = {name: head if name != "scanner" else np.zeros_like(head) for name in names}
    scanner_pass = scanner_pass_of(PointCloud(xyz, {**columns, "second": np.full(len(xyz), 9, np.int32)}))
    assert (len(np.unique(scanner_pass)) == 2) == apart
    table = join_markings([stripes(xyz, np.where(head == 1, 0.7, 1.0) * intensity, scanner_pass=scanner_pass)])
    assert table["length"].sum() == pytest.approx(30.0 if apart else 0.0, abs=0.8)
    tiles = np.where(xyz[:, 0] > 14, 2, 0)
    assert np.ptp(scanner_pass_of(PointCloud(xyz, {"file": tiles}))) == 0
    both = scanner_pass_of(PointCloud(xyz, {"file": tiles + head}))
    assert np.array_equal(both == both[head == 1][0], head == 1)


def test_bright_paint_on_a_road_of_intensity_0_is_found():
    xyz, intensity = road([SOLID], contrast=50.0)
    table = join_markings([stripes(xyz, np.where(intensity > 120, intensity - 100, 0.0))])
    assert table["length"].tolist() == pytest.approx([30.0], abs=0.8)


def test_lines_go_on_over_the_border_of_scenes():
    xyz, intensity = road([SOLID])
    parts = []
    for low, high in ((0, 14), (14, 31)):
        core = (xyz[:, 0] >= low) & (xyz[:, 0] < high)
        inside = (xyz[:, 0] > low - 3) & (xyz[:, 0] < high + 3)
        parts.append(stripes(xyz[inside], intensity[inside], core=core[inside]))
    table = join_markings(parts)
    assert table["length"].tolist() == pytest.approx([30.0], abs=0.6)


def test_order_of_points_and_missing_values():
    xyz, intensity = road([SOLID])
    expected = join_markings([stripes(xyz, intensity)])
    order = np.random.default_rng(0).permutation(len(xyz))
    pd.testing.assert_frame_equal(join_markings([stripes(xyz[order], intensity[order])]), expected, atol=2e-3)
    unknown = np.full(len(xyz), np.nan)
    for empty in (
        stripes(xyz, unknown),
        stripes(xyz[:0], intensity[:0]),
        stripes(xyz[:3], intensity[:3]),
        no_stripes(),
    ):
        assert len(empty) == 0 and len(join_markings([empty])) == 0
    assert len(join_markings([stripes(xyz, np.full(len(xyz), 7.0))])) == 0


def test_kerbs_between_the_path_and_a_place_are_counted_by_their_direction():
    kerb = np.array([[0.0, 4.0, 0.0], [30.0, 4.0, 0.0]])
    places = np.array([[5.0, 3.0, 0.0], [5.0, 5.0, 0.0], [5.0, 8.0, 0.0]])
    up, down = kerb + ORIGIN, kerb[::-1] + [0.0, 3.0, 0.0] + ORIGIN
    assert beyond_kerb(places + ORIGIN, [up, down], PATH).tolist() == [False, True, False]
    assert beyond_kerb(places + ORIGIN, [up], PATH).tolist() == [False, True, True]
    assert beyond_kerb(places + ORIGIN, [], PATH).tolist() == [False, False, False]


def traced(x, y, length, *, width=0.12, contrast=5.0):
    """Return a line along the x axis as `trace_markings` does."""
    along = np.linspace(0, length, 6)
    return np.column_stack([x + along, np.full(6, y), np.zeros(6), *np.full((3, 6), [[width], [contrast], [7.0]])])


def test_a_crossing_beyond_a_kerb_needs_a_higher_score():
    def kinds(length, kerbs=(), bars=3):
        lines = [traced(20.0, 4.5 + k, length, width=0.5) + np.append(ORIGIN, np.zeros(3)) for k in range(bars)]
        return [marking.kind for marking in markings_of(lines, PATH, kerbs)]

    kerb = np.array([[0.0, 4.0, 0.0], [30.0, 4.0, 0.0]]) + ORIGIN
    assert kinds(3.0) == ["crossing"] and kinds(3.0, [kerb]) == [] and kinds(6.0, [kerb]) == ["crossing"]
    assert kinds(1.3, [kerb], bars=5) == []


def test_a_line_that_others_continue_has_a_higher_score():
    dashes = [traced(8.0 * k, 0.0, 3.0) for k in range(4)]
    (alone,), (first, *_) = markings_of(dashes[:1], None), markings_of(dashes, None)
    assert first.score > alone.score + 0.1


def test_other_ground_amid_the_road_is_searched_too():
    xyz, intensity = road([SOLID])
    labels = np.where(np.random.default_rng(4).random(len(xyz)) < 0.15, 1, 0)
    far = stripes(xyz, intensity, labels=labels)
    np.testing.assert_array_equal(far, stripes(xyz, intensity))
    assert len(stripes(xyz, intensity, labels=np.ones(len(xyz), dtype=int))) == 0


def test_kerbs_are_read_from_their_table():
    cloud = road([(5.0, 9.0, 2.4, 2.6)], contrast=4.0)
    kerbs = line_table([line_row("kerb", np.array([[0.0, 1.0, 0.0], [30.0, 1.0, 0.0]]) + ORIGIN, PATH)])
    table = join_markings([stripes(*cloud)], PATH)
    assert len(table) == 1 and 0.35 < table["score"][0] < 0.75
    assert len(join_markings([stripes(*cloud)], PATH, kerbs=kerbs)) == 0


def test_without_a_path_lane_lines_are_long_or_dashed():
    lines = [traced(0.0, 0.0, 8.0), traced(0.0, 5.0, 3.0), traced(0.0, 20.0, 3.0), traced(9.0, 20.0, 3.0)]
    found = markings_of(lines, None)
    assert [marking.kind for marking in found] == ["lane_line", "other_marking", "lane_line", "lane_line"]
    assert [marking.pattern for marking in found] == ["solid", "", "dashed", "dashed"]


def test_short_lines_side_by_side_are_no_lane_lines():
    place = np.append(ORIGIN, np.zeros(3))
    for n, kind in ((3, "lane_line"), (4, "other_marking")):
        lines = [traced(10.0 + 0.3 * k, 0.5 * k, 2.5) + place for k in range(n)]  # narrower than bars
        assert [marking.kind for marking in markings_of(lines, PATH)] == [kind] * n
    long = [traced(10.0, 0.5 * k, 6.5) + place for k in range(4)]
    assert {marking.kind for marking in markings_of(long, PATH)} == {"lane_line"}


def test_joining_many_lines_is_quick():
    lines = [traced(12.0 * k, y, 6.0, width=w) for k in range(300) for y, w in ((0, 0.12), (7, 0.12), (3, 0.4))]
    start = time.process_time()
    found = markings_of(lines, None)
    assert time.process_time() - start < 2.0 and len(found) == 900
    assert all(marking.pattern == "dashed" for marking in found)


def test_heights_of_straight_lines_are_kept():
    x = np.arange(0.0, 60.0, 0.3)
    height = -((x - 30) ** 2) / 2000
    vertices = np.column_stack([x, np.zeros_like(x), height])
    kept = _without_straight(vertices)
    assert len(kept) < len(x) / 4
    np.testing.assert_allclose(np.interp(x, kept[:, 0], kept[:, 2]), height, atol=0.021)
