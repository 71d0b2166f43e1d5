"""Names of the weights of published PSPNets, and the network that a set of weights is of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from mlsroad_pipeline.algorithms.core.exceptions import DataError

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
