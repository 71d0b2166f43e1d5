"""Published weights of a PSPNet in PyTorch files. Importing this module imports torch."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable
from mlsroad_pipeline.model_store.torch_checkpoints import torch_error
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet import PSPNet
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet_layouts import recognise_weights
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet_weights import load_state


def load_published(path: str | Path, *, n_classes: int | None = None, backbone: str | None = None) -> PSPNet:
    """Read published PyTorch weights of a PSPNet, such as those trained on Cityscapes."""
    source = Path(path)
    if not source.is_file():
        raise ReadError(f"{source}: no such weights")
    try:
        given = torch.load(source, map_location="cpu", weights_only=True)
    except Exception as error:  # torch has no error of its own for a file that is no checkpoint
        raise ReadError(f"{source}: cannot be read as weights without running code: {torch_error(error)}") from error
    state = given.get("state_dict", given) if isinstance(given, dict) else None
    if not isinstance(state, dict) or not all(
        isinstance(name, str) and isinstance(value, Tensor) for name, value in state.items()
    ):
        raise ReadError(f"{source}: holds no state dict")
    state = {printable(name): value for name, value in state.items()}
    wrong = next((name for name, value in state.items() if not _is_finite(value)), None)
    if wrong is not None:
        raise DataError(f"{source}: weights {wrong} hold NaN, infinity or no real numbers")
    if backbone is None:
        backbone, state = recognise_weights(state, source=str(source))
    if n_classes is None:
        last = next((value for name, value in state.items() if name.endswith("cls.4.weight")), None)
        if last is None:
            raise DataError(f"{source}: has no weights cls.4.weight, whose first size is the number of classes")
        if last.ndim != 4 or not len(last):
            raise DataError(
                f"{source}: weights cls.4.weight have the shape {tuple(last.shape)}, not (classes, n, 1, 1)"
            )
        n_classes = len(last)
    network = PSPNet(n_classes, backbone=backbone)
    load_state(network, state, source=str(source))
    return network.eval()


def _is_finite(weights: Tensor) -> bool:
    return not weights.is_complex() and bool(torch.isfinite(weights).all())
