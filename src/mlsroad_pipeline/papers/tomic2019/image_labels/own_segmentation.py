"""Models that label through images segmented elsewhere: masks in files, published weights, or ONNX models."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.cameras.legend import Legend
from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.labelling import member, with_members
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import ImageLabelsParameters
from mlsroad_pipeline.surveys.class_map_files import read_class_map

_LARGEST = 2**31 - 1


def own_model(
    parameters: ImageLabelsParameters, scheme: ClassScheme, *, cameras: Sequence[str] = (),
    trained_on: Mapping[str, Any] | None = None,
) -> ModelBundle:  # fmt: skip
    """Return the model of the masks or the weights that the parameters name; no survey is read."""
    from mlsroad_pipeline.papers.tomic2019.image_labels.labeller import make_model  # noqa: PLC0415  it imports torch

    legend = read_class_map(parameters.classes, scheme)
    arrays: dict[str, Any] = {}
    description: dict[str, Any] = {"source": "masks"}
    if parameters.weights is not None:
        arrays, description = _of_weights(parameters, legend)
    description["name"] = segmentation_name(parameters)
    return make_model(
        arrays, {**description, "classes": legend.to_json()}, parameters=parameters, scheme=scheme, cameras=cameras,
        trained_on={"segmentation": description["name"], "classes": parameters.classes, **(trained_on or {})},
    )  # fmt: skip


def with_own_segmentation(bundle: ModelBundle, parameters: ImageLabelsParameters) -> ModelBundle:
    """Return a fusion whose images are segmented by the masks or the weights that the parameters name."""
    members = bundle.metadata.get("members", {})
    before = members.get("image_labels")
    if before is None:
        raise ParameterError(f"model {bundle.slug!r} has no member 'image_labels'; train it again with this version")
    own = own_model(parameters, bundle_scheme(bundle), cameras=before["cameras"])
    kept = {slug: member(bundle, slug) for slug in members}
    rest = {name: values for name, values in bundle.arrays.items() if "/" not in name}
    return with_members(replace(bundle, arrays=rest), {**kept, "image_labels": own})


def segmentation_name(parameters: ImageLabelsParameters) -> str:
    """Return the name of the masks or the weights that the parameters name, for logs and summaries."""
    return f"masks of {parameters.masks}" if parameters.weights is None else str(parameters.weights)


def with_device(bundle: ModelBundle, device: str) -> ModelBundle:
    """Return a model whose images are segmented on another device than its training named."""
    metadata = dict(bundle.metadata)
    if bundle.slug != "image_labels":
        members = metadata.get("members", {})
        if "image_labels" not in members:
            return bundle
        metadata["members"] = {**members, "image_labels": _on(members["image_labels"], device)}
        return replace(bundle, metadata=metadata)
    return replace(bundle, metadata=_on(metadata, device))


def _on(metadata: Mapping[str, Any], device: str) -> dict[str, Any]:
    return {**metadata, "parameters": {**metadata["parameters"], "device": device}}


def _of_weights(parameters: ImageLabelsParameters, legend: Legend) -> tuple[dict[str, Any], dict[str, Any]]:
    path = Path(str(parameters.weights)).expanduser()
    if not path.is_file():
        raise ReadError(f"{path}: no such weights (image_labels.weights)")
    if path.suffix.lower() == ".onnx":
        arrays: dict[str, Any] = {"onnx": _content(path)}
        count = _onnx_classes(arrays["onnx"], parameters, legend, str(path))
        description: dict[str, Any] = {"source": "onnx"}
    else:
        from mlsroad_pipeline.papers.tomic2019.image_labels import pspnet_weights  # noqa: PLC0415  it imports torch

        network = pspnet_weights.load_published(path)
        count, arrays = network.n_classes, pspnet_weights.to_arrays(network)
        description = {"source": "network", "backbone": network.backbone, "n_classes": count}
    if count != legend.n_scores:
        raise DataError(
            f"{path}: has {count} classes, {legend.source} names {legend.n_scores} from 0: set image_labels.classes to "
            "the class map of the network"
        )
    return arrays, description


def _content(path: Path) -> np.ndarray:
    if path.stat().st_size > _LARGEST:
        raise ReadError(f"{path}: has {path.stat().st_size} bytes; ONNX models have at most {_LARGEST}")
    return np.frombuffer(path.read_bytes(), dtype=np.uint8)


def _onnx_classes(content: np.ndarray, parameters: ImageLabelsParameters, legend: Legend, source: str) -> int:
    from mlsroad_pipeline.papers.tomic2019.image_labels.onnx_network import OnnxNetwork  # noqa: PLC0415  an extra

    return OnnxNetwork(
        content.tobytes(), n_numbers=legend.n_scores, mean=parameters.mean, spread=parameters.spread,
        device=parameters.device, source=source,
    ).n_classes  # fmt: skip
