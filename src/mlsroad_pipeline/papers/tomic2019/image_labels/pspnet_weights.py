"""Weights of a PSPNet as state dicts and plain arrays. Importing this module imports torch."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet import PSPNet


def load_state(network: PSPNet, state: Mapping[str, Tensor], *, source: str = "weights") -> None:
    """Load weights into a network; those of the auxiliary head are optional."""
    plain = {name.removeprefix("module."): value for name, value in state.items()}
    own = network.state_dict()
    optional = {name for name in own if name.startswith("aux.") or name.endswith("num_batches_tracked")}
    missing = sorted(name for name in own if name not in plain and name not in optional)
    unknown = sorted(name for name in plain if name not in own)
    shapes = [
        f"{name}: {tuple(plain[name].shape)} instead of {tuple(own[name].shape)}"
        for name in own
        if name in plain and plain[name].shape != own[name].shape
    ]
    for what, names in (("missing", missing), ("unknown", unknown), ("of another shape", shapes)):
        if names:
            raise DataError(
                f"{source}: {len(names)} weights are {what} for a PSPNet on {network.backbone} with "
                f"{network.n_classes} classes, the first is {names[0]}"
            )
    network.load_state_dict({**own, **plain})


def to_arrays(network: PSPNet) -> dict[str, NDArray]:
    """Return the weights as arrays, for files without code."""
    return {name: value.cpu().numpy().copy() for name, value in network.state_dict().items()}


def from_arrays(arrays: Mapping[str, NDArray], *, n_classes: int, backbone: str) -> PSPNet:
    """Rebuild a network from the arrays of `to_arrays`."""
    network = PSPNet(n_classes, backbone=backbone)
    load_state(network, {name: torch.from_numpy(np.array(value)) for name, value in arrays.items()})
    return network.eval()
