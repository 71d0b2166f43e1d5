"""Cliques of separate objects in the refinement: components, exact minima, models of before."""

import itertools

import numpy as np
import pytest
from references.patch_graph import planted_patches
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.geometry.graphs import connected_components
from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import PatchGraphClassifier, PatchGraphParameters
from mlsroad_pipeline.papers.luo2016.patch_graph.refined_classifier import GridParameters, RefinedPatchGraphClassifier
from mlsroad_pipeline.papers.luo2016.patch_graph.refinement import (
    GroundClasses,
    RefinementParameters,
    edge_weights,
    object_cliques,
    refine,
    separate_masts,
)

GROUND = GroundClasses(grass=0, road=1)
NO_EDGES = np.empty((0, 2), np.int32)


def components(nodes, edges):
    """Return the connected components by flooding."""
    left, found = set(nodes), []
    while left:
        reached, last = set(), {left.pop()}
        while last:
            reached |= last
            pairs = [*edges, *((b, a) for a, b in edges)]
            last = {b for a, b in pairs if a in last and b in left}
            left -= last
        found.append(sorted(reached))
    return found


def test_cliques_are_the_components_of_patches_off_the_ground(rng):
    labels = rng.integers(0, 4, 400)
    pairs = {tuple(sorted(pair)) for pair in rng.integers(0, 400, (420, 2)).tolist() if pair[0] != pair[1]}
    edges = np.array(sorted(pairs), np.int32)
    cliques = object_cliques(labels, edges, 4, ground=GROUND, weight=0.5, truncation=0.3)
    off = [i for i in range(400) if labels[i] > 1]
    expected = components(off, [(a, b) for a, b in edges.tolist() if labels[a] > 1 and labels[b] > 1])
    expected = sorted(members for members in expected if len(members) >= 4)
    found = [sorted(part.tolist()) for part in np.split(cliques.members, cliques.indptr[1:-1])]
    assert sorted(found) == expected and len(expected) > 1
    sizes = np.diff(cliques.indptr)
    np.testing.assert_allclose(cliques.maximum, 0.5 * sizes)
    np.testing.assert_allclose(cliques.truncation, 0.3 * sizes)
    none = object_cliques(np.zeros(5, int), NO_EDGES, 4, ground=GROUND, weight=0.5, truncation=0.3)
    assert len(none) == 0


def total_energy(labels, unary, edges, weights, groups, parameters):
    """Return equation 9 with the robust P^n Potts cost of each group."""
    energy = unary[np.arange(len(labels)), labels].sum()
    energy += weights[labels[edges[:, 0]] != labels[edges[:, 1]]].sum()
    for members in groups:
        deviating = len(members) - np.bincount(labels[members]).max()
        share = min(deviating / (parameters.clique_truncation * len(members)), 1.0)
        energy += parameters.clique_weight * len(members) * share
    return energy


@pytest.mark.parametrize("weight", [0.4, 3.0])
def test_a_pole_beside_a_tree_keeps_one_label_and_the_energy_is_the_lowest(weight):
    # Patches 0 to 5 are a pole, some of which look like a tree (class 2 instead of 3); 6 to 9 are ground.
    votes = np.full((10, 4), 0.02)
    votes[[0, 1, 3, 5], 3], votes[[2, 4], 2] = 0.9, 0.6
    votes[[2, 4], 3] = 0.3
    votes[6:, 1] = 0.9
    votes /= votes.sum(axis=1, keepdims=True)
    edges = np.array([[i, i + 1] for i in range(9)], np.int32)
    parameters = RefinementParameters(0.05, 0.0, clique_weight=weight, clique_truncation=0.5)
    labels, conditional = refine(votes, None, edges, parameters=parameters, ground=GROUND)
    assert labels.tolist() == [3] * 6 + [1] * 4
    assert (conditional.argmax(axis=1) == labels).all()
    np.testing.assert_allclose(conditional.sum(axis=1), 1.0)
    without, _ = refine(votes, None, edges, parameters=RefinementParameters(0.05, 0.0), ground=GROUND)
    assert without.tolist()[:6] == [3, 3, 2, 3, 2, 3]
    initial = votes.argmax(axis=1)
    unary = 1.0 - np.log(np.maximum(votes, parameters.floor))
    weights = 0.05 * edge_weights(initial, None, edges, parameters=parameters, ground=GROUND)
    every = (np.array([*given, 1, 1, 1, 1]) for given in itertools.product(range(4), repeat=6))
    lowest = min(total_energy(y, unary, edges, weights, [np.arange(6)], parameters) for y in every)
    assert total_energy(labels, unary, edges, weights, [np.arange(6)], parameters) == pytest.approx(lowest)


def test_models_without_cliques_still_load_and_wrong_weights_are_named():
    known = planted_patches(300, 6, seed=5)
    parameters = PatchGraphParameters(scene_length=100.0, n_matches=3)
    transfer = PatchGraphClassifier.fit(known, NO_EDGES, 4, parameters=parameters)
    field = RefinementParameters(0.3, 0.0, smooth_ground=True)
    arrays = RefinedPatchGraphClassifier(transfer, parameters=field, ground=GROUND).to_arrays()
    earlier = {**arrays, "refinement": arrays["refinement"][:5]}
    assert RefinedPatchGraphClassifier.from_arrays(earlier).parameters == field
    assert RefinedPatchGraphClassifier.from_arrays(arrays).parameters == field
    with pytest.raises(ParameterError, match=r"clique_truncation .*got 0.6"):
        GridParameters(clique_weight=(0.5,), clique_truncation=0.6)
    with pytest.raises(ParameterError, match="clique_weight must list at least one value"):
        GridParameters(clique_weight=())


def lamp_in_a_tree():
    """Return positions, edges and true classes (3 lamp, 2 tree) of a mast that stands 1.5 m from a trunk, in its crown."""
    z = np.arange(0.1, 8.0, 0.2)
    mast = np.column_stack([np.zeros((len(z), 2)), z])
    trunk = mast[z < 4] + [1.5, 0, 0]
    x, y, z = (
        axis.ravel() for axis in np.meshgrid(np.arange(-1, 4, 0.25), np.arange(-1, 1, 0.25), np.arange(3, 6, 0.25))
    )
    crown = np.column_stack([x, y, z])[np.hypot(x, y) > 0.1]
    positions = np.concatenate([mast, trunk, crown])
    classes = np.repeat([3, 2, 2], [len(mast), len(trunk), len(crown)])
    pairs = cKDTree(positions).query_pairs(0.26, output_type="ndarray").astype(np.int32)
    return positions, pairs, classes


def test_a_lamp_in_a_tree_is_kept_if_its_mast_has_a_clique_of_its_own():
    positions, edges, classes = lamp_in_a_tree()
    votes = np.full((len(classes), 4), 0.02)
    votes[np.arange(len(classes)), classes] = 0.9
    mast = np.flatnonzero(classes == 3)
    votes[mast], votes[mast[::5]] = [0.05, 0.05, 0.2, 0.7], [0.05, 0.05, 0.8, 0.1]  # a fifth looks like a tree
    votes /= votes.sum(axis=1, keepdims=True)
    whole = RefinementParameters(0.1, 0.0, clique_weight=1.0)
    lost, _ = refine(votes, None, edges, parameters=whole, ground=GROUND, positions=positions)
    assert (lost[mast] == 2).mean() > 0.9
    divided = RefinementParameters(0.1, 0.0, clique_weight=1.0, mast_radius=0.2)
    kept, _ = refine(votes, None, edges, parameters=divided, ground=GROUND, positions=positions)
    assert (kept[mast] == 3).mean() > 0.9 and (kept[classes == 2] == 2).all()
    with pytest.raises(ParameterError, match="mast_radius needs the positions"):
        refine(votes, None, edges, parameters=divided, ground=GROUND)


def test_columns_around_masts_leave_a_lamp_that_stands_alone_whole():
    positions, edges, classes = lamp_in_a_tree()
    lamp = classes == 3
    alone = np.flatnonzero(lamp)
    arm = positions[alone[-1]] + np.column_stack([np.arange(0.2, 2.0, 0.2), np.zeros(9), np.zeros(9)])
    places = np.concatenate([positions[alone], arm])
    pairs = cKDTree(places).query_pairs(0.26, output_type="ndarray").astype(np.int32)
    every = np.ones(len(places), np.bool_)
    component = connected_components(pairs, n_nodes=len(places))
    assert len(np.unique(component)) == 1
    assert (separate_masts(component, places, pairs, every, radius=0.3) == component).all()
    # In the tree the column is the mast and what the crown has within the radius, and nothing else.
    every = np.ones(len(positions), np.bool_)
    component = connected_components(edges, n_nodes=len(positions))
    divided = separate_masts(component, positions, edges, every, radius=0.3)
    column = np.hypot(positions[:, 0], positions[:, 1]) <= 0.3
    assert len(np.unique(divided[column])) == 1 and not np.isin(divided[~column], divided[column]).any()
