"""Split of the ground into paved and natural ground by colour."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import SoftLabels, label_softly
from mlsroad_pipeline.algorithms.models.pool import labeller as pool
from mlsroad_pipeline.algorithms.models.pool.labeller import (
    DARK,
    INTERCEPT,
    METADATA,
    NATURAL,
    NETWORK,
    PAVED,
    TERMS,
    TREES,
    colour_sums,
    ground_terms,
    natural_share,
    pool_bundle,
    with_ground_colour,
    with_trees,
)
from mlsroad_pipeline.model_store.shipped_models import load_shipped

CLASSES = (PAVED, NATURAL, "tree")
WEIGHTS = {**dict.fromkeys(TERMS, 0.0), "log_odds": 1.0, "green": 20.0, INTERCEPT: -2.0}
ASPHALT, GRASS, BARK = (110, 112, 115), (90, 120, 60), (70, 60, 50)


@pytest.fixture
def voxels():
    """Random voxels of three classes in regions, and points with random colours, some black or without a voxel."""
    rng = np.random.default_rng(5)
    m, n = 60, 900
    probabilities = rng.dirichlet([1, 1, 1], m)
    owner = rng.integers(-1, m, n).astype(np.int32)
    rgb = rng.integers(0, 256, (n, 3)).astype(np.uint8)
    rgb[rng.random(n) < 0.3] = 0
    rgb[owner == 4] = 0
    return probabilities, probabilities.argmax(axis=1), rgb, owner, rng.integers(0, 9, m).astype(np.int32)


def looked_up(colours):
    """Return green, warm and bright of the mean of some colours, from their definition."""
    red, green, blue = np.log(np.mean(colours, axis=0) + DARK)
    return np.array([green - (red + blue) / 2, red - blue, (red + green + blue) / 3])


def test_sums_are_those_of_a_loop_over_voxels(voxels):
    _, labels, rgb, owner, _ = voxels
    sums = colour_sums(rgb, owner, labels < 2)
    for voxel, label in enumerate(labels):
        own = rgb[(owner == voxel) & rgb.any(axis=1)].astype(int)
        wanted = [*own.sum(axis=0), len(own)] if label < 2 else [0, 0, 0, 0]
        assert sums[voxel].tolist() == wanted


def test_terms_are_those_of_a_loop_over_voxels(voxels):
    probabilities, labels, rgb, owner, region = voxels
    rows, terms = ground_terms(probabilities, labels, (0, 1), rgb, owner, region)
    seen = rgb.any(axis=1)
    assert rows.tolist() == [v for v in range(60) if labels[v] < 2 and (seen & (owner == v)).any()]
    assert 4 not in rows and list(terms) == list(TERMS)
    on_ground = seen & np.isin(owner, rows)
    own = np.array([looked_up(rgb[on_ground & (owner == v)]) for v in rows])
    around = np.array([looked_up(rgb[on_ground & np.isin(owner, np.flatnonzero(region == region[v]))]) for v in rows])
    reference = np.median(around[labels[rows] == 0], axis=0)
    assert (np.abs(reference[:2]) < [0.15, 0.5]).all()
    bounds = [0.4, 0.6, 1.5]
    own, around = (np.clip(each - reference, np.negative(bounds), bounds) for each in (own, around))
    np.testing.assert_allclose(terms["log_odds"], np.log(probabilities[rows, 1] / probabilities[rows, 0]))
    np.testing.assert_allclose(np.stack([terms["green"], terms["warm"]], axis=1), own[:, :2])
    np.testing.assert_allclose(terms["green_around"], around[:, 0])
    np.testing.assert_allclose(terms["warm_around"], around[:, 1])
    np.testing.assert_allclose(terms["bright_around"], around[:, 2])
    np.testing.assert_allclose(terms["bright_warm_around"], around[:, 1] * around[:, 2])


def test_share_is_a_logistic_function_of_the_weighted_terms():
    terms = {name: np.array([float(k), -1.0]) for k, name in enumerate(TERMS)}
    weights = {**{name: k / 10 for k, name in enumerate(TERMS)}, INTERCEPT: -3.0}
    wanted = [sum(k * k for k in range(len(TERMS))) / 10 - 3, -sum(range(len(TERMS))) / 10 - 3]
    np.testing.assert_allclose(natural_share(terms, weights), 1 / (1 + np.exp(-np.array(wanted))))


def model(slug, classes=CLASSES):
    return ModelBundle(slug, {}, {"classes": list(classes), "attributes": []})


@pytest.fixture
def street(monkeypatch):
    """A pool that is unsure on ground, and 40 points: asphalt, grass and a tree, one voxel for each five points."""
    owner = np.repeat(np.arange(8), 5)
    kinds = np.array([0, 0, 0, 1, 1, 1, 2, 2])
    table = np.array([[0.55, 0.4, 0.05], [0.55, 0.4, 0.05], [0.02, 0.08, 0.9]], np.float32)[kinds]

    def softly(bundle, cloud):
        return SoftLabels(table.argmax(axis=1).astype(np.int16)[owner], np.ones(40, np.float32), table, owner)

    monkeypatch.setattr(pool, "label_softly", softly)
    colours = np.array([ASPHALT, GRASS, BARK], float)[kinds[owner]] + np.random.default_rng(3).normal(0, 4, (40, 3))
    cloud = PointCloud(np.random.default_rng(2).random((40, 3)), {"rgb": np.clip(colours, 1, 255).astype(np.uint8)})
    return cloud, kinds[owner], table[owner]


def coloured_pool():
    plain = pool_bundle({"one": model("tests_one"), "two": model("tests_two")}, {"one": 0.5, "two": 0.5})
    return plain, with_ground_colour(plain, WEIGHTS)


def test_grass_is_separated_from_asphalt_by_colour_alone(street):
    cloud, kinds, table = street
    plain, coloured = coloured_pool()
    assert set(label_softly(plain, cloud).labels[kinds == 1]) == {0}
    soft = label_softly(coloured, cloud)
    assert soft.labels.tolist() == kinds.tolist()
    probabilities = soft.probabilities[soft.owner]
    np.testing.assert_allclose(probabilities[:, :2].sum(axis=1), table[:, :2].sum(axis=1), atol=1e-6)
    np.testing.assert_allclose(probabilities[:, 2], table[:, 2], atol=1e-6)
    np.testing.assert_allclose(probabilities[kinds == 2], table[kinds == 2], atol=1e-6)


@pytest.mark.parametrize("balance", [(1.2, 1.0, 0.8), (0.6, 0.6, 0.6), (0.9, 1.0, 1.3)])
def test_white_balance_and_exposure_do_not_change_the_labels(street, balance):
    cloud, kinds, _ = street
    other = cloud.with_columns(rgb=np.clip(cloud["rgb"] * np.array(balance), 1, 255).astype(np.uint8))
    assert label_softly(coloured_pool()[1], other).labels.tolist() == kinds.tolist()


def grey(cloud):
    return np.repeat(cloud["rgb"][:, :1], 3, axis=1)


@pytest.mark.parametrize(
    "colours",
    [
        None,
        grey,
        lambda cloud: np.full((len(cloud), 3), ASPHALT, np.uint8),
        lambda cloud: np.zeros((len(cloud), 3), np.uint8),
        lambda cloud: (0.9 * grey(cloud) * [1.0, 0.9, 0.8]).astype(np.uint8),
    ],
    ids=["none", "grey", "constant", "black", "sepia"],
)
def test_without_colour_labels_and_probabilities_stay_the_same_bytes(street, colours):
    cloud = street[0]
    plain, coloured = coloured_pool()
    other = cloud.without_columns(["rgb"]) if colours is None else cloud.with_columns(rgb=colours(cloud))
    wanted, found = label_softly(plain, cloud), label_softly(coloured, other)
    assert all(one.tobytes() == two.tobytes() for one, two in zip(wanted, found, strict=True))


def test_other_trees_keep_the_split_and_other_classes_have_none():
    bundle = pool_bundle({TREES: model("tests_one"), NETWORK: model("tests_two")}, {TREES: 0.5, NETWORK: 0.5})
    bundle = with_ground_colour(bundle, WEIGHTS)
    assert with_trees(bundle, model("tests_one")).metadata[METADATA] == WEIGHTS
    other = pool_bundle({"one": model("tests_one", "ab"), "two": model("tests_two", "ab")}, {"one": 0.5, "two": 0.5})
    assert with_ground_colour(other, WEIGHTS) is other


def test_shipped_pool_has_all_weights():
    assert set(load_shipped("pool").metadata[METADATA]) == {*TERMS, INTERCEPT}
