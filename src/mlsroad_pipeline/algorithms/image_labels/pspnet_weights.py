"""Weights of a PSPNet: published ones, and plain arrays. Importing this module imports torch."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mlsroad_pipeline.algorithms.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.image_labels.pspnet import PSPNet


def load_published(path: str | Path, *, n_classes: int = 19, backbone: str = "resnet50") -> PSPNet:
    """Read published PyTorch weights of a PSPNet, such as those trained on Cityscapes.

    Parameters
    ----------
    path : str or Path
        A state dict, bare or below ``state_dict``; names may begin with ``module.``. Nothing but tensors is read from
        the file, no code.
    n_classes : int, default 19
        Classes of the weights.
    backbone : str, default "resnet50"
        ``resnet50`` or ``resnet101``.

    Returns
    -------
    PSPNet
        The network, ready to predict.

    Raises
    ------
    ReadError
        If the file is missing or no state dict.
    DataError
        If names or shapes are not those of the network; see `load_state`.
    """
    source = Path(path)
    if not source.is_file():
        raise ReadError(f"{source}: no such weights")
    try:
        given = torch.load(source, map_location="cpu", weights_only=True)
    except Exception as error:  # torch has no error of its own for a file that is no checkpoint
        raise ReadError(f"{source}: cannot be read as weights without running code: {error}") from error
    state = given.get("state_dict", given) if isinstance(given, dict) else None
    if not isinstance(state, dict) or not all(isinstance(value, Tensor) for value in state.values()):
        raise ReadError(f"{source}: holds no state dict")
    network = PSPNet(n_classes, backbone=backbone)
    load_state(network, state, source=str(source))
    return network.eval()


def load_state(network: PSPNet, state: Mapping[str, Tensor], *, source: str = "weights") -> None:
    """Put weights into a network; those of the auxiliary head may be missing.

    Parameters
    ----------
    network : PSPNet
        The network; changed.
    state : mapping of str to Tensor
        Names, perhaps with ``module.`` before them, to weights.
    source : str, default "weights"
        What messages call them.

    Raises
    ------
    DataError
        If a weight is missing, unknown or of another shape; the message names the first and gives the counts.
    """
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
    """Return the weights as arrays, for files that hold no code.

    Parameters
    ----------
    network : PSPNet
        The network.

    Returns
    -------
    dict of str to ndarray
        Name to weights.
    """
    return {name: value.numpy().copy() for name, value in network.state_dict().items()}


def from_arrays(arrays: Mapping[str, NDArray], *, n_classes: int, backbone: str) -> PSPNet:
    """Build a network from the arrays of `to_arrays`.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        Name to weights.
    n_classes : int
        Classes.
    backbone : str
        One of `BACKBONES`.

    Returns
    -------
    PSPNet
        The network, ready to predict.

    Raises
    ------
    DataError
        If names or shapes are not those of the network.
    """
    network = PSPNet(n_classes, backbone=backbone)
    load_state(network, {name: torch.from_numpy(np.array(value)) for name, value in arrays.items()})
    return network.eval()
