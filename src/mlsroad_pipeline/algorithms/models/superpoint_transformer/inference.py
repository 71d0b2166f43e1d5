"""Forward pass of a trained network in NumPy and Numba; labelling does not import PyTorch.

Linear layers are products of blocks of rows that stay in the cache of the processor. The attention computes the edges
of a few targets at a time: no array has a row of queries, keys and values for every edge of a level.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.models.superpoint_transformer.inputs import Inputs, LevelInputs
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import N_LEVELS, NetworkParameters
from mlsroad_pipeline.algorithms.models.superpoint_transformer.weights import (
    Attention,
    Layer,
    Weights,
    attention_of,
    check_weights,
    layers_of,
    weight_shapes,
)

_FAST = {"reassoc", "contract", "arcp", "nsz"}
_EPSILON = np.float32(1e-5)
_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)
_LOWEST = np.float32(-1e30)


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def normalise(rows: NDArray, bias: NDArray, gain: NDArray, shift: NDArray, slope: np.float32) -> None:
    """Add the bias to rows and replace them by their layer normalisation; negative values are multiplied by `slope`."""
    width = rows.shape[1]
    share = _ONE / np.float32(width)
    for i in range(rows.shape[0]):
        total = _ZERO
        for j in range(width):
            rows[i, j] += bias[j]
            total += rows[i, j]
        mean = total * share
        squared = _ZERO
        for j in range(width):
            centred = rows[i, j] - mean
            squared += centred * centred
        factor = _ONE / np.sqrt(squared * share + _EPSILON)
        for j in range(width):
            value = (rows[i, j] - mean) * factor * gain[j] + shift[j]
            rows[i, j] = value if value > _ZERO else slope * value


@njit(cache=True, nogil=True)
def raise_to_rows(rows: NDArray, owner: NDArray, out: NDArray) -> None:
    """Raise the row of `out` of each owner to the maximum of itself and the owner's rows."""
    for i in range(rows.shape[0]):
        group = owner[i]
        for j in range(rows.shape[1]):
            out[group, j] = rows[i, j] if rows[i, j] > out[group, j] else out[group, j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def write_logits(
    own: NDArray,
    changes: NDArray,
    source: NDArray,
    indptr: NDArray,
    targets: tuple[int, int],
    keys: tuple[int, ...],
    out: NDArray,
) -> None:
    """Write the logits of the edges of a range of targets, less the largest of each target and head.

    `own`, shape (n, components, heads), has queries, keys and values of the superpoints, `changes` those of the edges
    of these targets.
    """
    n_heads, start = out.shape[1], indptr[targets[0]]
    top = np.empty(n_heads, np.float32)
    for t in range(targets[0], targets[1]):
        top[:] = _LOWEST
        for i in range(indptr[t] - start, indptr[t + 1] - start):
            s = source[start + i]
            for h in range(n_heads):
                logit = _ZERO
                for c in range(len(keys)):
                    query = own[t, c, h] + changes[i, c, h]
                    logit += query * (own[s, len(keys) + c, h] + changes[i, len(keys) + c, h])
                out[i, h] = logit
            for h in range(n_heads):
                top[h] = out[i, h] if out[i, h] > top[h] else top[h]
        for i in range(indptr[t] - start, indptr[t + 1] - start):
            for h in range(n_heads):
                out[i, h] -= top[h]


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def write_means(
    own: NDArray,
    changes: NDArray,
    source: NDArray,
    indptr: NDArray,
    targets: tuple[int, int],
    keys: tuple[int, ...],
    values: tuple[int, ...],
    weights: NDArray,
    out: NDArray,
) -> None:
    """Write the weighted means of the values of the edges of a range of targets; see `write_logits`.

    `values` has an entry per component of a value. Targets without edges get 0.
    """
    n_heads, start = out.shape[2], indptr[targets[0]]
    total = np.empty(n_heads, np.float32)
    for t in range(targets[0], targets[1]):
        total[:] = _ZERO
        out[t] = _ZERO
        for i in range(indptr[t] - start, indptr[t + 1] - start):
            s = source[start + i]
            for h in range(n_heads):
                total[h] += weights[i, h]
            for c in range(len(values)):
                for h in range(n_heads):
                    out[t, c, h] += weights[i, h] * (own[s, 2 * len(keys) + c, h] + changes[i, 2 * len(keys) + c, h])
        if indptr[t + 1] > indptr[t]:
            for c in range(len(values)):
                for h in range(n_heads):
                    out[t, c, h] /= total[h]


_ROWS = 512
"""Rows of a block: its features of 64 columns take 128 kB."""

_SLOPE = np.float32(0.01)
_NO_ACTIVATION = np.float32(1.0)

Rows = NDArray[np.float32]


@dataclass(frozen=True)
class _Stage:
    """Layers of a level: an MLP on the joined inputs, then attention blocks."""

    enter: list[Layer]
    blocks: list[Attention]


class TrainedNetwork:
    """Network over the points and three levels of superpoints, for use alone."""

    def __init__(
        self, arrays: Mapping[str, NDArray], parameters: NetworkParameters, n_inputs: Sequence[int], n_classes: int
    ) -> None:
        p = parameters
        weights = check_weights(arrays, weight_shapes(p, n_inputs, n_classes), n_classes)
        self._n_heads, self._keys, self._values = p.n_heads, (0,) * p.key_width, (0,) * (p.width // p.n_heads)
        self._points = layers_of(weights, "points")
        self._nodes = [layers_of(weights, f"nodes.{i}") for i in range(N_LEVELS)]
        self._edges = [layers_of(weights, f"edges.{i}") for i in range(N_LEVELS)]
        self._down = [_stage(weights, f"down.{i}", p.blocks_down[i], p) for i in range(N_LEVELS)]
        self._up = [_stage(weights, f"up.{i}", p.blocks_up, p) for i in range(N_LEVELS - 1)]
        self._head = np.ascontiguousarray(weights["heads.0.weight"].T), weights["heads.0.bias"]

    def scores(self, inputs: Inputs) -> Rows:
        """Return the scores of the classes for the superpoints of level 1."""
        levels = inputs.levels
        edges = [_through(layers, level.edges) for layers, level in zip(self._edges, levels, strict=True)]
        pooled = self._pooled_points(inputs)
        features: list[Rows] = []
        for i, level in enumerate(levels):
            if i:
                pooled = np.full((len(level.nodes), features[-1].shape[1]), -np.inf, np.float32)
                raise_to_rows(features[-1], levels[i - 1].parent, pooled)
            joined = np.hstack([pooled, _through(self._nodes[i], level.nodes)])
            features.append(self._staged(self._down[i], joined, edges[i], level))
        above = features[-1]
        for i in reversed(range(N_LEVELS - 1)):
            joined = np.hstack([features[i], above[levels[i].parent]])
            above = self._staged(self._up[i], joined, edges[i], levels[i])
        return above @ self._head[0] + self._head[1]

    def _pooled_points(self, inputs: Inputs) -> Rows:
        """Return the maxima of the features of the points of each superpoint of level 1."""
        width = self._points[-1].linear.shape[1]
        pooled = np.full((len(inputs.levels[0].nodes), width), -np.inf, np.float32)
        for block in _blocks(len(inputs.points)):
            raise_to_rows(_through_block(self._points, inputs.points[block]), inputs.owner[block], pooled)
        return pooled

    def _staged(self, stage: _Stage, features: Rows, edges: Rows, level: LevelInputs) -> Rows:
        nodes = _through(stage.enter, features)
        indptr = np.searchsorted(level.target, np.arange(len(nodes) + 1))
        for block in stage.blocks:
            nodes = self._attended(block, nodes, edges, level.source, indptr)
        return nodes

    def _attended(
        self, block: Attention, nodes: Rows, edges: Rows, source: NDArray[np.int64], indptr: NDArray[np.int64]
    ) -> Rows:
        """Return the features of the superpoints plus what their neighbours add (equations 4 and 5)."""
        n, width = nodes.shape
        own = _projected(block, nodes).reshape(n, -1, self._n_heads)
        means = np.empty((n, width // self._n_heads, self._n_heads), np.float32)
        blocks = list(_target_blocks(indptr))
        n_edges = max((int(indptr[last] - indptr[first]) for first, last in blocks), default=0)
        changes, logits = (
            np.empty((n_edges, block.edge.shape[1]), np.float32),
            np.empty((n_edges, self._n_heads), np.float32),
        )
        for targets in blocks:
            rows = edges[indptr[targets[0]] : indptr[targets[1]]]
            change = np.matmul(rows, block.edge, out=changes[: len(rows)]).reshape(len(rows), -1, self._n_heads)
            weights = logits[: len(rows)]
            write_logits(own, change, source, indptr, targets, self._keys, weights)
            np.exp(weights, out=weights)
            write_means(own, change, source, indptr, targets, self._keys, self._values, weights, means)
        out = np.empty((n, width), np.float32)
        for part in _blocks(n):
            np.matmul(means[part].reshape(-1, width), block.out, out=out[part])
            out[part] += block.out_bias
            out[part] += nodes[part]
        return out


def _stage(weights: Weights, name: str, n_blocks: int, parameters: NetworkParameters) -> _Stage:
    blocks = [attention_of(weights, f"{name}.blocks.{i}", parameters) for i in range(n_blocks)]
    return _Stage(layers_of(weights, f"{name}.enter"), blocks)


def _projected(block: Attention, nodes: Rows) -> Rows:
    """Return queries, keys and values of the superpoints."""
    own, none = np.empty((len(nodes), block.node.shape[1]), np.float32), np.zeros(nodes.shape[1], np.float32)
    for rows in _blocks(len(nodes)):
        normal = nodes[rows].copy()
        normalise(normal, none, block.gain, block.shift, _NO_ACTIVATION)
        np.matmul(normal, block.node, out=own[rows])
        own[rows] += block.bias
    return own


def _blocks(n: int) -> Iterator[slice]:
    for first in range(0, n, _ROWS):
        yield slice(first, min(first + _ROWS, n))


def _target_blocks(indptr: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    """Return ranges of targets with at most `_ROWS` edges together, or of one target."""
    first, n = 0, len(indptr) - 1
    while first < n:
        last = int(np.searchsorted(indptr, indptr[first] + _ROWS, side="right")) - 1
        last = min(max(last, first + 1), n)
        yield first, last
        first = last


def _through_block(layers: Sequence[Layer], rows: Rows) -> Rows:
    """Return the features of a few rows behind the layers of an MLP."""
    for layer in layers:
        rows = rows @ layer.linear
        normalise(rows, layer.bias, layer.gain, layer.shift, _SLOPE)
    return rows


def _through(layers: Sequence[Layer], rows: Rows) -> Rows:
    """Return the features of rows behind the layers of an MLP."""
    out = np.empty((len(rows), layers[-1].linear.shape[1]), np.float32)
    for block in _blocks(len(rows)):
        out[block] = _through_block(layers, rows[block])
    return out
