import numpy as np
import pytest

from mlsroad_pipeline.algorithms.classes import TAXONOMY
from mlsroad_pipeline.algorithms.simulation.ground import GROUND_LABELS
from mlsroad_pipeline.algorithms.simulation.layout import populate
from mlsroad_pipeline.algorithms.simulation.street import BLOCK, draw_street


@pytest.fixture(scope="module")
def street():
    return draw_street(3, length=120.0)


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


def test_the_ground_has_slope_crown_and_curbs():
    grades, steps, crowns = [], [], []
    for seed in range(8):
        street = draw_street(seed, length=120.0)
        ground = street.ground
        s = np.arange(0, 120, 1.0)
        grades.append(np.abs(np.gradient(ground.height(s, 0.0), s)).max())
        half = ground.section[0, 0]
        steps.append((ground.height(s, half + 0.05) - ground.height(s, half - 0.01)).max())
        crowns.append(ground.height(s, 0.0).mean() - (ground.height(s, half) + ground.height(s, -half)).mean() / 2)
    assert max(grades) > 0.02
    assert min(steps) > 0.07 and max(steps) < 0.18
    assert min(crowns) > 0.02


def test_mesh_follows_the_height_function(street, rng):
    mesh = ground_mesh(street, 0)
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    station, offset = street.alignment.locate(middles[:, :2])
    gap = np.abs(middles[:, 2] - street.ground.height(station, offset))
    assert np.quantile(gap, 0.98) < 0.025
    assert gap.max() < 0.1


def test_neighbouring_blocks_share_their_seam(street):
    a, b = ground_mesh(street, 0), ground_mesh(street, 1)
    shared = {tuple(v) for v in np.round(a.vertices, 6)} & {tuple(v) for v in np.round(b.vertices, 6)}
    assert len(shared) == len(a.vertices) // (int(BLOCK / 0.5) + 1)


def test_surface_labels_lie_where_the_section_says(street):
    ground = street.ground
    half, _, curb, verge, pavement = ground.section[0]
    s = np.arange(0, 120, 0.31)
    assert set(ground.labels(s, half + curb / 2)) == {TAXONOMY["curb"]}
    assert set(ground.labels(s, half + curb + verge + pavement / 2)) == {TAXONOMY["sidewalk"]}
    on_road = ground.labels(s[:, None], np.linspace(-2.5, 2.5, 60)[None])
    assert set(np.unique(on_road)) <= {TAXONOMY[k] for k in ("road", "lane_marking", "manhole")}
    assert np.mean(on_road == TAXONOMY["lane_marking"]) < 0.2
    everywhere = ground.labels(s[:, None], np.linspace(-50, 50, 300)[None])
    assert set(np.unique(everywhere)) <= set(GROUND_LABELS)


def test_blocks_are_drawn_alike_every_time_and_numbered_apart(street):
    first, again, second = populate(street, 0), populate(street, 0), populate(street, 1)
    assert [p.instance for p in first] == [p.instance for p in again]
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a.mesh.vertices, b.mesh.vertices)
    numbers = [p.instance for p in first + second if p.instance]
    assert len(numbers) == len(set(numbers))


def test_nothing_floats(street):
    for placed in populate(street, 0) + populate(street, 1):
        if placed.label in (TAXONOMY["wire"], TAXONOMY["traffic_sign"], TAXONOMY["building"]):
            continue  # wires and plates on lamps hang; shop signs are parts of buildings
        low = placed.mesh.vertices[placed.mesh.vertices[:, 2].argmin()]
        station, offset = street.alignment.locate(low[None, :2])
        assert low[2] - street.ground.height(station, offset)[0] < 0.12, placed.label
