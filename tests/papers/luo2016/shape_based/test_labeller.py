"""Shape-based recognition: locations, cuts and features with known results, and planted streets."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.papers.luo2016.shape_based.cutting import (
    SPIN_HEIGHTS,
    CutGraph,
    CutParameters,
    cut_out,
    describe_objects,
    link_sites,
    locate,
    segment_objects,
)
from mlsroad_pipeline.papers.luo2016.shape_based.labeller import (
    ShapeParameters,
    build_objects,
    fit,
    label_cloud,
    label_objects,
    training_objects,
)
from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters, PatchStages
from mlsroad_pipeline.papers.shared.patches.labelling import build_patches


def column(x, y, top, *, step=0.2, bottom=0.4):
    z = np.arange(bottom, top, step)
    return np.column_stack([np.full(len(z), x), np.full(len(z), y), z])


def box(x, y, size, *, step=0.2, bottom=0.4):
    axes = [np.arange(0, s, step) for s in size]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid + [x - size[0] / 2, y - size[1] / 2, bottom]


def test_upright_things_are_located(rng):
    poles = np.array([[1.0, 1.0], [6.0, 2.0], [3.0, 7.0]])
    sites = np.concatenate([column(x, y, 5.0 + i) for i, (x, y) in enumerate(poles)])
    found = locate(sites + rng.normal(0, 0.01, sites.shape), spacing=1.0)
    assert len(found) == 3
    distance = np.linalg.norm(found[:, None] - poles[None], axis=2)
    assert distance.min(axis=1).max() < 0.1
    assert distance[0].argmin() == 2  # the tallest comes first


def test_links_are_those_of_brute_force(rng):
    sites = rng.uniform(0, 2, (60, 3))
    edges, weights = link_sites(sites, neighbours=4, link=0.3)
    distance = np.linalg.norm(sites[:, None] - sites[None], axis=2)
    nearest = np.argsort(distance, axis=1)[:, 1:5]
    expected = {tuple(sorted((i, int(j)))) for i in range(60) for j in nearest[i]}
    assert {tuple(edge) for edge in edges.tolist()} == expected
    np.testing.assert_allclose(weights, np.exp(-distance[edges[:, 0], edges[:, 1]] / 0.3))
    assert len(link_sites(sites[:1], neighbours=4, link=0.3)[0]) == 0


def test_a_cut_is_the_best_of_all(rng):
    """Against enumeration of all foregrounds between core and radius."""
    p = CutParameters(radii=(1.0,), core=0.2, background=0.5)
    for _ in range(20):
        sites = np.column_stack([rng.uniform(-1.2, 1.2, (11, 2)), np.zeros(11)])
        sites[0] = 0
        edges, weights = link_sites(sites, neighbours=3, link=0.6)
        front, _ = cut_out(np.zeros(2), sites, edges, weights, CutGraph(edges, 11), p)
        distance = np.linalg.norm(sites, axis=1)
        free = np.flatnonzero((distance > p.core) & (distance <= 1.0))

        def cost(inside, distance=distance, free=free, edges=edges, weights=weights):
            outside_cost = 0.5 * distance[free][inside[free]].sum()
            return outside_cost + weights[inside[edges[:, 0]] != inside[edges[:, 1]]].sum()

        best = np.inf
        for choice in range(2 ** len(free)):
            inside = distance <= p.core
            inside[free] = (choice >> np.arange(len(free))) & 1
            best = min(best, cost(inside))
        assert cost(front) == pytest.approx(best)


def test_distant_objects_are_separate():
    parts = [column(0, 0, 6.0), box(5, 0, (3.0, 1.6, 1.2)), column(0, 6, 6.0), box(6, 6, (2.0, 2.0, 2.0))]
    sites = np.concatenate(parts)
    truth = np.repeat(np.arange(4), [len(part) for part in parts])
    found = segment_objects(sites, CutParameters())
    assert found.dtype == np.int32 and found.max() == 3
    assert np.array_equal(found, truth)  # numbered by first site
    assert segment_objects(sites[:0], CutParameters()).shape == (0,)
    assert segment_objects(sites[:1], CutParameters()).tolist() == [0]


def test_a_pole_is_cut_out_of_a_hedge():
    pole, hedge = column(0, 0, 6.0), box(0, 0, (12.0, 0.6, 0.7))
    sites = np.concatenate([pole, hedge])
    found = segment_objects(sites, CutParameters())
    of_pole = found[0]
    assert (found[: len(pole)] == of_pole).all()
    assert (found[len(pole) :] == of_pole).mean() < 0.35  # the hedge beyond the pole's surroundings is other objects


def test_description_of_known_shapes():
    parts = [column(0, 0, 8.4), box(20, 0, (4.0, 2.0, 1.4))]
    sites = np.concatenate(parts)
    owner = np.repeat(np.arange(2, dtype=np.int32), [len(part) for part in parts])
    found = describe_objects(sites, sites[:, 2], owner[:, None].astype(float), owner)
    pole, car = found
    np.testing.assert_allclose(np.exp([pole[0], car[0]]), [40, len(parts[1])], rtol=1e-5)
    np.testing.assert_allclose(pole[1:3], 0, atol=1e-4)
    np.testing.assert_allclose(car[1:3], [3.8, 1.8], atol=1e-4)  # length, width
    assert pole[6] == pytest.approx(1.0) and pole[9] == pytest.approx(1.0)  # linear, upright
    assert car[9] < 0.01
    np.testing.assert_allclose(pole[11:15], [0.4, 4.3, 8.2, 7.8], atol=1e-4)
    image = pole[16 : 16 + 5 * (len(SPIN_HEIGHTS) - 1)].reshape(5, -1)
    np.testing.assert_allclose(image[0], np.histogram(parts[0][:, 2], [-9, 1, 2, 3, 4.5, 6, 8, 99])[0] / 40, atol=1e-6)
    assert not image[1:].any()
    np.testing.assert_allclose(pole[-1:], 0)
    np.testing.assert_allclose(car[-1:], 1)
    turned = sites[:, [1, 0, 2]] * [-1, 1, 1]
    np.testing.assert_allclose(describe_objects(turned, sites[:, 2], owner[:, None], owner), found, atol=1e-4)


def planted_street(seed, n_objects=12, *, colour=True):
    """Poles and cars on a flat road, every point labelled: 0 road, 1 pole, 2 car."""
    rng = np.random.default_rng(seed)
    road = np.column_stack([rng.uniform(0, 40, 20000), rng.uniform(0, 12, 20000), rng.normal(0, 0.01, 20000)])
    parts, labels = [road], [np.zeros(len(road))]
    for number in range(n_objects):
        x, y = 3.0 + 6.0 * (number % 6), 3.0 + 6.0 * (number // 6)
        if number % 2:
            points = column(x, y, rng.uniform(5, 7), step=0.02, bottom=0.0)
        else:
            points = box(x, y, (3.6, 1.7, 1.4), step=0.12, bottom=0.25)
        parts.append(points + rng.normal(0, 0.01, points.shape))
        labels.append(np.full(len(points), 2 - number % 2))
    xyz = np.concatenate(parts)
    columns = {"label": CODES[np.concatenate(labels).astype(int)]}
    if colour:
        columns["rgb"] = rng.integers(0, 255, (len(xyz), 3)).astype(np.uint8)
    return PointCloud(xyz, columns)


SCHEME = ClassScheme("toy", ("paved", "post", "car"), (("road",), ("light_pole",), ("car",)), (), (11, 64, 65))
CODES = np.array([TAXONOMY[name] for name in ("road", "light_pole", "car")], np.uint8)
PARAMETERS = ShapeParameters(n_trees=20)


def prepared(cloud):
    ground = find_ground(cloud, GroundParameters())
    return cloud, ground, build_patches(cloud, ground, PatchParameters())


@pytest.fixture(scope="module")
def model():
    stages = PatchStages(GroundParameters(), PatchParameters())
    rows = [training_objects(*prepared(planted_street(seed)), scheme=SCHEME, parameters=PARAMETERS) for seed in (1, 2)]
    return fit(rows, parameters=PARAMETERS, stages=stages, scheme=SCHEME, trained_on={"survey": "toy"})


def test_planted_objects_are_recognised_and_the_ground_is_left(model):
    cloud = planted_street(9)
    labels, confidence = label_cloud(cloud, model)
    ground = find_ground(cloud, GroundParameters())["ground"]
    assert (labels[ground] == -1).all() and not confidence[ground].any()
    truth = SCHEME.encode(cloud["label"])
    off = ~ground & (truth > 0)
    assert (labels[off] == truth[off]).mean() > 0.97
    assert labels.dtype == np.int16 and confidence.dtype == np.float32
    assert "paved" not in model.metadata["classes_given"]
    again = label_objects(*prepared(cloud), model)
    assert np.array_equal(again["label"], labels) and np.array_equal(again["confidence"], confidence)


def test_result_is_invariant_to_translation(model):
    cloud = planted_street(9)
    moved = PointCloud(cloud.xyz, origin=np.array([512_000.0, 5_400_000.0, 200.0]), columns={"rgb": cloud["rgb"]})
    assert (label_cloud(cloud, model)[0] == label_cloud(moved, model)[0]).mean() > 0.99


def test_scenes_of_ground_only_and_without_colour(model):
    rng = np.random.default_rng(0)
    flat = PointCloud(np.column_stack([rng.uniform(0, 9, (4000, 2)), rng.normal(0, 0.01, 4000)]))
    labels, confidence = label_cloud(flat, model)
    assert (labels == -1).mean() > 0.999 and confidence.max() == 0
    bare = planted_street(9, colour=False)
    truth = SCHEME.encode(bare["label"])
    assert (label_cloud(bare, model)[0] == truth)[truth > 0].mean() > 0.8
    one = PointCloud(np.zeros((1, 3)))
    assert label_cloud(one, model)[0].shape == (1,)


def test_training_needs_objects_of_two_classes():
    stages = PatchStages(GroundParameters(), PatchParameters())
    options = {"parameters": PARAMETERS, "stages": stages, "scheme": SCHEME, "trained_on": {}}
    counts = np.ones((2, len(SCHEME.classes)), np.int64)
    empty = {"features": np.zeros((0, 1), np.float32), "label": np.zeros(0, np.int16), "on_ground": counts}
    with pytest.raises(DataError, match="no labelled object"):
        fit([empty], **options)
    with pytest.raises(DataError, match="all training objects are of post"):
        fit([{"features": np.zeros((3, 4), np.float32), "label": np.ones(3, np.int16), "on_ground": counts}], **options)


def test_classes_on_the_ground_are_not_predicted(rng):
    """A few tufts of a ground class are segmented as objects; the class is still not predicted."""
    stages = PatchStages(GroundParameters(), PatchParameters())
    options = {"parameters": PARAMETERS, "stages": stages, "scheme": SCHEME, "trained_on": {}}
    labels = np.arange(3).repeat(5).astype(np.int16)
    scene = {"features": rng.random((15, 4)).astype(np.float32), "label": labels}
    counts = np.zeros((2, len(SCHEME.classes)), np.int64)
    counts[:, :3] = [[10, 50, 50], [90, 3, 50]]
    found = fit([{**scene, "on_ground": counts}, {**scene, "on_ground": counts}], **options)
    assert found.metadata["classes_given"] == list(SCHEME.classes[1:3])
    cloud, ground, patches = prepared(planted_street(3))
    rows = training_objects(cloud, ground, patches, scheme=SCHEME, parameters=PARAMETERS)["on_ground"]
    assert rows.sum() == len(patches["height"]) and rows[1, 0] > rows[0, 0]  # paved lies on the ground


def test_without_appearance_the_last_columns_are_missing():
    _, ground, patches = prepared(planted_street(3))
    whole = build_objects(ground, patches, PARAMETERS)["features"]
    shape = build_objects(ground, patches, ShapeParameters(appearance=False))["features"]
    assert shape.shape[1] == whole.shape[1] - patches["fpfh"].shape[1] - 3
    assert np.array_equal(shape, whole[:, : shape.shape[1]])


def test_objects_of_a_scene_are_the_same_every_time():
    _, ground, patches = prepared(planted_street(3))
    one, other = build_objects(ground, patches, PARAMETERS), build_objects(ground, patches, PARAMETERS)
    assert all(one[name].tobytes() == other[name].tobytes() for name in one)
    assert np.isfinite(one["features"]).all()


@pytest.mark.parametrize(
    "change", [{"spacing": 0.0}, {"radii": [2.0, 1.0]}, {"radii": []}, {"background": -1.0}, {"n_trees": 0}]
)
def test_bad_parameters_are_named(change):
    ((name, _),) = change.items()
    with pytest.raises(ParameterError, match=name):
        ShapeParameters(**change)
