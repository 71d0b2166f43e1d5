"""Segmentation of the images of a model by its network, an ONNX model or masks. Importing this module imports torch."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.legend import Legend
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.machines.torch_training import find_device
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet import PSPNet
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet_weights import from_arrays
from mlsroad_pipeline.papers.tomic2019.image_labels.segmentation import Segmenter, segment_image

MASKS, NETWORK, ONNX = "masks", "network", "onnx"
"""Ways in which the images of a model are segmented."""

_kept: dict[tuple[Any, ...], Segmenter] = {}


def segmentation_of(bundle: ModelBundle) -> Mapping[str, Any]:
    """Return how the images of a model are segmented; a model without an entry has a network of its own classes."""
    stored = bundle.metadata.get("segmentation")
    if stored is not None:
        found: Mapping[str, Any] = stored
        return found
    legend = Legend.of_scheme(bundle_scheme(bundle))
    return {"source": NETWORK, "classes": legend.to_json(), "name": "trained network"}


def legend_of(bundle: ModelBundle) -> Legend:
    """Return what the classes of the images of a model mean."""
    return Legend.from_json(segmentation_of(bundle)["classes"])


def network_of(bundle: ModelBundle) -> PSPNet:
    """Return the network of a model."""
    how, parameters = segmentation_of(bundle), bundle.metadata["parameters"]
    if how["source"] != NETWORK:
        raise DataError(f"the model has no network of its own: its images are segmented by {how['source']}")
    backbone = how.get("backbone", parameters["network"]["backbone"])
    network = from_arrays(bundle.arrays, n_classes=how.get("n_classes", legend_of(bundle).n_scores), backbone=backbone)
    network.mean, network.spread = (tuple(parameters.get(n, getattr(network, n))) for n in ("mean", "spread"))
    return network.to(find_device(parameters.get("device", "auto"))).eval()


def segmenter_of(bundle: ModelBundle) -> Callable[[NDArray[np.uint8]], NDArray[np.float32]]:
    """Return the function that segments an image of a model."""
    how, p = segmentation_of(bundle), bundle.metadata["parameters"]
    legend, scheme = legend_of(bundle), bundle_scheme(bundle)
    network: Segmenter = _onnx_network(bundle, legend) if how["source"] == ONNX else network_of(bundle)
    window = p.get("window")

    def segment(image: NDArray[np.uint8]) -> NDArray[np.float32]:
        scores = segment_image(
            network, image, window=None if window is None else (int(window[0]), int(window[1])),
            overlap=p.get("overlap", 1 / 3), flip=p.get("flip", False), magnification=p["magnification"],
        )  # fmt: skip
        return legend.of_scores(scores, scheme, source=str(how["name"]))

    return segment


def _onnx_network(bundle: ModelBundle, legend: Legend) -> Segmenter:
    """Return the network of an ONNX model; the last one of the process is kept, since it is built for every scene."""
    from mlsroad_pipeline.papers.tomic2019.image_labels.onnx_network import OnnxNetwork  # noqa: PLC0415  an extra

    how, p = segmentation_of(bundle), bundle.metadata["parameters"]
    content = np.ascontiguousarray(bundle.arrays[ONNX])
    settings = (legend.n_scores, tuple(p["mean"]), tuple(p["spread"]), p["device"], str(how["name"]))
    key = (hashlib.blake2b(content.data).hexdigest(), *settings)
    if key not in _kept:
        _kept.clear()
        n_numbers, mean, spread, device, source = settings
        _kept[key] = OnnxNetwork(
            content.tobytes(), n_numbers=n_numbers, mean=mean, spread=spread, device=device, source=source
        )
    return _kept[key]
