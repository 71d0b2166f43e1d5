"""Label transfer, its refinement and the classifiers made of them."""

import itertools

import numpy as np
import pytest
from references.patch_graph import all_costs, field_energy, lowest_energy, optimal_costs, planted_patches

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import (
    PatchGraphClassifier,
    PatchGraphParameters,
    class_probabilities,
    cut_scenes,
    match_patches,
    thin_scenes,
    train_graph,
)
from mlsroad_pipeline.papers.luo2016.patch_graph.costs import CostWeights
from mlsroad_pipeline.papers.luo2016.patch_graph.iterations import SearchParameters
from mlsroad_pipeline.papers.luo2016.patch_graph.refined_classifier import (
    GridParameters,
    RefinedPatchGraphClassifier,
    label_held_out,
    refine_classifier,
)
from mlsroad_pipeline.papers.luo2016.patch_graph.refinement import (
    GroundClasses,
    RefinementParameters,
    ValidationScene,
    choose_parameters,
    edge_weights,
    refine,
)

NO_EDGES = np.empty((0, 2), np.int32)
MOVES_ALONE = SearchParameters(exhaustive_budget=0, n_costly=0, minority_share=0.0)


def split(patches, scene):
    rows = patches.scene == scene
    return patches.take(~rows), patches.take(rows)


@pytest.mark.parametrize("coloured", [True, False])
@pytest.mark.parametrize("search", [SearchParameters(), MOVES_ALONE])
def test_matches_of_new_patches_are_those_of_brute_force(search, coloured):
    everything = planted_patches(1500, 10, coloured=coloured)
    known, new = split(everything, 3)
    graph = train_graph(known)
    found = match_patches(new, graph, search=search)
    costs = all_costs(everything)[np.ix_(everything.scene == 3, everything.scene != 3)]
    best = optimal_costs(costs, new.scene, known.scene, 7)
    assert best.sum() * (1 - 1e-5) <= found.costs.sum() <= best.sum() * (1.00001 if search.exhaustive_budget else 1.1)
    np.testing.assert_allclose(found.costs, costs[np.arange(len(new))[:, None], graph.rows[found.matches]], rtol=1e-4)
    np.testing.assert_array_equal(graph.labels, known.label[graph.rows])
    again = match_patches(new, graph, search=search, n_threads=3)
    assert again.matches.tobytes() == found.matches.tobytes()


@pytest.mark.parametrize("search", [SearchParameters(), MOVES_ALONE])
def test_a_graph_labels_its_own_scenes_by_the_others(search):
    everything = planted_patches(1500, 9, seed=7)
    graph = train_graph(everything)
    rows = np.flatnonzero(everything.scene == 4)
    found = match_patches(everything.take(rows), graph, search=search, own_scene=np.full(len(rows), 4))
    assert (everything.scene[graph.rows[found.matches]] != 4).all()
    best = optimal_costs(all_costs(everything)[rows], everything.scene[rows], everything.scene, 7)
    assert best.sum() * (1 - 1e-5) <= found.costs.sum() <= best.sum() * (1.00001 if search.exhaustive_budget else 1.02)
    with pytest.raises(DataError, match="own_scene"):
        match_patches(everything, graph, own_scene=[1, 2])


def test_a_graph_with_colour_serves_patches_without():
    everything = planted_patches(900, 9)
    known, new = split(everything, 0)
    found = match_patches(new.with_columns(rgb=None), train_graph(known, n_matches=5))
    plain = match_patches(new.with_columns(rgb=None), train_graph(known.with_columns(rgb=None), n_matches=5))
    np.testing.assert_allclose(found.costs, plain.costs, rtol=1e-4)
    back = match_patches(new, train_graph(known.with_columns(rgb=None), n_matches=5))
    np.testing.assert_allclose(back.costs, plain.costs, rtol=1e-4)


def test_votes_weigh_one_over_rank_squared():
    found = class_probabilities([[2, 0, 2], [1, 1, 1]], 4)
    total = 1 + 1 / 4 + 1 / 9
    np.testing.assert_allclose(found, [[0.25 / total, 0, (1 + 1 / 9) / total, 0], [0, 1, 0, 0]])
    with pytest.raises(DataError, match="0..1, got 0..2"):
        class_probabilities([[2, 0, 2]], 2)


def test_classes_of_copies_are_transferred():
    known, new = split(planted_patches(1800, 9, seed=11), 8)
    classifier = PatchGraphClassifier.fit(known, NO_EDGES, 5, parameters=PatchGraphParameters(scene_length=100.0))
    probabilities = classifier.predict_proba(new, NO_EDGES)
    np.testing.assert_allclose(probabilities.sum(axis=1), 1)
    assert probabilities.shape[1] == 5 and (probabilities[:, 4] == 0).all()  # a class that training lacks
    assert (probabilities.argmax(axis=1) == new.label).mean() > 0.8


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("gamma", [0.0, 0.7])
def test_refinement_reaches_the_least_energy_of_small_fields(seed, gamma):
    rng = np.random.default_rng(seed)
    probabilities, rgb = rng.dirichlet(np.full(3, 0.5), 7), rng.random((7, 3)).astype(np.float32)
    edges = np.array([(u, v) for u in range(7) for v in range(u + 1, 7) if rng.random() < 0.4], np.int32)
    parameters = RefinementParameters(0.8, 2.0, gamma, 0.01)
    labels, conditional = refine(
        probabilities, rgb, edges, parameters=parameters, ground=GroundClasses(grass=0, road=1)
    )
    initial = probabilities.argmax(axis=1)

    def energy(y):
        return field_energy(
            y, probabilities, rgb, edges, initial, lam=0.8, beta=2.0, gamma=gamma, floor=0.01, grass=0, road=1
        )

    # An expansion is within a factor of two in theory, and at the optimum in all but contrived fields.
    assert energy(labels) == pytest.approx(lowest_energy(3, 7, energy), rel=0.02)
    for u in range(7):  # no single patch can lower it
        for k in range(3):
            other = labels.copy()
            other[u] = k
            assert energy(other) >= energy(labels) - 1e-9
    np.testing.assert_array_equal(conditional.argmax(axis=1), labels)
    np.testing.assert_allclose(conditional.sum(axis=1), 1)


def test_only_grass_beside_road_and_other_pairs_are_smoothed():
    labels = np.array([0, 1, 2, 2, 0], np.int16)  # grass, road, tree, tree, grass
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [0, 4]], np.int32)
    weights = edge_weights(
        labels, None, edges, parameters=RefinementParameters(), ground=GroundClasses(grass=0, road=1)
    )
    assert weights.tolist() == [1, 0, 1, 0, 0]
    inside = np.append(edges, [[0, 0], [1, 1]], axis=0)  # grass beside grass, road beside road
    for smooth, expected in ((False, [1, 0, 1, 0, 0, 0, 0]), (True, [1, 0, 1, 0, 1, 1, 1])):
        parameters = RefinementParameters(smooth_ground=smooth)
        weights = edge_weights(labels, None, inside, parameters=parameters, ground=GroundClasses(grass=0, road=1))
        assert weights.tolist() == expected
    joint = edge_weights(labels, None, edges, parameters=RefinementParameters(), ground=GroundClasses(0, 0))
    assert joint.tolist() == [0, 1, 1, 0, 1]
    none = edge_weights(labels, None, edges, parameters=RefinementParameters(), ground=GroundClasses())
    assert none.tolist() == [1] * 5


def test_without_smoothness_nothing_changes_and_with_much_of_it_the_majority_wins():
    probabilities = np.full((9, 3), [0.1, 0.2, 0.7])
    probabilities[4] = [0.1, 0.7, 0.2]
    edges = np.array([[4, i] for i in range(9) if i != 4], np.int32)
    for smoothness, label in ((0.0, 1), (1.0, 2)):
        found, _ = refine(probabilities, None, edges, parameters=RefinementParameters(smoothness=smoothness))
        assert found[4] == label and (np.delete(found, 4) == 2).all()


def test_the_grid_search_takes_what_labels_the_scenes_best():
    rng = np.random.default_rng(3)
    truth = np.repeat([0, 1], 50).astype(np.int16)
    edges = np.array([(i, i + 1) for i in range(99)], np.int32)
    noisy = np.where(rng.random(100) < 0.2, 1 - truth, truth)
    scene = ValidationScene(np.where(noisy[:, None] == [0, 1], 0.7, 0.3), None, edges, truth)
    chosen, grid = choose_parameters([scene], smoothness=(0.0, 0.6, 1e4), colour_decay=(0.0, 5.0))
    assert chosen.smoothness == 0.6
    assert [row["smoothness"] for row in grid] == [0.0, 0.6, 1e4]  # without colour beta makes no difference
    assert grid[1]["mean_f1"] > grid[0]["mean_f1"] > grid[2]["mean_f1"]
    with pytest.raises(ParameterError, match="at least one scene"):
        choose_parameters([], smoothness=(1.0,), colour_decay=(1.0,))


def test_the_criterion_weighs_classes_or_patches():
    """Smoothing mends the large class and wears a pair of patches of a small one away."""
    truth = np.zeros(60, np.int16)
    truth[30:32] = 1
    noisy = truth.copy()
    noisy[5:60:8] = 1 - truth[5:60:8]
    scene = ValidationScene(
        np.where(noisy[:, None] == [0, 1], 0.7, 0.3), None, np.array([(i, i + 1) for i in range(59)], np.int32), truth
    )
    lambdas = (0.3, 2.0)
    by_class, grid = choose_parameters([scene], smoothness=lambdas, colour_decay=(0.0,))
    by_patch, same = choose_parameters([scene], smoothness=lambdas, colour_decay=(0.0,), criterion="overall_accuracy")
    assert grid == same
    for row, value in zip(grid, lambdas, strict=True):
        found, _ = refine(scene.probabilities, None, scene.edges, parameters=RefinementParameters(value, 0.0))
        assert row["overall_accuracy"] == pytest.approx((found == truth).mean())
        f1 = [2 * ((found == k) & (truth == k)).sum() / ((found == k).sum() + (truth == k).sum()) for k in (0, 1)]
        assert row["mean_f1"] == pytest.approx(np.mean(f1))
    assert (by_class.smoothness, by_patch.smoothness) == (0.3, 2.0)
    with pytest.raises(ParameterError, match=r"criterion .*got 'kappa'"):
        choose_parameters([scene], smoothness=(1.0,), colour_decay=(0.0,), criterion="kappa")


def held_out(patches, surveys, n_folds, **options):
    parameters = PatchGraphParameters(scene_length=100.0, n_matches=4, **options)
    transfer = PatchGraphClassifier.fit(patches, NO_EDGES, 4, parameters=parameters)
    edges = np.array([(i, i + 1) for i in range(len(patches) - 1)], np.int32)
    return label_held_out(
        transfer, patches, edges, parameters=parameters, max_patches=10**6, surveys=surveys, n_folds=n_folds
    ), parameters


def test_whole_surveys_are_held_out():
    patches = planted_patches(1200, 12, seed=4)
    surveys = np.repeat([0, 1], 6).astype(np.int32)
    scenes, parameters = held_out(patches, surveys, 3)
    in_survey = surveys[patches.scene]
    for survey in (0, 1):
        others = PatchGraphClassifier.fit(patches.take(in_survey != survey), NO_EDGES, 4, parameters=parameters)
        for scene in np.flatnonzero(surveys == survey):
            rows = patches.take(patches.scene == scene)
            assert scenes[scene].probabilities.tobytes() == others.predict_proba(rows, NO_EDGES).tobytes()
            np.testing.assert_array_equal(scenes[scene].labels, rows.label)
    own, _ = held_out(patches, surveys, 0)
    whole, _ = held_out(patches, None, 3)
    assert [s.probabilities.tobytes() for s in own] == [s.probabilities.tobytes() for s in whole]
    assert any((a.probabilities != b.probabilities).any() for a, b in zip(own, scenes, strict=True))
    for found, scene in zip(scenes, range(12), strict=True):  # neighbours in the scene, as places in it
        rows = np.flatnonzero(patches.scene == scene)
        both = np.isin(rows + 1, rows)
        assert found.edges.tolist() == [[i, int(np.searchsorted(rows, rows[i] + 1))] for i in np.flatnonzero(both)]


def test_scenes_are_held_out_if_too_few_surveys_remain(caplog):
    patches = planted_patches(600, 6, seed=4)
    surveys = np.array([0, 0, 0, 1, 1, 1], np.int32)
    scenes, _ = held_out(patches, surveys, 2)
    assert "without the surveys of a fold 3 training scenes are left, and 4 matches need 5" in caplog.text
    whole, _ = held_out(patches, None, 2)
    assert [s.probabilities.tobytes() for s in scenes] == [s.probabilities.tobytes() for s in whole]


def test_models_survive_as_arrays():
    known, new = split(planted_patches(900, 10, seed=5), 9)
    edges = np.array([(i, i + 1) for i in range(len(known) - 1) if known.scene[i] == known.scene[i + 1]], np.int32)
    parameters = PatchGraphParameters(scene_length=100.0, n_matches=5)
    transfer = PatchGraphClassifier.fit(known, edges, 4, parameters=parameters, n_threads=2)
    refined, tried = refine_classifier(
        transfer,
        known,
        edges,
        graph_parameters=parameters,
        grid=GridParameters((0.1, 0.5), (0.0,)),
        ground=GroundClasses(),
    )
    assert len(tried) == 2
    pairs = np.array([(i, i + 1) for i in range(len(new) - 1)], np.int32)
    for model in (transfer, refined):
        arrays = model.to_arrays()
        assert not any(np.asarray(values).dtype.hasobject for values in arrays.values())
        again = type(model).from_arrays(arrays)
        assert again.predict_proba(new, pairs).tobytes() == model.predict_proba(new, pairs).tobytes()
        with pytest.raises(DataError, match="lack .*labels"):
            type(model).from_arrays({name: values for name, values in arrays.items() if name != "labels"})
    with pytest.raises(DataError, match="lack refinement, ground"):
        RefinedPatchGraphClassifier.from_arrays(transfer.to_arrays())


def test_scenes_are_cut_along_their_main_axis():
    rng = np.random.default_rng(0)
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    local = rng.random((600, 3)) * [31.0, 8.0, 4.0]
    patches = planted_patches(600, 1).with_columns(centroid=local @ turn.T + [500_000.0, 5_800_000.0, 0])
    pieces = cut_scenes(patches, 10.0).scene
    assert set(pieces.tolist()) == {0, 1, 2}
    ends = sorted((local[pieces == s, 0].min(), local[pieces == s, 0].max()) for s in range(3))
    assert all(a[1] < b[0] + 1.0 for a, b in itertools.pairwise(ends))
    assert all(high - low < 12 for low, high in ends)


def test_scenes_of_a_street_wider_than_long_are_cut_by_station_along_the_road():
    rng = np.random.default_rng(0)
    local = rng.random((4000, 3)) * [20.0, 42.0, 4.0]  # 20 m along the road, 42 m across
    patches = planted_patches(4000, 2).with_columns(centroid=local, station=local[:, 0] + 1000.0)
    cut = cut_scenes(patches, 10.0)
    assert np.bincount(cut.scene).min() > 900 and cut.scene.max() == 3
    for scene in range(4):
        along, across = local[cut.scene == scene, 0], local[cut.scene == scene, 1]
        assert np.ptp(along) <= 10.0 and np.ptp(across) > 41.0
        assert along.max() <= 10.01 if scene % 2 == 0 else along.min() >= 9.99
    without = cut_scenes(patches.with_columns(station=None), 10.0).scene
    assert without.max() == 7  # the main axis of these patches lies across the road


def test_thinning_keeps_shares_and_edges():
    patches = planted_patches(2000, 2, seed=9)
    edges = np.array([(i, i + 1) for i in range(1999)], np.int32)
    thin, pairs = thin_scenes(patches, edges, n_patches=200, seed=1)
    assert np.bincount(thin.scene).tolist() == [200, 200]
    shares = np.bincount(thin.label) / np.bincount(patches.label)
    assert np.ptp(shares) < 0.02
    assert len(pairs) and np.isin(thin.centroid, patches.centroid).all()
    place = {tuple(c): i for i, c in enumerate(patches.centroid.tolist())}
    assert all(place[tuple(thin.centroid[b])] - place[tuple(thin.centroid[a])] == 1 for a, b in pairs)
    same, all_edges = thin_scenes(patches, edges, n_patches=1000, seed=1)
    assert same is patches and all_edges is edges


def test_bad_input_is_named():
    known = planted_patches(90, 9)
    with pytest.raises(DataError, match="1 of 90 training patches have no label"):
        train_graph(known.with_columns(label=np.where(np.arange(90) == 4, -1, known.label)))
    graph = train_graph(known)
    with pytest.raises(DataError, match="histograms of 16 bins, got 12"):
        match_patches(planted_patches(5, 1, n_bins=12), graph)
    with pytest.raises(DataError, match="class 3, but the scheme has 2"):
        PatchGraphClassifier.fit(known, NO_EDGES, 2)
    with pytest.raises(DataError, match="at least 8 scenes"):
        PatchGraphClassifier.fit(planted_patches(40, 1), NO_EDGES, 4)
    assert match_patches(known.take(np.arange(0)), graph).matches.shape == (0, 7)
    assert match_patches(planted_patches(1, 1), graph).matches.shape == (1, 7)


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        (PatchGraphParameters, {"n_matches": 0}, "n_matches must be at least 1, got 0"),
        (PatchGraphParameters, {"scene_length": 0}, "scene_length must be"),
        (PatchGraphParameters, {"search": {"radius": 1}}, "search has no parameter radius"),
        (GridParameters, {"smoothness": []}, "at least one value"),
        (GridParameters, {"colour_decay": [-1.0]}, "colour_decay must be a finite number >= 0, got -1.0"),
        (GridParameters, {"max_patches": 0}, "max_patches must be at least 1, got 0"),
        (GridParameters, {"criterion": "kappa"}, "criterion must be one of .* got 'kappa'"),
        (GridParameters, {"n_folds": 1}, "n_folds must be 0 or at least 2, got 1"),
        (RefinementParameters, {"floor": 0}, r"floor must be in \(0, 1\), got 0"),
    ],
)
def test_bad_parameters_are_named(kind, options, message):
    with pytest.raises(ParameterError, match=message):
        kind(**options)


def test_configuration_gives_mappings():
    found = PatchGraphParameters(weights={"colour": 0.5}, search={"n_costly": 3})
    assert found.weights == CostWeights(colour=0.5) and found.search == SearchParameters(n_costly=3)
