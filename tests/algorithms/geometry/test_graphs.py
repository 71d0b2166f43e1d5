"""Graphs: components and adjacency against SciPy and by hand."""

import numpy as np
import pytest
from references.inventory import renumber_by_first
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components as scipy_components

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.geometry.graphs import connected_components


@pytest.mark.parametrize("n_edges", [0, 30, 80, 300])
def test_components_equal_scipy(rng, n_edges):
    edges = rng.integers(0, 100, (n_edges, 2))
    graph = coo_array((np.ones(n_edges), (edges[:, 0], edges[:, 1])), shape=(100, 100))
    expected = renumber_by_first(scipy_components(graph, directed=False)[1])
    labels = connected_components(edges, n_nodes=100)
    assert labels.dtype == np.int32
    np.testing.assert_array_equal(labels, expected)
    np.testing.assert_array_equal(connected_components(edges[::-1, ::-1], n_nodes=100), expected)


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        ([[0, 7]], "node 7, but there are 3"),
        ([[-1, 0]], "node -1"),
        ([[0.5, 1.0]], "must be integers"),
        ([0, 1, 2], r"shape \(e, 2\)"),
    ],
)
def test_bad_edges_are_named(edges, message):
    with pytest.raises(DataError, match=message):
        connected_components(edges, n_nodes=3)


def test_no_nodes():
    assert connected_components([], n_nodes=0).shape == (0,)
