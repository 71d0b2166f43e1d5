"""Network of the superpoint transformer (Robert et al. 2023, section 3.2) in the training; it imports torch.

`inference.TrainedNetwork` computes the same scores without torch.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from mlsroad_pipeline.algorithms.models.superpoint_transformer.inputs import EDGE_FEATURES, Inputs
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import N_LEVELS, NetworkParameters


@dataclass(frozen=True)
class LevelTensors:
    """Tensors of a level."""

    nodes: Tensor  # See `LevelInputs`
    edges: Tensor  # See `LevelInputs`
    target: Tensor  # See `LevelInputs`
    source: Tensor  # See `LevelInputs`
    parent: Tensor  # See `LevelInputs`
    histogram: Tensor  # See `LevelInputs`


@dataclass(frozen=True)
class Tensors:
    """Tensors of a batch."""

    points: Tensor  # See `Inputs`
    owner: Tensor  # See `Inputs`
    levels: tuple[LevelTensors, ...]  # Levels 1, 2 and 3


def to_tensors(inputs: Inputs, device: torch.device) -> Tensors:
    """Move inputs to a device."""
    levels = (
        LevelTensors(**{name: torch.from_numpy(values).to(device) for name, values in vars(level).items()})
        for level in inputs.levels
    )
    points, owner = (torch.from_numpy(values).to(device) for values in (inputs.points, inputs.owner))
    return Tensors(points, owner, tuple(levels))


def segment_softmax(logits: Tensor, target: Tensor, n: int) -> Tensor:
    """Return the softmax over the edges of each target."""
    lengths = torch.bincount(target, minlength=n)
    top = torch.segment_reduce(logits.detach(), "max", lengths=lengths, axis=0, initial=-1e30)
    weights = torch.exp(logits - top.index_select(0, target))
    total = weights.new_zeros(n, logits.shape[1]).index_add(0, target, weights)
    return weights / total.index_select(0, target)


def segment_max(values: Tensor, owner: Tensor, n: int) -> Tensor:
    """Return the maximum of the rows of each owner."""
    order = torch.argsort(owner, stable=True)
    lengths = torch.bincount(owner, minlength=n)
    return torch.segment_reduce(values.index_select(0, order), "max", lengths=lengths, axis=0)


def _mlp(widths: Sequence[int]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(widths):
        layers += [nn.Linear(inputs, outputs), nn.LayerNorm(outputs), nn.LeakyReLU()]
    return nn.Sequential(*layers)


class EdgeAttention(nn.Module):
    """Attention of superpoints to their neighbours; edges change keys, queries and values (equations 4 and 5)."""

    def __init__(self, parameters: NetworkParameters) -> None:
        super().__init__()
        p = parameters
        self.n_heads, self.keys = p.n_heads, p.n_heads * p.key_width
        self.norm = nn.LayerNorm(p.width)
        self.node = nn.Linear(p.width, 2 * self.keys + p.width)
        self.edge = nn.Linear(p.edge_width, 2 * self.keys + p.width, bias=False)
        self.out = nn.Linear(p.width, p.width)

    def forward(self, nodes: Tensor, edges: Tensor, target: Tensor, source: Tensor) -> Tensor:
        """Return the features of the superpoints with what their neighbours add."""
        n, width = nodes.shape
        widths = [self.keys, self.keys, width]
        own = self.node(self.norm(nodes)).split(widths, dim=1)
        changes = self.edge.weight.t().split(widths, dim=1)
        # One pass over the edges: the gathered rows plus the product of edge features and weights.
        query, key, value = (
            torch.addmm(rows.index_select(0, at), edges, change).view(len(edges), self.n_heads, -1)
            for rows, at, change in zip(own, (target, source, source), changes, strict=True)
        )
        logits = (query * key).sum(dim=2) * query.shape[2] ** -0.5
        heard = (segment_softmax(logits, target, n)[:, :, None] * value).reshape(len(edges), width)
        gathered: Tensor = self.out(nodes.new_zeros(n, width).index_add(0, target, heard))
        return nodes + gathered


class Stage(nn.Module):
    """Layers of a level: an MLP on the joined inputs, then attention blocks."""

    def __init__(self, inputs: int, blocks: int, parameters: NetworkParameters) -> None:
        super().__init__()
        p = parameters
        self.enter = _mlp([inputs, p.width])
        self.blocks = nn.ModuleList(EdgeAttention(p) for _ in range(blocks))

    def forward(self, features: Tensor, edges: Tensor, level: LevelTensors) -> Tensor:
        """Return the features of the level's superpoints."""
        nodes: Tensor = self.enter(features)
        for block in self.blocks:
            nodes = block(nodes, edges, level.target, level.source)
        return nodes


class SuperpointTransformer(nn.Module):
    """U-shaped network over the points and three levels of superpoints."""

    def __init__(self, parameters: NetworkParameters, n_inputs: Sequence[int], n_classes: int) -> None:
        super().__init__()
        p = parameters
        self.points = _mlp([n_inputs[0], *p.point_widths])
        self.nodes = nn.ModuleList(_mlp([n, p.width]) for n in n_inputs[1:])
        self.edges = nn.ModuleList(_mlp([EDGE_FEATURES, p.edge_width, p.edge_width]) for _ in range(N_LEVELS))
        below = [p.point_widths[-1], *[p.width] * (N_LEVELS - 1)]
        self.down = nn.ModuleList(Stage(below[i] + p.width, p.blocks_down[i], p) for i in range(N_LEVELS))
        self.up = nn.ModuleList(Stage(2 * p.width, p.blocks_up, p) for _ in range(N_LEVELS - 1))
        self.heads = nn.ModuleList(nn.Linear(p.width, n_classes) for _ in range(N_LEVELS))

    def forward(self, batch: Tensors) -> list[Tensor]:
        """Return the scores of the classes for the superpoints of each level."""
        owner, below = batch.owner, self.points(batch.points)
        edges = [layer(level.edges) for layer, level in zip(self.edges, batch.levels, strict=True)]
        features: list[Tensor] = []
        for i, level in enumerate(batch.levels):
            pooled = segment_max(below, owner, len(level.nodes))
            below = self.down[i](torch.cat([pooled, self.nodes[i](level.nodes)], dim=1), edges[i], level)
            owner = level.parent
            features.append(below)
        for i in reversed(range(N_LEVELS - 1)):
            level = batch.levels[i]
            above = features[i + 1].index_select(0, level.parent)
            features[i] = self.up[i](torch.cat([features[i], above], dim=1), edges[i], level)
        return [head(each) for head, each in zip(self.heads, features, strict=True)]
