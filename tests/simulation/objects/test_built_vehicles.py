"""Vehicles: measures, panes and interior, and their lofted skin."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.objects import STREAMS, VEHICLES, along, built, used
from references.simulator import enclosed_volume

from mlsroad_pipeline.simulation.model.meshes import GLASS, KIND, RED, REFLECTIVITY, RETRO, Surface
from mlsroad_pipeline.simulation.objects.bodywork import Body, skin

# Length, width without mirrors but with turned wheels, and height (m) of vehicles, from the least to the largest.
VEHICLE_SIZES = {
    "sedan": ((4.25, 5.1), (1.7, 2.0), (1.36, 1.85)), "hatchback": ((3.55, 4.5), (1.6, 1.9), (1.4, 2.15)),
    "estate": ((4.35, 5.05), (1.7, 1.98), (1.4, 2.12)), "suv": ((4.15, 5.05), (1.76, 2.1), (1.56, 2.42)),
    "minivan": ((4.15, 5.05), (1.72, 2.04), (1.54, 2.36)), "convertible": ((3.75, 4.7), (1.64, 1.94), (1.2, 1.75)),
    "panel_van": ((4.0, 6.9), (1.68, 2.1), (1.7, 3.1)), "minibus": ((4.0, 6.9), (1.68, 2.1), (1.7, 3.1)),
    "pickup": ((4.85, 5.9), (1.74, 2.1), (1.68, 2.2)), "box_truck": ((5.7, 9.7), (2.0, 2.65), (2.6, 4.3)),
    "flatbed_truck": ((5.7, 9.7), (2.0, 2.6), (2.1, 3.4)), "tipper_truck": ((5.7, 9.7), (2.0, 2.7), (2.1, 3.4)),
    "articulated_lorry": ((13.9, 16.9), (2.4, 3.6), (2.9, 4.2)), "bus": ((8.4, 13.1), (2.4, 2.6), (2.85, 3.6)),
    "articulated_bus": ((16.9, 19.2), (2.4, 5.0), (2.85, 3.6)),
}  # fmt: skip


@pytest.mark.parametrize("name", VEHICLES)
def test_vehicles_have_the_stated_sizes(name):
    (short, long), (narrow, wide), (low, high) = VEHICLE_SIZES[name]
    for stream in STREAMS:
        points = used(built(name, stream))
        assert abs(points[:, 2].min()) < 0.01  # wheels on the road
        assert short <= np.ptp(points[:, 0]) <= long
        assert low <= points[:, 2].max() <= high
        body = points[(points[:, 2] > 0.3) & (points[:, 2] < 0.62)]  # below the mirrors
        assert narrow <= np.ptp(body[:, 1]) <= wide


@pytest.mark.parametrize("name", VEHICLES)
def test_vehicles_head_along_x_with_plates_and_panes(name):
    for stream in STREAMS:
        mesh = built(name, stream)
        middle = mesh.vertices[mesh.faces].mean(axis=1)
        rgb, kind = mesh.attributes[:, RED : RED + 3], mesh.attributes[:, KIND]
        half = np.ptp(used(mesh)[:, 0]) / 2
        tail = (kind == RETRO) & (rgb[:, 0] > 2.2 * rgb[:, 1]) & (rgb[:, 0] > 2.2 * rgb[:, 2])
        assert tail.sum() >= 24 and (middle[tail, 0] < -0.9 * half + 0.2).all()
        assert ((kind == RETRO) & ~tail & (middle[:, 0] < -0.85 * half)).sum() >= 12  # the licence plate
        glass = kind == GLASS
        # A windscreen faces forward, and it slopes: its area has a component along x.
        a, b, c = (mesh.vertices[mesh.faces[glass][:, k]] for k in range(3))
        across = np.abs(np.cross(b - a, c - a)[:, 0]) / 2
        assert across[middle[glass, 0] > 0].sum() > 0.35


@pytest.mark.parametrize("name", ["sedan", "hatchback", "estate", "suv", "minivan", "panel_van", "pickup", "bus"])
def test_a_beam_passes_the_panes_and_hits_the_interior(name):
    mesh = built(name, 2)
    points = used(mesh)
    half = 0.45 * np.ptp(points[(points[:, 2] > 0.3) & (points[:, 2] < 0.62)][:, 1])
    panes = mesh.vertices[mesh.faces[mesh.attributes[:, KIND] == GLASS]].reshape(-1, 3)
    beside = panes[np.abs(panes[:, 1]) > 0.8 * half]
    rng = np.random.default_rng(5)
    passed = inside = 0
    for _ in range(150):
        at = rng.uniform(beside.min(axis=0), beside.max(axis=0))
        origin, target = np.array([at[0], 8.0, 2.0]), np.array([at[0], 0.9 * half, at[2]])
        t, face = along(mesh, origin, target - origin)
        glass = mesh.attributes[face, KIND] == GLASS
        if len(t) == 0 or not glass[0]:
            continue
        passed += 1
        solid = np.flatnonzero(~glass)
        inside += len(solid) > 0 and abs(origin[1] + t[solid[0]] * (target - origin)[1]) < half
    assert passed >= 30
    assert inside >= 4


PLAIN = Body(
    0.9, 0.2, top=[(-2, 1.4), (2, 1.4)], belt=[(-2, 0.9), (2, 0.9)], shoulder=[(-2, 0.955), (2, 0.955)], axles=(),
    radius=0.3, drawn_in=0.0,
)  # fmt: skip


SKINS = [Surface(50, (0.5, 0.5, 0.5), r) for r in (0.3, 0.4, 0.5, 0.6)]


def test_skin_encloses_its_cross_section():
    mesh = skin(PLAIN, *SKINS[:3])
    # Area of the polygon from its corners: twice the half that lies at y > 0, by the trapezoid rule over z.
    z = np.array([0.2, 0.2 + 0.4 * 0.7, 0.9 - 0.22 * 0.7, 0.9, 1.34, 1.4])
    y = 0.9 * np.array([0.94, 1.0, 0.985, 0.955, 0.955, 0.55 * 0.955])
    expected = 2 * np.sum((y[1:] + y[:-1]) / 2 * np.diff(z)) * 4.0
    t, _ = along(mesh, np.array([0.3, 5.0, 0.6]), np.array([0.0, -1.0, 0.0]))
    assert len(t) == 2  # closed: in and out
    assert abs(enclosed_volume(mesh.vertices, mesh.faces)) == pytest.approx(expected, rel=1e-9)


def test_wheels_stand_in_arches():
    body = replace(PLAIN, axles=(-1.2, 1.3), radius=0.32)
    mesh, sideways = skin(body, *SKINS[:3]), np.array([0.0, -1.0, 0.0])
    for x in body.axles:
        for z, hits in ((0.32, 0), (0.32 + 1.1 * 0.32, 0), (0.32 + 1.18 * 0.32, 2)):
            assert len(along(mesh, np.array([x + 0.001, 5.0, z]), sideways)[0]) == hits
    assert len(along(mesh, np.array([0.05, 5.0, 0.32]), sideways)[0]) == 2


def test_panes_and_openings_are_at_their_places():
    body = replace(PLAIN, side_panes=[(-0.5, 0.5)], top_panes=[(0.8, 1.2)], open=[(-1.5, -1.0)])
    mesh = skin(body, *SKINS[:3], roof=SKINS[3])
    down, sideways = np.array([0.0, 0.0, -1.0]), np.array([0.0, -1.0, 0.0])

    def met(origin, direction):
        return [round(float(r), 1) for r in mesh.attributes[along(mesh, np.array(origin), direction)[1], REFLECTIVITY]]

    assert met([0.01, 5.0, 1.1], sideways) == [0.4, 0.4]  # through both side windows
    assert met([0.7, 5.0, 1.1], sideways) == [0.3, 0.3]
    assert met([1.0, 0.1, 5.0], down) == [0.4, 0.5]  # windscreen, then underside
    assert met([-1.25, 0.1, 5.0], down) == [0.5]  # nothing above
    assert met([-0.2, 0.1, 5.0], down) == [0.3, 0.5]
    assert met([1.1, 0.1, 5.0], down)[0] == 0.4
