"""Weights of a trained network as arrays: their names, shapes and layout in use, without PyTorch."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inputs import EDGE_FEATURES
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import N_LEVELS, SLUG, NetworkParameters

Weights = Mapping[str, NDArray[np.float32]]

_NAMED = 5
"""Most weights that an error names."""


@dataclass(frozen=True)
class Layer:
    """Linear layer with layer normalisation and leaky ReLU."""

    linear: NDArray[np.float32]  # Weights, transposed
    # bias, gain, shift: bias of the linear layer; gain and shift of the normalisation
    bias: NDArray[np.float32]
    gain: NDArray[np.float32]
    shift: NDArray[np.float32]


@dataclass(frozen=True)
class Attention:
    """Attention block. Columns of queries, keys and values are sorted by component, then by head."""

    # gain, shift: gain and shift of the normalisation before the block
    gain: NDArray[np.float32]
    shift: NDArray[np.float32]
    # Weights of queries, keys and values of the superpoints; those of queries include the scale of the logits
    node: NDArray[np.float32]
    bias: NDArray[np.float32]  # Their bias
    edge: NDArray[np.float32]  # Weights of the changes of queries, keys and values by the edges
    out: NDArray[np.float32]  # Weights of the last layer
    out_bias: NDArray[np.float32]  # Its bias


def weight_shapes(parameters: NetworkParameters, n_inputs: Sequence[int], n_classes: int) -> dict[str, tuple[int, ...]]:
    """Return the names and shapes of the weights of a network."""
    p = parameters
    shapes = _mlp_shapes("points", [n_inputs[0], *p.point_widths])
    below = [p.point_widths[-1], *[p.width] * (N_LEVELS - 1)]
    stages = {f"down.{i}": (below[i] + p.width, p.blocks_down[i]) for i in range(N_LEVELS)}
    stages |= {f"up.{i}": (2 * p.width, p.blocks_up) for i in range(N_LEVELS - 1)}
    for i in range(N_LEVELS):
        shapes |= _mlp_shapes(f"nodes.{i}", [n_inputs[i + 1], p.width])
        shapes |= _mlp_shapes(f"edges.{i}", [EDGE_FEATURES, p.edge_width, p.edge_width])
        shapes |= {f"heads.{i}.weight": (n_classes, p.width), f"heads.{i}.bias": (n_classes,)}
    for stage, (width, n_blocks) in stages.items():
        shapes |= _mlp_shapes(f"{stage}.enter", [width, p.width])
        for i in range(n_blocks):
            shapes |= _attention_shapes(f"{stage}.blocks.{i}", p)
    return shapes


def _mlp_shapes(name: str, widths: Sequence[int]) -> dict[str, tuple[int, ...]]:
    shapes: dict[str, tuple[int, ...]] = {}
    for i, (inputs, outputs) in enumerate(pairwise(widths)):
        shapes[f"{name}.{3 * i}.weight"] = (outputs, inputs)
        for vector in (f"{3 * i}.bias", f"{3 * i + 1}.weight", f"{3 * i + 1}.bias"):
            shapes[f"{name}.{vector}"] = (outputs,)
    return shapes


def _attention_shapes(name: str, parameters: NetworkParameters) -> dict[str, tuple[int, ...]]:
    p = parameters
    columns = 2 * p.n_heads * p.key_width + p.width
    return {
        f"{name}.norm.weight": (p.width,),
        f"{name}.norm.bias": (p.width,),
        f"{name}.node.weight": (columns, p.width),
        f"{name}.node.bias": (columns,),
        f"{name}.edge.weight": (columns, p.edge_width),
        f"{name}.out.weight": (p.width, p.width),
        f"{name}.out.bias": (p.width,),
    }


def check_weights(
    arrays: Mapping[str, NDArray], shapes: Mapping[str, tuple[int, ...]], n_classes: int
) -> dict[str, NDArray[np.float32]]:
    """Return the weights of a network in float32."""
    reasons = [f"Missing {name}" for name in shapes if name not in arrays]
    reasons += [f"Unexpected {name}" for name in arrays if name not in shapes]
    for name, shape in shapes.items():
        if name in arrays and arrays[name].shape != shape:
            reasons.append(f"{name} has the shape {arrays[name].shape}, not {shape}")
        elif name in arrays and arrays[name].dtype.kind not in "fiu":
            reasons.append(f"{name} has the type {arrays[name].dtype}, not float32")
    if reasons:
        more = [f"{len(reasons) - _NAMED} more"] if len(reasons) > _NAMED else []
        text = "; ".join([*reasons[:_NAMED], *more])
        raise DataError(f"the weights do not fit {SLUG} with {n_classes} classes: {text}")
    return {name: np.ascontiguousarray(arrays[name], np.float32) for name in shapes}


def layers_of(weights: Weights, name: str) -> list[Layer]:
    """Return the layers of an MLP."""
    layers, i = [], 0
    while f"{name}.{i}.weight" in weights:
        linear = np.ascontiguousarray(weights[f"{name}.{i}.weight"].T)
        vectors = (weights[f"{name}.{part}"] for part in (f"{i}.bias", f"{i + 1}.weight", f"{i + 1}.bias"))
        layers.append(Layer(linear, *vectors))
        i += 3
    return layers


def attention_of(weights: Weights, name: str, parameters: NetworkParameters) -> Attention:
    """Return an attention block."""
    p = parameters
    keys = p.n_heads * p.key_width
    by_component = np.arange(keys).reshape(p.n_heads, p.key_width).T.ravel()
    values = np.arange(p.width).reshape(p.n_heads, -1).T.ravel()
    order = np.concatenate([by_component, keys + by_component, 2 * keys + values])
    scale = np.where(np.arange(len(order)) < keys, p.key_width**-0.5, 1.0).astype(np.float32)
    node, bias, edge, out = (
        weights[f"{name}.{part}"] for part in ("node.weight", "node.bias", "edge.weight", "out.weight")
    )
    return Attention(
        gain=weights[f"{name}.norm.weight"],
        shift=weights[f"{name}.norm.bias"],
        node=np.ascontiguousarray(node[order].T * scale),
        bias=bias[order] * scale,
        edge=np.ascontiguousarray(edge[order].T * scale),
        out=np.ascontiguousarray(out[:, values].T),
        out_bias=weights[f"{name}.out.bias"],
    )
