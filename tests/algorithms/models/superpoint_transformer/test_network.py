"""Attention against a dense oracle, pooling, and the loss against its formula."""

import numpy as np
import pytest
import torch

from mlsroad_pipeline.algorithms.models.superpoint_transformer.network import (
    EdgeAttention,
    segment_max,
    segment_softmax,
)
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import NetworkParameters
from mlsroad_pipeline.algorithms.models.superpoint_transformer.training import sum_losses

SMALL = NetworkParameters(width=8, n_heads=2, key_width=3, edge_width=5)


def random_graph(n, share, seed=0):
    """Return targets and sources of random edges, sorted by target, with a loop for each node."""
    drawn = torch.rand(n, n, generator=torch.Generator().manual_seed(seed)) < share
    target, source = torch.nonzero(drawn | torch.eye(n, dtype=torch.bool), as_tuple=True)
    return target, source


def dense_attention(block, nodes, edges, target, source):
    """Return the same as the block, node by node and head by head."""
    keys, heads = block.keys, block.n_heads
    own, change = block.node(block.norm(nodes)), block.edge(edges)
    rows = []
    for i in range(len(nodes)):
        at = torch.nonzero(target == i).flatten()
        query = own[i, :keys] + change[at, :keys]
        key = own[source[at], keys : 2 * keys] + change[at, keys : 2 * keys]
        value = own[source[at], 2 * keys :] + change[at, 2 * keys :]
        parts = []
        for h in range(heads):
            q, k, v = (x.chunk(heads, dim=1)[h] for x in (query, key, value))
            weight = torch.softmax((q * k).sum(dim=1) / np.sqrt(q.shape[1]), dim=0)
            parts.append(weight @ v)
        rows.append(torch.cat(parts))
    return nodes + block.out(torch.stack(rows))


def test_attention_and_its_gradients_are_those_of_dense_attention():
    torch.manual_seed(1)
    block, (target, source) = EdgeAttention(SMALL).double(), random_graph(7, 0.4)
    nodes = torch.randn(7, 8, dtype=torch.float64, requires_grad=True)
    edges = torch.randn(len(target), 5, dtype=torch.float64, requires_grad=True)
    weights = torch.randn(7, 8, dtype=torch.float64)
    gradients = []
    for attend in (block, lambda *args: dense_attention(block, *args)):
        out = attend(nodes, edges, target, source)
        found = torch.autograd.grad((out * weights).sum(), [nodes, edges, *block.parameters()])
        gradients.append([out, *found])
    for fast, slow in zip(*gradients, strict=True):
        assert torch.allclose(fast, slow, atol=1e-10)


def test_attention_follows_a_permutation_of_the_nodes():
    torch.manual_seed(2)
    block, (target, source) = EdgeAttention(SMALL), random_graph(9, 0.3)
    nodes, edges = torch.randn(9, 8), torch.randn(len(target), 5)
    order = torch.randperm(9)
    place = torch.argsort(order)
    moved_target, moved_source = place[target], place[source]
    row = torch.argsort(moved_target, stable=True)
    moved = block(nodes[order], edges[row], moved_target[row], moved_source[row])
    assert torch.allclose(moved, block(nodes, edges, target, source)[order], atol=1e-6)


def test_softmax_of_segments_holds_for_large_logits_and_targets_without_edges():
    logits = torch.tensor([[500.0], [500.0], [-500.0], [3.0]])
    weights = segment_softmax(logits, torch.tensor([0, 0, 0, 2]), 3)
    assert weights.flatten().tolist() == [0.5, 0.5, 0.0, 1.0]


def test_maximum_of_segments_in_any_order():
    values, owner = torch.tensor([[1.0, 9.0], [5.0, 2.0], [4.0, 4.0]]), torch.tensor([1, 0, 1])
    assert segment_max(values, owner, 2).tolist() == [[5.0, 2.0], [4.0, 9.0]]


def test_loss_is_the_weighted_cross_entropy_with_the_histograms():
    scores = torch.log(torch.tensor([[0.5, 0.5], [0.8, 0.2], [0.1, 0.9]]))
    histogram = torch.tensor([[3.0, 1.0], [2.0, 0.0], [0.0, 0.0]])
    weights = torch.tensor([1.0, 2.0])
    first = sum_losses([scores], [histogram], weights, [1.0])
    targets = np.array([[0.75, 0.5], [1.0, 0.0]])
    entropies = -(targets * np.log([[0.5, 0.5], [0.8, 0.2]])).sum()
    assert float(first) == pytest.approx(entropies / targets.sum())
    both = sum_losses([scores, scores], [histogram, histogram], weights, [1.0, 0.5])
    second = -(targets * [[2.0], [np.sqrt(2)]] * np.log([[0.5, 0.5], [0.8, 0.2]])).sum()
    second /= (targets * [[2.0], [np.sqrt(2)]]).sum()
    assert float(both) == pytest.approx(float(first) + 0.5 * second)
    assert float(sum_losses([scores], [0 * histogram], weights, [1.0])) == 0.0
