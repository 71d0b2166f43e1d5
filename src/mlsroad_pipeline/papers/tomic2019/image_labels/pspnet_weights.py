"""Weights of a PSPNet: plain arrays, and published PyTorch files. Importing this module imports torch."""

from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable, torch_error
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


Value = TypeVar("Value")

_MMSEG = {
    "backbone.stem.": "layer0.",
    "backbone.": "",
    "decode_head.bottleneck.conv.": "cls.0.",
    "decode_head.bottleneck.bn.": "cls.1.",
    "decode_head.conv_seg.": "cls.4.",
    "auxiliary_head.convs.0.conv.": "aux.0.",
    "auxiliary_head.convs.0.bn.": "aux.1.",
    "auxiliary_head.conv_seg.": "aux.4.",
    **{f"decode_head.psp_modules.{k}.1.conv.": f"ppm.features.{k}.1." for k in range(4)},
    **{f"decode_head.psp_modules.{k}.1.bn.": f"ppm.features.{k}.2." for k in range(4)},
}
_CSAIL = {
    "encoder.conv1.": "layer0.0.",
    "encoder.bn1.": "layer0.1.",
    "encoder.conv2.": "layer0.3.",
    "encoder.bn2.": "layer0.4.",
    "encoder.conv3.": "layer0.6.",
    "encoder.bn3.": "layer0.7.",
    "encoder.": "",
    "decoder.conv_last.": "cls.",
    "decoder.cbr_deepsup.": "aux.",
    "decoder.conv_last_deepsup.": "aux.4.",
    **{f"decoder.ppm.{k}.": f"ppm.features.{k}." for k in range(4)},
}
_LAYOUTS = {"mmseg": _MMSEG, "csail": _CSAIL, "": {}}
_MARKS = {"mmseg": "decode_head.conv_seg.weight", "csail": "decoder.conv_last.4.weight", "": "cls.4.weight"}
_DEPTHS = {6: "resnet50", 23: "resnet101"}


def recognise_weights(state: Mapping[str, Value], *, source: str) -> tuple[str, dict[str, Value]]:
    """Return the backbone of published weights, and the weights by the names of `PSPNet`."""
    plain = {name.removeprefix("module."): value for name, value in state.items()}
    layout = next((name for name, mark in _MARKS.items() if mark in plain), None)
    if layout is None:
        raise DataError(
            f"{source}: no PSPNet of semseg, MIT CSAIL or mmsegmentation: none of {', '.join(_MARKS.values())} "
            f"is among its {len(plain)} weights, such as {next(iter(plain), 'none')}; export the network to ONNX"
        )
    weights = {_renamed(name, _LAYOUTS[layout]): value for name, value in plain.items()}
    blocks = len({name.split(".")[1] for name in weights if name.startswith("layer3.")})
    if blocks not in _DEPTHS:
        raise DataError(f"{source}: layer3 has {blocks} blocks; ResNet-50 has 6 and ResNet-101 has 23")
    return "_".join(filter(None, (_DEPTHS[blocks], layout))), weights


def _renamed(name: str, prefixes: Mapping[str, str]) -> str:
    found = max((prefix for prefix in prefixes if name.startswith(prefix)), key=len, default=None)
    return name if found is None else prefixes[found] + name.removeprefix(found)


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
