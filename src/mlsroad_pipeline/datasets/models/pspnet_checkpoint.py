"""Published weights of a PSPNet in PyTorch files. Importing this module imports torch."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.image_labels.pspnet import PSPNet
from mlsroad_pipeline.algorithms.image_labels.pspnet_weights import load_state


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
