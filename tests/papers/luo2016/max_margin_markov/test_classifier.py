"""The max-margin Markov network: its parts against enumeration, and what boosting and context gain on planted scenes."""

from itertools import product

import numpy as np
import pytest
from sklearn.cluster import KMeans

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.papers.luo2016.max_margin_markov.classifier import (
    MarginParameters,
    MaxMarginMarkov,
)
from mlsroad_pipeline.papers.luo2016.max_margin_markov.network import (
    BoostedTrees,
    MarkovGraph,
    MarkovNetwork,
    build_markov_graph,
    clique_shares,
    kmeans_labels,
)
from mlsroad_pipeline.papers.shared.patches.table import Patches, join_patches

QUICK = MarginParameters(n_rounds=15, site_depth=4, batch_patches=1000, fit_rows=2000)


def planted_scene(rng, number=0, *, noise=1.5, side=24, colour=True):
    """A sheet of patches in three stripes of one class each; shape says the class only under much noise."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(side), np.arange(side), indexing="ij"))
    label = np.minimum(x * 3 // side, 2)
    n = len(x)
    fpfh = np.abs(np.eye(3)[label] + rng.normal(0, noise, (n, 3)))
    step = np.array([[0, 1], [1, 0]])
    index = np.arange(n).reshape(side, side)
    edges = np.concatenate(
        [np.stack([index[: side - a, : side - b].ravel(), index[a:, b:].ravel()], axis=1) for a, b in step]
    )
    rgb = np.clip(0.5 + rng.normal(0, 0.2, (n, 3)), 0, 1) if colour else None
    centroid = 0.2 * np.column_stack([x, y, np.zeros(n)])
    return Patches(fpfh, rgb, rng.uniform(0, 3, n), centroid, np.full(n, number), label), edges


def training_set(rng, n_scenes=4, **options):
    parts, edges = zip(*(planted_scene(rng, number, **options) for number in range(n_scenes)), strict=True)
    shifts = np.cumsum([0, *(len(part) for part in parts)])[:-1]
    return join_patches(parts), np.concatenate([e + s for e, s in zip(edges, shifts, strict=True)])


@pytest.fixture(scope="module")
def fitted():
    rng = np.random.default_rng(4)
    return MaxMarginMarkov.fit(*training_set(rng), n_classes=4, parameters=QUICK)


def random_network(rng, n_labels=3):
    network = MarkovNetwork(n_labels, 0.5)
    for part, width in (("sites", 7), ("pairs", 4), ("groups", 10)):
        for seed in range(3):
            features = rng.normal(size=(60, width)).astype(np.float32)
            target = np.abs(rng.normal(size=(60, n_labels))) if part != "sites" else rng.normal(size=(60, n_labels))
            network.trees[part].grow(
                features, target, np.ones(60), step=1.0, max_depth=3, min_samples_leaf=2, seed=seed
            )
    return network


def score_of(labels, graph, potentials, truncation):
    sites, agreement, reward = potentials
    total = sum(sites[i, label] for i, label in enumerate(labels))
    total += sum(agreement[e, labels[i]] for e, (i, j) in enumerate(graph.edges) if labels[i] == labels[j])
    for c in range(len(graph.sizes)):
        members = graph.members[graph.indptr[c] : graph.indptr[c + 1]]
        have = np.bincount(np.asarray(labels)[members], minlength=sites.shape[1]) / len(members)
        total += max(0.0, float((reward[c] * (1 - (1 - have) / truncation)).max()))
    return total


def small_graph(rng):
    patches, _ = planted_scene(rng, side=3)
    pairs = np.array([(i, j) for i in range(6) for j in range(i) if rng.random() < 0.4])
    return build_markov_graph(patches.take(np.arange(6)), pairs, [0.3, 0.1])


def test_search_and_conditionals_against_enumeration(rng):
    """Hardly any labelling scores more than the one found, and each site's conditionals are those of the total score."""
    optimal = 0
    for _ in range(6):
        network, graph = random_network(rng), small_graph(rng)
        potentials = network.potentials(graph)
        labels = network.best_labels(graph, potentials)
        score = score_of(labels, graph, potentials, 0.5)
        best = max(score_of(other, graph, potentials, 0.5) for other in product(range(3), repeat=len(labels)))
        optimal += score >= best - 1e-6
        found = network.conditional_probabilities(graph, 2.0)
        assert np.array_equal(found.argmax(axis=1), labels)
        for i in range(len(labels)):
            changed = [score_of([*labels[:i], k, *labels[i + 1 :]], graph, potentials, 0.5) for k in range(3)]
            expected = np.exp((np.array(changed) - max(changed)) / 2.0)
            np.testing.assert_allclose(found[i], expected / expected.sum(), atol=1e-6)
    assert optimal >= 4


def test_clique_shares_by_hand():
    nothing, members = np.zeros((0, 1), np.float32), np.array([0, 1, 2, 3, 2, 3], np.int32)
    graph = MarkovGraph(nothing, np.zeros((0, 2), np.int32), nothing, np.array([0, 4, 6]), members, nothing)
    shares = clique_shares(graph, np.array([0, 0, 0, 1]), 3, 0.5)
    np.testing.assert_allclose(shares, [[0.5, 0, 0], [0, 0, 0]])


def test_trees_sum_what_scikit_learn_predicts(rng):
    from sklearn.tree import DecisionTreeRegressor

    features, target = rng.normal(size=(300, 5)).astype(np.float32), rng.normal(size=(300, 3))
    weight = rng.uniform(0.1, 1, 300)
    trees, expected = BoostedTrees(3), np.zeros((300, 3))
    assert np.array_equal(trees.predict(features), expected)
    for number, step in enumerate((1.0, 0.3)):
        trees.grow(features, target, weight, step=step, max_depth=4, min_samples_leaf=5, seed=number)
        tree = DecisionTreeRegressor(max_depth=4, min_samples_leaf=5, random_state=number)
        expected += step * tree.fit(features, target, sample_weight=weight).predict(features)
    assert len(trees) == 2
    np.testing.assert_allclose(trees.predict(features), expected, atol=1e-6)
    again = BoostedTrees.from_arrays(trees.to_arrays("x"), "x")
    assert np.array_equal(again.predict(features), trees.predict(features))


def test_kmeans_is_a_local_optimum_as_good_as_the_usual(rng):
    points = rng.uniform(0, 10, (600, 3))
    points = points[np.lexsort(np.floor(points).T)]  # neighbours in order are neighbours in space
    labels = kmeans_labels(points, 20)
    _, first = np.unique(labels, return_index=True)
    assert labels.dtype == np.int32 and np.all(np.diff(first) > 0)
    inertia = sum(((points[labels == k] - points[labels == k].mean(axis=0)) ** 2).sum() for k in np.unique(labels))
    usual = KMeans(20, n_init=1, max_iter=20, init="random", random_state=0).fit(points).inertia_
    assert inertia < 1.1 * usual
    assert kmeans_labels(points[:5], 5).tolist() == [0, 1, 2, 3, 4]
    assert kmeans_labels(np.zeros((4, 3)), 3).tolist() == [0, 0, 0, 0]


def test_context_tells_what_sites_alone_cannot(rng, fitted):
    patches, edges = planted_scene(np.random.default_rng(99))
    with_context = fitted.predict_proba(patches, edges)
    alone = fitted.network.trees["sites"].predict(build_markov_graph(patches, edges, []).sites)[:, :3].argmax(axis=1)
    assert (with_context.argmax(axis=1) == patches.label).mean() > (alone == patches.label).mean() + 0.2
    assert with_context.shape == (len(patches), 4) and not with_context[:, 3].any()  # class 3 was never seen
    np.testing.assert_allclose(with_context.sum(axis=1), 1.0)
    assert fitted.errors[-1] < 0.5 * fitted.errors[0]


def test_same_seed_same_model_and_round_trip(rng, fitted):
    again = MaxMarginMarkov.fit(*training_set(np.random.default_rng(4)), n_classes=4, parameters=QUICK, n_threads=3)
    arrays = fitted.to_arrays()
    assert all(np.array_equal(arrays[name], other) for name, other in again.to_arrays().items())
    assert all(array.dtype != object for array in arrays.values())
    patches, edges = planted_scene(rng)
    loaded = MaxMarginMarkov.from_arrays(arrays)
    assert loaded.predict_proba(patches, edges).tobytes() == fitted.predict_proba(patches, edges).tobytes()


def test_colour_may_be_missing_on_either_side(rng, fitted):
    patches, edges = planted_scene(np.random.default_rng(5))
    bare = patches.with_columns(rgb=None)
    grey = patches.with_columns(rgb=np.tile(fitted.colour, (len(patches), 1)))
    assert np.array_equal(fitted.predict_proba(bare, edges), fitted.predict_proba(grey, edges))
    colourless = MaxMarginMarkov.fit(*training_set(rng, 1, colour=False), n_classes=3, parameters=QUICK)
    assert np.array_equal(colourless.predict_proba(patches, edges), colourless.predict_proba(bare, edges))


def test_small_scenes_are_labelled(rng, fitted):
    patches, _ = planted_scene(rng)
    none = np.zeros((0, 2), np.int32)
    one = fitted.predict_proba(patches.take(np.arange(1)), none)
    assert one.shape == (1, 4) and one.sum() == pytest.approx(1.0)
    assert fitted.predict_proba(patches.take(np.arange(0)), none).shape == (0, 4)


def test_training_needs_labels_of_two_classes(rng):
    patches, edges = planted_scene(rng)
    same = patches.with_columns(label=np.zeros(len(patches)))
    with pytest.raises(DataError, match="all training patches are of class 0"):
        MaxMarginMarkov.fit(same, edges, n_classes=3)
    with pytest.raises(DataError, match="from 0 to 1, got 0 to 2"):
        MaxMarginMarkov.fit(patches, edges, n_classes=2)
    with pytest.raises(DataError, match="no patches to train on"):
        MaxMarginMarkov.fit(patches.take(np.arange(0)), edges[:0], n_classes=3)


@pytest.mark.parametrize(
    "change",
    [{"n_rounds": 0}, {"step": 0.0}, {"truncation": 0.6}, {"class_weight": "cubic"}, {"clique_shares": [0.0]}],
)
def test_bad_parameters_are_named(change):
    ((name, value),) = change.items()
    with pytest.raises(ParameterError, match=f"max_margin_markov.{name}.*{value}"):
        MarginParameters(**change)
