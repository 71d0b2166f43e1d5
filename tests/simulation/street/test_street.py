from dataclasses import replace

import numpy as np
import pytest
from references.simulator import GROUND_LABELS, curb_distance_by_sampling, ground_labels

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS, StreetParameters, street_parameters
from mlsroad_pipeline.simulation.street.ground import (
    HALF_WIDTH,
    RADIUS,
    SIDE,
    SIGNALS,
    STATION,
    ZEBRA,
    arm_coordinates,
    arm_place,
    corner_curve,
)
from mlsroad_pipeline.simulation.street.ground_mesh import ground_mesh
from mlsroad_pipeline.simulation.street.street import BLOCK, draw_street


@pytest.fixture(scope="module")
def street():
    return draw_street(3, length=120.0)


@pytest.fixture(scope="module")
def ring_road():
    return draw_street(8, length=120.0, parameters=STREETS["ring_road"])


def side_street(street):
    """Return one side street of the middle of a street."""
    arms = street.ground.arms
    near = arms[(arms[:, STATION] > 0) & (arms[:, STATION] < 180)]
    return near[0]


def test_locate_is_the_inverse_of_place(street, rng):
    s, left = rng.uniform(-50, 150, 500), rng.uniform(-45, 45, 500)
    xy, _ = street.alignment.place(s, left)
    station, offset = street.alignment.locate(xy)
    np.testing.assert_allclose(station, s, atol=2e-3)
    np.testing.assert_allclose(offset, left, atol=1e-4)


def test_alignment_begins_at_the_origin_and_keeps_its_scale(street):
    xy, _ = street.alignment.place([0.0], [0.0])
    np.testing.assert_allclose(xy, 0, atol=1e-9)
    line, _ = street.alignment.place(np.arange(0, 100, 0.25), 0.0)
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).sum() == pytest.approx(99.75, rel=1e-4)


def test_a_longer_street_bends_alike(street):
    longer = draw_street(3, length=600.0)
    n = len(street.alignment.table)
    np.testing.assert_array_equal(longer.alignment.table[:n], street.alignment.table)


def test_another_seed_is_another_street(street):
    other = draw_street(4, length=120.0)
    assert not np.allclose(other.ground.section, street.ground.section)
    assert not np.allclose(other.ground.profile[:, 0], street.ground.profile[:, 0], atol=0.1)
    assert not np.allclose(other.ground_rgb, street.ground_rgb)
    assert not np.array_equal(other.ground.arms, street.ground.arms)


def test_the_ground_has_slope_crown_and_curbs():
    grades, steps, crowns = [], [], []
    for seed in range(8):
        ground = draw_street(seed, length=120.0).ground
        s = np.arange(0, 120, 1.0)
        grades.append(np.abs(np.gradient(ground.height(s, 0.0), s)).max())
        half = ground.section[0, 0]
        steps.append((ground.height(s, half + 0.05) - ground.height(s, half - 0.01)).max())
        crowns.append(ground.height(s, 0.0).mean() - (ground.height(s, half) + ground.height(s, -half)).mean() / 2)
    assert max(grades) > 0.02
    assert min(steps) > 0.08 and max(steps) < 0.2
    assert min(crowns) > 0.02


@pytest.mark.parametrize("name", ["street", "ring_road"])
def test_curb_lines_are_straight_lines_joined_by_arcs(name, request, rng):
    ground = request.getfixturevalue(name).ground
    arm = side_street(request.getfixturevalue(name))
    side = int(arm[SIDE])
    # A straight street whose side street joins at right angles is plane geometry.
    plain = arm.copy()
    plain[[4, 5]] = 0.0
    straight = ground._replace(arms=plain[None])
    way = 1 if side == 0 else -1
    s = plain[STATION] + rng.uniform(-25, 25, 60)
    left = way * (ground.section[side, 0] + rng.uniform(-3, 30, 60))
    measured, _ = straight.edge(s, left)
    expected = curb_distance_by_sampling(s, left, float(ground.section[side, 0]), plain)
    near = np.abs(expected) < float(plain[RADIUS])
    assert near.sum() > 20
    np.testing.assert_allclose(measured[near], expected[near], atol=2e-3)
    assert (np.sign(measured) == np.sign(expected)).all()


def test_side_street_coordinates_are_inverted(street, rng):
    arm = side_street(street)
    half = float(street.ground.section[int(arm[SIDE]), 0])
    for t, q in zip(rng.uniform(0, 40, 20), rng.uniform(-12, 12, 20), strict=True):
        s, left = arm_place(arm, half, t, q)
        np.testing.assert_allclose(arm_coordinates(s, left, half, arm), (t, q), atol=1e-9)


def test_corner_curves_keep_their_distance_from_the_curb(street):
    arm = side_street(street)
    half = float(street.ground.section[int(arm[SIDE]), 0])
    for distance in (0.0, 0.03, 2.0):
        for direction in (-1, 1):
            curve = corner_curve(arm, half, distance, 45.0, direction)
            np.testing.assert_allclose(street.ground.edge(*curve.T)[0], distance, atol=1e-6)


@pytest.mark.parametrize("name", ["street", "ring_road"])
def test_the_ground_is_continuous_but_at_curbs(name, request):
    street = request.getfixturevalue(name)
    s, left = np.meshgrid(np.arange(0, 120, 0.4), np.arange(-45, 45, 0.1), indexing="ij")
    z = street.ground.height(s, left)
    for step in ((1, 0), (0, 1)):
        rise = np.abs(z[step[0] :, step[1] :] - z[: z.shape[0] - step[0], : z.shape[1] - step[1]])
        distance, _ = street.ground.edge(s, left)
        here, there = distance[step[0] :, step[1] :], distance[: z.shape[0] - step[0], : z.shape[1] - step[1]]
        crosses = (np.minimum(here, there) <= 0.03) & (np.maximum(here, there) >= 0)
        assert rise[~crosses].max() < (0.12 if step == (1, 0) else 0.04)
        assert rise[crosses].max() > 0.05


@pytest.mark.parametrize("name", ["street", "ring_road"])
def test_mesh_follows_the_height_function(name, request):
    street = request.getfixturevalue(name)
    for block in range(2):
        mesh = ground_mesh(street, block)
        corners = mesh.vertices[mesh.faces]
        middles = corners.mean(axis=1)
        station, offset = street.alignment.locate(middles[:, :2], near=block * BLOCK)
        gap = np.abs(middles[:, 2] - street.ground.height(station, offset))
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(normal, axis=1) / 2
        assert np.quantile(gap, 0.98) < 0.025
        assert gap.max() < 0.12 and area[gap > 0.06].sum() < 0.2
        assert (normal[:, 2] > 0).all()
        # It covers the block once: a bend's inside and outside make up for each other.
        assert (normal[:, 2] / 2).sum() == pytest.approx(BLOCK * 110.0, rel=1e-3)


def test_neighbouring_blocks_share_their_seam(street):
    for block in range(-1, 2):
        rows = []
        for mesh in (ground_mesh(street, block), ground_mesh(street, block + 1)):
            station, _ = street.alignment.locate(mesh.vertices[:, :2], near=(block + 1) * BLOCK)
            rows.append(mesh.vertices[np.abs(station - (block + 1) * BLOCK) < 1e-3])
        rows = [np.unique(np.round(r, 6), axis=0) for r in rows]
        assert len(rows[0]) > 60
        np.testing.assert_allclose(*rows, atol=2e-6)


def test_surface_labels_lie_where_the_section_says():
    street = draw_street(3, length=120.0, parameters=StreetParameters(junction_spacing=0))
    ground = street.ground
    assert len(ground.arms) == 0
    half, _, curb, verge, pavement = ground.section[0]
    s = np.arange(0, 120, 0.31)
    assert set(ground_labels(ground, s, half + curb / 2)) == {TAXONOMY["curb"]}
    assert set(ground_labels(ground, s, half + curb + verge + pavement / 2)) == {TAXONOMY["sidewalk"]}
    on_road = ground_labels(ground, s[:, None], np.linspace(-2.5, 2.5, 60)[None])
    assert set(np.unique(on_road)) <= {TAXONOMY[k] for k in ("road", "lane_marking", "manhole")}
    assert np.mean(on_road == TAXONOMY["lane_marking"]) < 0.2
    everywhere = ground_labels(ground, s[:, None], np.linspace(-50, 50, 300)[None])
    assert set(np.unique(everywhere)) <= set(GROUND_LABELS)


def test_side_streets_are_road_between_curbs_with_a_zebra_crossing(street):
    ground, arm = street.ground, side_street(street)
    half = float(ground.section[int(arm[SIDE]), 0])

    def along(t, q):
        places = np.array([arm_place(arm, half, float(t), float(v)) for v in np.atleast_1d(q)])
        return ground_labels(ground, *places.T)

    wide = float(arm[HALF_WIDTH])
    across = np.linspace(-wide + 0.3, wide - 0.3, 80)
    assert set(along(35.0, across)) <= {TAXONOMY["road"], TAXONOMY["lane_marking"]}
    assert set(along(35.0, [-wide - 0.05, wide + 0.05])) == {TAXONOMY["curb"]}
    assert arm[ZEBRA] > 0
    painted = np.mean(along(arm[ZEBRA], across) == TAXONOMY["lane_marking"])
    assert 0.4 < painted < 0.6


def test_a_median_ends_at_junctions(ring_road):
    ground, arm = ring_road.ground, side_street(ring_road)
    s = np.arange(0, 120, 0.5)
    distance, which = ground.edge(s, 0.0)
    opening = arm[HALF_WIDTH] + 0.6 * arm[RADIUS]
    inside = np.abs(s - arm[STATION]) < opening
    assert inside.sum() > 10 and (which[~inside] == -2).all() and (which[inside] != -2).all()
    assert (distance[inside] <= 0).all() and distance.max() == pytest.approx(ground.shape[5], abs=1e-6)


@pytest.mark.parametrize("kind", sorted(STREETS))
def test_kinds_of_street_have_what_they_ask_for(kind):
    parameters = STREETS[kind]
    counts = []
    for seed in range(6):
        street = draw_street(seed, length=1500.0, parameters=parameters)
        ground = street.ground
        stations = np.unique(ground.arms[:, STATION])
        counts.append(len(stations))
        assert (np.diff(stations) >= BLOCK - 11).all()
        assert (np.abs(stations / BLOCK - np.floor(stations / BLOCK) - 0.5) * BLOCK <= 5.0 + 1e-9).all()
        assert ground.shape[5] == parameters.median / 2
        assert parameters.lanes in (0, ground.shape[4])
        if parameters.parking == 0:
            assert (ground.section[:, 1] == 0).all()
    mean = (1500 + 6 * BLOCK) / np.mean(counts)
    assert mean == pytest.approx(parameters.junction_spacing, rel=0.3)


def test_the_share_of_boundaries_is_that_of_the_parameters():
    def edges(**changes):
        parameters = replace(STREETS["ring_road"], buildings=0.0, **changes)
        return [
            lot.boundary for seed in range(4) for lot in draw_street(seed, length=600.0, parameters=parameters).lots
        ]

    bare, half, full = (np.array(edges(boundaries=share)) for share in (0.0, 0.5, 1.0))
    assert (bare == "none").all()
    kept = (half != "none").mean() / (full != "none").mean()
    assert len(half) > 200 and kept == pytest.approx(0.5, abs=0.12)


def test_signalled_junctions_have_crossings_on_both_sides():
    street = draw_street(1, length=600.0, parameters=replace(STREETS["town"], signals=1.0))
    stations = np.unique(street.ground.arms[:, STATION])
    assert (street.ground.arms[:, 6] == SIGNALS).all() and len(stations) > 3
    for station in stations:
        away = street.ground.crossings[:, 0] - station
        assert ((away > 5) & (away < 16)).any() and ((away < -5) & (away > -16)).any()


def test_drains_lie_in_the_gutter(street):
    holes = street.ground.manholes
    drains = holes[holes[:, 2] < 0]
    assert len(drains) > 10
    np.testing.assert_allclose(street.ground.edge(drains[:, 0], drains[:, 1])[0], -0.24, atol=0.02)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hard_cases": 1.5}, "hard_cases must be between 0 and 1, got 1.5"),
        ({"junction_spacing": 20.0}, "junction_spacing must be 0 or between 60 and 5000, got 20.0"),
        ({"median": float("nan")}, "median must be 0 or between 1.5 and 12, got nan"),
        ({"lanes": 4}, "lanes must be 0, 1, 2 or 3, got 4"),
        ({"palms": -1.0}, "palms must be between 0 and 5, got -1.0"),
        ({"palms": "lots"}, "palms must be between 0 and 5, got 'lots'"),
        ({"grass_height": 0.5}, "grass_height must be between 0 and 0.2, got 0.5"),
    ],
)
def test_bad_parameters_are_named(change, message):
    with pytest.raises(ParameterError, match=message):
        StreetParameters(**change)


def test_parameters_are_read_from_configuration():
    assert street_parameters("suburb") == STREETS["suburb"]
    assert street_parameters({"kind": "ring_road", "hard_cases": 0.5}) == replace(STREETS["ring_road"], hard_cases=0.5)
    assert street_parameters({}) == StreetParameters()
    with pytest.raises(ParameterError, match="kind of street 'alley' is unknown"):
        street_parameters("alley")
    with pytest.raises(ParameterError, match=r"a street .*got 3"):
        street_parameters(3)
    with pytest.raises(ParameterError, match="unknown street parameters: lamp"):
        street_parameters({"lamp": 3})
