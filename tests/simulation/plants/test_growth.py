"""Parts of living designs: bars, blades, bodies, crowns and fronds."""

import gzip

import numpy as np
import open3d as o3d
import pytest
from design_sheet import scan_mesh
from references.simulator import enclosed_volume

from mlsroad_pipeline.algorithms.features.eigen import compute_eigen_features
from mlsroad_pipeline.simulation import bodies
from mlsroad_pipeline.simulation.model import solids
from mlsroad_pipeline.simulation.model.materials import foliage
from mlsroad_pipeline.simulation.model.meshes import KIND, Surface
from mlsroad_pipeline.simulation.model.solids import tube
from mlsroad_pipeline.simulation.objects import people, trees
from mlsroad_pipeline.simulation.plants import crowns, fronds
from mlsroad_pipeline.simulation.plants.crowns import Outline

GREY = Surface(31, (0.5, 0.5, 0.5), 0.5)


def test_many_bars_are_the_single_bars(rng):
    paths = np.cumsum(rng.normal(0, 1, (5, 4, 3)) + [0, 0, 2], axis=1)
    radii = rng.uniform(0.1, 0.3, (5, 4))
    many = solids.tubes(paths, radii, GREY, sides=6)
    for k in range(5):
        single = tube(paths[k], radii[k], GREY, sides=6)
        np.testing.assert_allclose(many.vertices[24 * k : 24 * (k + 1)], single.vertices[:-2], atol=1e-12)
    np.testing.assert_array_equal(many.faces[: 6 * 6], tube(paths[0], radii[0], GREY, sides=6).faces[: 6 * 6])


def test_closed_bars_enclose_prisms():
    # A 6-gon of circumradius r has the area 1.5 sqrt(3) r^2.
    paths = np.array([[[0, 0, 0], [0, 0, 1.0], [0, 0, 3.0]], [[5, 0, 0], [6.0, 0, 0], [8.0, 0, 0]]])
    mesh = solids.tubes(paths, [[0.2], [0.4]], GREY, sides=6, closed=True)
    expected = 1.5 * np.sqrt(3) * 3.0 * (0.2**2 + 0.4**2)
    assert abs(enclosed_volume(mesh.vertices, mesh.faces)) == pytest.approx(expected)
    assert len(mesh.faces) == 2 * (2 * 6 * 2 + 2 * 6 - 4)


def test_no_bars_are_an_empty_mesh():
    assert len(solids.tubes(np.zeros((0, 3, 3)), 0.1, GREY).faces) == 0


def test_bars_have_their_own_surfaces_and_flatten_in_y():
    paths = np.array([[[0, 0, 0], [0, 0, 1.0]], [[5.0, 0, 0], [5, 0, 1]]])
    mesh = solids.tubes(paths, 0.5, [GREY, Surface(32, (0.1, 0.1, 0.1), 0.2)], sides=4, flatten=0.5)
    np.testing.assert_array_equal(mesh.attributes[:, 0], np.repeat([31, 32], 8))
    assert np.ptp(mesh.vertices[:8, 1]) == pytest.approx(0.5 * np.ptp(mesh.vertices[:8, 0]))


def test_blades_have_the_area_of_their_triangles(rng):
    roots, directions = rng.normal(size=(50, 3)), rng.normal(size=(50, 3))
    length, width = rng.uniform(0.1, 0.3, 50), rng.uniform(0.02, 0.1, 50)
    mesh = solids.blades(roots, directions, length, width, GREY, rng)
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    np.testing.assert_allclose(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2, length * width / 2)
    np.testing.assert_allclose((a + b) / 2, roots, atol=1e-12)
    np.testing.assert_allclose(solids.unit(c - roots), solids.unit(directions), atol=1e-9)


def test_bows_are_quadratic_bezier_curves(rng):
    start, end = rng.normal(size=(7, 3)), rng.normal(size=(7, 3)) + 4
    heading = solids.unit(rng.normal(size=(7, 3)))
    paths = solids.bows(start, heading, end, 5, ease=0.4)
    np.testing.assert_allclose(paths[:, 0], start)
    np.testing.assert_allclose(paths[:, -1], end)
    control = start + 0.4 * np.linalg.norm(end - start, axis=1)[:, None] * heading
    np.testing.assert_allclose(paths[:, 2], 0.25 * start + 0.5 * control + 0.25 * end)


def test_lifting_keeps_the_order_of_heights_and_what_is_high(rng):
    mesh = solids.blades(rng.normal(0, 0.3, (200, 3)), rng.normal(size=(200, 3)), 0.1, 0.05, GREY, rng)
    lifted = solids.lift(mesh)
    assert lifted.vertices[:, 2].min() > 0
    high = mesh.vertices[:, 2] >= 0.1
    np.testing.assert_array_equal(lifted.vertices[high], mesh.vertices[high])
    order = mesh.vertices[:, 2].argsort()
    assert (np.diff(lifted.vertices[order, 2]) > 0).all()


@pytest.mark.parametrize("shell", [0.0, 4.0])
def test_scattered_places_have_the_mean_radius_of_their_density(rng, shell):
    # The density of the radius r is proportional to r^(2 + shell), whose mean is (3 + shell) / (4 + shell).
    radius = np.linalg.norm(solids.scatter(rng, 20_000, shell=shell), axis=1)
    assert radius.max() <= 1
    assert radius.mean() == pytest.approx((3 + shell) / (4 + shell), abs=0.005)


def test_joints_bend_at_the_lengths_of_their_parts(rng):
    start, end = rng.normal(size=(30, 3)), rng.normal(size=(30, 3))
    end = start + 0.6 * solids.unit(end - start)
    joint = bodies.bent_joint(start, end, 0.45, 0.4, [1.0, 0, 0])
    np.testing.assert_allclose(np.linalg.norm(joint - start, axis=1), 0.45)
    np.testing.assert_allclose(np.linalg.norm(joint - end, axis=1), 0.4)
    towards = joint - (start + end) / 2
    assert (towards @ [1.0, 0, 0] > np.linalg.norm(towards, axis=1) * 0.05).mean() > 0.9


@pytest.mark.parametrize("pose", [people._standing, people._walking, people._talking])
def test_bones_have_the_lengths_of_the_anthropometric_table(rng, pose):
    for _ in range(5):
        build = bodies.draw_build(rng)
        angles, lean = pose(rng)
        bones = people._pose(rng, build, angles, lean=lean)
        for a, b, share in (
            (bones.hips, bones.knees, 0.245), (bones.knees, bones.ankles, 0.246), (bones.shoulders, bones.elbows, 0.186),
        ):  # fmt: skip
            np.testing.assert_allclose(np.linalg.norm(a - b, axis=1), share * build.height)
        assert bones.ankles[:, 2].min() == pytest.approx(bodies.ANKLE * build.height)


def test_branches_start_at_the_nearest_node_by_gap_and_way(rng):
    outline = Outline(rng, 2.0, 8.0, 2.5, (0.5, 0.5))
    paths = rng.normal(0, 1, (6, 5, 3)) + [0, 0, 5]
    older = crowns.Wood(paths, np.full((6, 5), 0.1), rng.uniform(2, 6, (6, 5)))
    grown = crowns._reach(rng, outline, [older], 40, steps=4, shell=2.0, thin=0.5)
    for path, way in zip(grown.paths, grown.way, strict=True):
        costs = {
            (i, j): np.linalg.norm(paths[i, j] - path[-1]) + crowns._DETOUR * older.way[i, j]
            for i in range(6) for j in range(1, 5)
        }  # fmt: skip
        i, j = min(costs, key=costs.get)
        np.testing.assert_allclose(path[0], paths[i, j])
        assert way[0] == pytest.approx(older.way[i, j])
        assert way[-1] - way[0] == pytest.approx(np.linalg.norm(path[-1] - path[0]))


def test_places_are_inside_their_outline(rng):
    outline = Outline(rng, 2.0, 8.0, 2.5, (0.5, 0.5))
    places = outline.place(rng.random(5000), rng.uniform(0, 6.28, 5000), rng.random(5000))
    assert places[:, 2].min() >= 2.0 and places[:, 2].max() <= 8.0
    assert np.hypot(places[:, 0], places[:, 1]).max() < 2.5 * 1.6
    # An egg of half axes 3 and 2.5, a little more or less for its drawn exponents.
    assert outline.volume == pytest.approx(4 / 3 * np.pi * 2.5**2 * 3, rel=0.25)


def test_fronds_have_their_faces_and_hang_lower_the_more_they_bend(rng):
    leaf = foliage("green", "palm", rng)
    turn = np.linspace(0, 6, 9)
    ends = []
    for bend in (0.2, 1.6):
        shape = fronds.Feather(bend, 20, 0.2, 0.05)
        mesh = fronds.feathers(np.random.default_rng(1), [0, 0, 5.0], turn, np.full(9, 0.6), 2.0, shape, leaf)
        assert len(mesh.faces) == 9 * (24 + 40)
        ends.append(mesh.vertices[:, 2].mean())
    assert ends[1] < ends[0] - 0.3
    fan = fronds.fans(rng, [0, 0, 5.0], turn, np.full(9, 0.6), 1.0, 0.8, leaf, segments=13)
    assert len(fan.faces) == 9 * (12 + 26)


def _passing(mesh, height, radius):
    """Return the share of level beams that pass the middle of a crown, and the mean number of faces."""
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(mesh.vertices.astype(np.float32)),
        o3d.core.Tensor.from_numpy(mesh.faces.astype(np.uint32)),
    )
    y, z = np.meshgrid(np.linspace(-radius, radius, 40), np.linspace(height[0], height[1], 40))
    origin = np.column_stack([np.full(y.size, -50.0), y.ravel(), z.ravel()])
    rays = np.column_stack([origin, np.tile([1.0, 0, 0], (y.size, 1))]).astype(np.float32)
    counts = scene.count_intersections(o3d.core.Tensor.from_numpy(rays)).numpy()
    return float((counts == 0).mean()), float(counts.mean())


@pytest.mark.parametrize("name", ["round_tree", "pyramidal_tree", "multi_stem_tree"])
def test_beams_enter_crowns_and_some_pass(name):
    # Gap fractions of leafy street trees in the literature run from some 5 to 40 per cent.
    design = next(d for d in trees.DESIGNS if d.name == name)
    gaps, depths = [], []
    for seed in range(6):
        mesh = design.build(np.random.default_rng(seed))
        leaf = mesh.vertices[mesh.faces[mesh.attributes[:, KIND] == 3]].mean(axis=1)
        low, high = np.percentile(leaf[:, 2], [30, 70])
        gap, depth = _passing(mesh, (low, high), 0.5 * np.percentile(np.abs(leaf[:, 1]), 90))
        gaps.append(gap)
        depths.append(depth)
    assert 0.02 < np.mean(gaps) < 0.4
    assert np.mean(depths) > 1.5


def _medians(xyz, radius):
    features = compute_eigen_features(xyz, radius=radius)
    known = features["neighbor_count"] >= 8
    return np.array([np.nanmedian(features[k][known]) for k in ("linearity", "planarity", "scattering")])


def _thinned(xyz, size=0.08):
    _, first = np.unique(np.floor(xyz / size).astype(np.int64), axis=0, return_index=True)
    return xyz[np.sort(first)]


def test_crowns_have_the_eigenvalue_features_of_recorded_ones(real_data, rng):
    # One scanner, its profile plane across the track, and Oakland's spacing and noise.
    recorded = []
    for block in ("oakland_part2_ag", "oakland_part3_ak"):
        with gzip.open(real_data("oakland", f"{block}.xyz_label_conf.gz"), "rt") as lines:
            rows = np.array([line.split()[:4] for line in lines if line[0] in "-0123456789"], dtype=np.float64)
        recorded.append(_medians(_thinned(rows[rows[:, 3] == 1300, :3]), 0.3))
    simulated = []
    for seed in range(6):
        mesh = trees.DESIGNS[0].build(np.random.default_rng(seed))
        xyz, _, face = scan_mesh(mesh, distance=8.0, spacing=0.12, slant=0.0)
        xyz = xyz[mesh.attributes[face, 0] == 31]
        simulated.append(_medians(_thinned(xyz + rng.normal(0, 0.02, xyz.shape)), 0.3))
    np.testing.assert_allclose(np.mean(simulated, axis=0), np.mean(recorded, axis=0), atol=0.1)


def test_walkers_are_as_high_and_wide_as_recorded_pedestrians(real_data):
    record = np.dtype([
        ("t", "<i8"), ("intensity", "u1"), ("id", "u1"), ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("azimuth", "<f4"),
        ("range", "<f4"), ("pid", "<i4"),
    ])  # fmt: skip
    recorded = []
    for path in sorted(real_data("sydney", "objects").glob("pedestrian.*.bin")):
        points = np.fromfile(path, record)
        if len(points) > 60:
            recorded.append((np.ptp(points["z"]), np.hypot(np.ptp(points["x"]), np.ptp(points["y"]))))
    simulated = []
    adults = [d for d in people.DESIGNS if d.name in people.WALKERS and d.name[-5:] not in ("child", "tcase")]
    for seed in range(12):
        for design in adults:
            xyz, _, _ = scan_mesh(design.build(np.random.default_rng(seed)), spacing=0.06)
            simulated.append((np.ptp(xyz[:, 2]), np.hypot(*np.ptp(xyz[:, :2], axis=0))))
    assert len(recorded) > 40
    np.testing.assert_allclose(np.median(simulated, axis=0), np.median(recorded, axis=0), atol=0.15)
