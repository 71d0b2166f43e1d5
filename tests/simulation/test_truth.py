"""Truth of a survey over several blocks and passes, against its points and the street built again."""

from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from references.simulator import GROUND_LABELS

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, TAXONOMY_NAMES
from mlsroad_pipeline.simulation import PRESETS, SurveyStream
from mlsroad_pipeline.simulation.furnishing.blocks import PASS_INSTANCES, populate
from mlsroad_pipeline.simulation.runtime.survey import SurveyPieces

NUMBERLESS = {*GROUND_LABELS, *(TAXONOMY[k] for k in ("building", "wall", "fence", "hedge", "stairs", "outlier"))}


@pytest.fixture(scope="module")
def surveyed():
    """Points and objects of two passes through four blocks, and the street."""
    parameters = replace(
        PRESETS["tiny"], seed=41, length=200.0, passes=2, with_images=False, pulse_rate=60_000.0, profile_rate=90.0
    )
    pieces = SurveyPieces(parameters)
    clouds = [cloud for cloud, _ in pieces]
    points = {
        name: np.concatenate([c[name] for c in clouds]) for name in ("label", "instance", "gps_time", "intensity")
    }
    points["xyz"] = np.concatenate([c.xyz for c in clouds])
    return points, pieces.objects, pieces.origin, pieces.street, parameters


@pytest.fixture(scope="module")
def by_instance(surveyed):
    """Rows of the points of every instance."""
    number = surveyed[0]["instance"]
    order = np.argsort(number, kind="stable")
    values, first = np.unique(number[order], return_index=True)
    return dict(zip(values.tolist(), np.split(order, first[1:]), strict=True))


@pytest.fixture(scope="module")
def standing(surveyed):
    """All static objects with an instance, built again."""
    street = surveyed[3]
    return {p.instance: p for block in range(-1, 6) for p in populate(street, block) if p.instance}


def test_points_of_objects_have_a_number_and_other_points_none(surveyed):
    points, table, *_ = surveyed
    without = points["instance"] == 0
    named = {TAXONOMY_NAMES[int(c)] for c in set(np.unique(points["label"][without])) - NUMBERLESS}
    assert named <= {"other_structure"}  # posts of gates and the like belong to no object
    assert set(np.unique(points["instance"][~without])) == set(table["instance"])
    assert not set(np.unique(points["label"][~without])) & set(GROUND_LABELS)


def test_numbers_are_unique_across_blocks_and_passes(surveyed):
    _, table, _, _, parameters = surveyed
    stream, seen = SurveyStream(parameters), []
    for each in (stream, stream.next_pass()):
        records = [r for block in range(-1, 6) for r in each.build(block).records]
        numbers = [r.instance for r in records]
        assert len(set(numbers)) == len(numbers)
        seen.append({r.instance: r for r in records})
    again = set(seen[0]) & set(seen[1])
    assert again == {i for i, r in seen[0].items() if not r.moving}
    assert all(i >= PASS_INSTANCES for i in set(seen[1]) - again)
    assert table["instance"].is_unique and set(table["instance"]) <= set(seen[0]) | set(seen[1])


def test_every_point_lies_on_the_object_whose_number_it_has(surveyed, by_instance, standing):
    points, table, *_ = surveyed
    away, checked = [], 0
    for row in table[~table["moving"]].itertuples():
        mesh = standing[row.instance].mesh
        xyz = points["xyz"][by_instance[row.instance]]
        scene = o3d.t.geometry.RaycastingScene()
        near = xyz.mean(axis=0)
        scene.add_triangles((mesh.vertices - near).astype(np.float32), mesh.faces.astype(np.uint32))
        away.append(scene.compute_distance((xyz - near).astype(np.float32)).numpy())
        checked += 1
    gap = np.concatenate(away)
    # Noise and errors of the trajectory; the rest is mixed pixels and blooming.
    assert checked > 250 and len(gap) > 30_000
    assert np.quantile(gap, 0.9) < 0.06 and np.mean(gap > 0.3) < 0.01


def test_bases_and_boxes_are_those_of_the_objects(surveyed, standing):
    _, table, origin, street, _ = surveyed
    local = table[["x", "y", "z"]].to_numpy() - origin
    kept = ~table["moving"].to_numpy() & (table["label"] != TAXONOMY["wire"]).to_numpy()
    ground = street.ground.height(*street.alignment.locate(local[kept, :2]))
    np.testing.assert_allclose(local[kept, 2], ground, atol=0.01)
    for row, base in zip(table[kept].itertuples(), local[kept], strict=True):
        xyz = standing[row.instance].mesh.vertices - base
        c, s = np.cos(row.heading), np.sin(row.heading)
        along, across = c * xyz[:, 0] + s * xyz[:, 1], c * xyz[:, 1] - s * xyz[:, 0]
        found = [np.ptp(along), np.ptp(across), xyz[:, 2].max()]
        np.testing.assert_allclose(found, [row.length, row.width, row.height], atol=1e-6)


def test_wires_hang_in_their_boxes(surveyed, by_instance, standing):
    points, table, origin, *_ = surveyed
    wires = table[table["label"] == TAXONOMY["wire"]]
    assert len(wires) > 5 and not wires[["x", "y"]].round(3).duplicated().all()
    for row in wires.itertuples():
        mesh = standing[row.instance].mesh.vertices + origin
        assert row.z == pytest.approx(mesh[:, 2].min()) and row.height == pytest.approx(np.ptp(mesh[:, 2]))
        c, s = np.cos(row.heading), np.sin(row.heading)
        for xyz, slack in ((mesh, 1e-6), (points["xyz"][by_instance[row.instance]] + origin, 0.3)):
            dx, dy = xyz[:, 0] - row.box_x, xyz[:, 1] - row.box_y
            inside = np.abs(c * dx + s * dy) <= row.length / 2 + slack
            inside &= np.abs(c * dy - s * dx) <= row.width / 2 + slack
            inside &= (xyz[:, 2] >= row.z - slack) & (xyz[:, 2] <= row.z + row.height + slack)
            assert inside.mean() > 0.97, row


def test_masts_follow_their_lean(surveyed, by_instance):
    points, table, origin, *_ = surveyed
    gaps, upright = [], []
    for row in table[table["label"].isin([TAXONOMY["light_pole"], TAXONOMY["utility_pole"]])].itertuples():
        xyz = points["xyz"][by_instance[row.instance]] + origin - [row.x, row.y, row.z]
        shaft = xyz[(xyz[:, 2] > 1.0) & (xyz[:, 2] < 0.75 * row.height) & (np.hypot(*xyz[:, :2].T) < 0.6)]
        if len(shaft) < 20:
            continue
        azimuth = np.radians(row.lean_azimuth)
        lean = np.tan(np.radians(row.tilt)) * shaft[:, 2:] * [np.sin(azimuth), np.cos(azimuth)]
        gaps.append(np.median(np.hypot(*(shaft[:, :2] - lean).T)))
        if row.tilt > 1.0:
            upright.append(np.median(np.hypot(*shaft[:, :2].T)) - gaps[-1])
    assert len(gaps) > 8
    assert np.max(gaps) < 0.22  # the radius of the thickest, and noise


def test_plates_lie_and_face_as_in_the_table(surveyed, by_instance):
    points, table, origin, *_ = surveyed
    checked = 0
    single = (table["panels"] == 1) & (table["design"] != "street_name_sign")
    for row in table[single].itertuples():
        at = np.array([row.panel_x, row.panel_y, row.z + row.panel_centre])
        xyz = points["xyz"][by_instance[row.instance]] + origin - at
        plate = xyz[(np.abs(xyz[:, 2]) < row.panel_height / 2) & (np.hypot(*xyz[:, :2].T) < row.panel_width / 2)]
        if len(plate) < 40:
            continue
        azimuth = np.radians(row.panel_azimuth)
        out = plate[:, :2] @ [np.sin(azimuth), np.cos(azimuth)]
        aside = plate[:, :2] @ [np.cos(azimuth), -np.sin(azimuth)]
        assert np.abs(np.median(out)) < 0.06, row
        assert np.ptp(np.quantile(aside, [0.02, 0.98])) > 0.5 * row.panel_width, row
        assert np.ptp(np.quantile(plate[:, 2], [0.02, 0.98])) > 0.5 * row.panel_height, row
        checked += 1
    assert checked > 5
