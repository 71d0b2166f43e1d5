import numpy as np
import pytest
from references.simulator import first_triangle, scene_of

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.meshes import GLASS, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, quads
from mlsroad_pipeline.simulation.rays.moving import Motion, Mover
from mlsroad_pipeline.simulation.street.street import draw_street

WALL, CAR, PANE = (
    Surface(21, (0.5, 0.5, 0.5), 0.5),
    Surface(50, (0.5, 0.1, 0.1), 0.4),
    Surface(20, (0.1, 0.1, 0.1), 0.3, GLASS),
)


@pytest.fixture(scope="module")
def street():
    return draw_street(1, length=60.0)


def rays_of(origins, directions):
    d = np.asarray(directions, dtype=float)
    return np.hstack([origins, d / np.linalg.norm(d, axis=1, keepdims=True)]).astype(np.float32)


def test_hits_equal_a_search_over_all_triangles(street, rng):
    meshes = [box(rng.uniform(0.2, 2, 3), rng.uniform(-5, 5, 3), WALL) for _ in range(12)]
    scene = scene_of(street, meshes, range(1, 13), [], np.array([0.5, -0.25, 1.0]))
    rays = rays_of(rng.uniform(-8, 8, (200, 3)), rng.normal(size=(200, 3)))
    hits = scene.cast(rays, np.zeros(200))
    whole = join(meshes)
    for i in range(200):
        origin = rays[i, :3].astype(float) + scene.centre
        distance, face = first_triangle(origin, rays[i, 3:].astype(float), whole.vertices, whole.faces)
        assert hits.distance[i] == pytest.approx(distance, abs=1e-4)
        assert (hits.face[i] < 0) == (face < 0)
        if face >= 0:
            assert scene.instances[hits.face[i]] == face // 12 + 1
    np.testing.assert_array_equal(scene.occluded(rays, np.zeros(200)), hits.face >= 0)


def test_nothing_behind_a_wall_is_hit(street):
    wall, hidden = box([0.2, 20, 20], [5, 0, 0], WALL), box([2, 2, 2], [10, 0, 0], CAR)
    scene = scene_of(street, [wall, hidden], [1, 2], [], np.zeros(3))
    angles = np.linspace(-0.5, 0.5, 300)
    rays = rays_of(np.zeros((300, 3)), np.column_stack([np.cos(angles), np.sin(angles), 0.1 * angles]))
    surfaces = scene.resolve(scene.cast(rays, np.zeros(300)), rays)
    assert set(surfaces.label) == {21}


def test_most_rays_pass_glass_and_none_without_passing(street, rng):
    pane = quads([[5, -20, -20], [5, 20, -20], [5, 20, 20], [5, -20, 20]], PANE)
    scene = scene_of(street, [pane, box([1, 50, 50], [8, 0, 0], WALL)], [0, 0], [], np.zeros(3))
    rays = rays_of(np.zeros((4000, 3)), np.tile([1.0, 0, 0], (4000, 1)))
    through = scene.cast(rays, np.zeros(4000), passing=rng.random(4000, dtype=np.float32))
    behind = through.distance > 6
    assert behind.mean() == pytest.approx(0.92, abs=0.02)
    np.testing.assert_allclose(through.distance[behind], 7.5, atol=1e-4)
    np.testing.assert_allclose(scene.cast(rays, np.zeros(4000)).distance, 5.0, atol=1e-5)


@pytest.mark.parametrize("speed", [10.0, -7.0])
def test_moving_objects_are_where_they_are_at_each_rays_time(street, speed):
    body = box([4, 1.6, 1.4], [0, 0, 0.9], CAR)
    mover = Mover(TAXONOMY["car"], 9, body, Motion(20.0, 2.0, speed, -1.5))
    times = np.linspace(1.0, 3.0, 41)
    stations = 20.0 + speed * (times - 2.0)
    xy, heading = street.alignment.place(stations, -1.5)
    z = street.ground.height(stations, -1.5)
    above = np.column_stack([xy, z + 10.0])
    scene = scene_of(street, [box([1, 1, 1], [500, 500, 0], WALL)], [0], [mover], np.zeros(3))
    hits = scene.cast(rays_of(above, np.tile([0, 0, -1.0], (41, 1))), times)
    np.testing.assert_allclose(hits.distance, 10.0 - 1.6, atol=2e-3)
    assert (scene.instances[hits.face] == 9).all()
    forward = np.column_stack([np.cos(heading), np.sin(heading)])
    beside = above.copy()
    beside[:, :2] += 2.2 * forward
    assert not np.isfinite(scene.cast(rays_of(beside, np.tile([0, 0, -1.0], (41, 1))), times).distance).any()
    # Half a second later the object has left.
    assert not np.isfinite(scene.cast(rays_of(above, np.tile([0, 0, -1.0], (41, 1))), times + 0.5).distance).any()
