"""Segmentation of images of any size by a PSPNet, an ONNX model or masks. Importing this module imports torch."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from mlsroad_pipeline.algorithms.cameras.legend import Legend
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.machines.torch_training import find_device, limited_threads
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet import PSPNet, network_input
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet_weights import from_arrays
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import check_magnifications


class Segmenter(Protocol):
    """Network that scores the pixels of images, such as a `PSPNet`."""

    @property
    def n_classes(self) -> int:
        """Number of scores of a pixel."""

    @property
    def mean(self) -> Sequence[float]:
        """Mean of the colours."""

    @property
    def spread(self) -> Sequence[float]:
        """Standard deviation of the colours."""

    @property
    def device(self) -> torch.device:
        """Device that it computes on."""

    def __call__(self, x: Tensor, /) -> tuple[Tensor, Tensor | None]:
        """Return the log odds of the classes of each pixel first."""


def segment_image(
    network: Segmenter, image: NDArray[np.uint8], *, window: tuple[int, int] | None = None, overlap: float = 1 / 3,
    flip: bool = False, magnification: float | Sequence[float] = 1.0, n_threads: int = 1,
) -> NDArray[np.float32]:  # fmt: skip
    """Return the class probabilities of each pixel."""
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise DataError(f"an image must have shape (height, width, 3) and be uint8, got {image.shape} {image.dtype}")
    if not 0 <= overlap < 1:
        raise ParameterError(f"overlap must be in [0, 1), got {overlap!r}")
    magnifications = check_magnifications(magnification)
    height, width = image.shape[:2]
    rows, columns = (height, width) if window is None else window
    if min(rows, columns) < 1:
        raise ParameterError(f"a window's sides must be at least 1 pixel, got {window}")
    rows, columns = min(rows, height), min(columns, width)
    total = np.zeros((height, width, network.n_classes), dtype=np.float32)
    count = np.zeros((height, width, 1), dtype=np.float32)
    with limited_threads(n_threads):
        for top in _starts(height, rows, overlap):
            for left in _starts(width, columns, overlap):
                part = np.s_[top : top + rows, left : left + columns]
                total[part] += _probabilities(network, image[part], flip, magnifications)
                count[part] += 1
    return total / count


def _starts(size: int, window: int, overlap: float) -> list[int]:
    """Return the starts of windows that cover a side evenly and overlap by at least a share."""
    step = max(1, int(window * (1 - overlap)))
    steps = int(np.ceil((size - window) / step))
    return sorted({round(k * (size - window) / max(steps, 1)) for k in range(steps + 1)})


def _probabilities(
    network: Segmenter, image: NDArray[np.uint8], flip: bool, magnifications: Sequence[float]
) -> NDArray[np.float32]:  # fmt: skip
    height, width = image.shape[:2]
    log_odds = []
    with torch.inference_mode():
        pixels = network_input(image[None], mean=network.mean, spread=network.spread).to(network.device)
        for magnification in magnifications:
            enlarged = _scaled(pixels, [max(1, round(side * magnification)) for side in (height, width)])
            log_odds.append(_scaled(network(enlarged)[0], (height, width)))
            if flip:
                log_odds.append(_scaled(network(enlarged.flip(3))[0], (height, width)).flip(3))
        mean = torch.stack([torch.log_softmax(values, dim=1) for values in log_odds]).mean(dim=0)
        out = torch.softmax(mean, dim=1)
    probabilities: NDArray[np.float32] = out[0].permute(1, 2, 0).cpu().numpy()
    return probabilities


def _scaled(x: Tensor, size: Sequence[int]) -> Tensor:
    """Return pixels interpolated to another size; the outer edges of the corner pixels are kept."""
    if tuple(x.shape[2:]) == tuple(size):
        return x
    return functional.interpolate(x, size=tuple(size), mode="bilinear", align_corners=False)


MASKS, NETWORK, ONNX = "masks", "network", "onnx"
"""Ways in which the images of a model are segmented."""

_kept: dict[tuple[Any, ...], Segmenter] = {}


def segmentation_of(bundle: ModelBundle) -> Mapping[str, Any]:
    """Return how the images of a model are segmented; without an entry, by a network of its own classes."""
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
