"""Segmentation networks in ONNX. Importing this module imports torch and onnxruntime (extra ``onnx``)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.plain_text import printable
from mlsroad_pipeline.algorithms.models.machines.torch_training import find_device, warn_of_cpu
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet import MEAN, SPREAD

try:
    import onnxruntime
except ImportError as error:
    raise ParameterError(
        "image_labels.weights in ONNX needs onnxruntime: install mlsroad_pipeline[onnx], or pip install onnxruntime"
    ) from error

STEP = 32
"""Sides of images are rounded to multiples of it where a network takes any size, pixels."""

_CUDA = "CUDAExecutionProvider"
_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(uint8)": np.uint8}


class OnnxNetwork:
    """Segmentation network of an ONNX file."""

    def __init__(
        self, content: bytes, *, n_numbers: int, mean: Sequence[float] = MEAN, spread: Sequence[float] = SPREAD,
        device: str = "auto", source: str = "ONNX model",
    ) -> None:  # fmt: skip
        self.mean, self.spread, self.source, self._n_numbers = tuple(mean), tuple(spread), source, n_numbers
        self.device = torch.device("cpu")  # onnxruntime copies what it needs
        self._session = _session(content, device, source)
        try:
            given = self._session.get_inputs()
            shape = list(given[0].shape) if len(given) == 1 else []
        except UnicodeDecodeError as error:
            raise DataError(f"{source}: cannot be read as an ONNX model: {_one_line(error)}") from error
        if len(shape) != 4 or 3 not in (shape[1], shape[3]) or given[0].type not in _TYPES:
            found = printable(", ".join(f"{item.name} {item.type} {item.shape}" for item in given))[:300]
            raise DataError(
                f"{source}: its input must be one image (1, 3, rows, columns) of float or uint8, not {found}"
            )
        self._name, self._type = given[0].name, _TYPES[given[0].type]
        self._last = shape[1] != 3
        sides = shape[1:3] if self._last else shape[2:4]
        self._sides = [side if isinstance(side, int) and side > 0 else None for side in sides]
        self.n_classes = int(self(torch.zeros(1, 3, 2 * STEP, 2 * STEP))[0].shape[1])

    def __call__(self, x: Tensor, /) -> tuple[Tensor, None]:
        """Return the log odds of the classes of each pixel."""
        size = x.shape[2:]
        sides = [own or STEP * max(1, round(side / STEP)) for own, side in zip(self._sides, size, strict=True)]
        image = _resized(x, sides)
        if self._type is np.uint8:
            mean, spread = (torch.tensor(v)[:, None, None] for v in (self.mean, self.spread))
            image = (image * spread + mean).round().clamp(0, 255)
        pixels = np.ascontiguousarray(image.numpy().transpose(0, 2, 3, 1) if self._last else image.numpy())
        try:
            out = np.asarray(self._session.run(None, {self._name: pixels.astype(self._type)})[0])
        except Exception as error:  # as above
            raise DataError(
                f"{self.source}: fails on an image of {sides[1]} x {sides[0]} pixels: {_one_line(error)}"
            ) from error
        return _resized(self._log_odds(out), size), None

    def _log_odds(self, out: NDArray) -> Tensor:
        if out.dtype.kind in "iu":
            if out.ndim not in (3, 4) or set(out.shape[:-2]) != {1} or not out.size:
                raise DataError(
                    f"{self.source}: returns {out.dtype} {out.shape}, not class numbers (1, rows, columns) or "
                    "(1, 1, rows, columns)"
                )
            numbers = out.reshape(1, *out.shape[-2:]).astype(np.int64)
            if numbers.max() >= self._n_numbers or numbers.min() < 0:
                wrong = numbers.min() if numbers.min() < 0 else numbers.max()
                raise DataError(f"{self.source}: returns class number {wrong}, the class map has {self._n_numbers}")
            shares = functional.one_hot(torch.from_numpy(numbers), self._n_numbers).permute(0, 3, 1, 2).float()
            return torch.log(shares.clamp(min=1e-6))
        if out.ndim != 4 or len(out) != 1 or not out.size or out.dtype.kind != "f":
            raise DataError(f"{self.source}: returns {out.dtype} {out.shape}, not scores (1, classes, rows, columns)")
        if not (out < np.inf).all():
            raise DataError(f"{self.source}: returns NaN or infinity for an image")
        scores = torch.from_numpy(out.astype(np.float32))
        if out.min() >= 0 and np.abs(out.sum(axis=1, dtype=np.float64) - 1).max() < 1e-2:
            return torch.log(scores.clamp(min=1e-12))  # probabilities
        return scores


def _resized(x: Tensor, size: Sequence[int]) -> Tensor:
    if tuple(x.shape[2:]) == tuple(size):
        return x
    smaller = size[0] < x.shape[2] or size[1] < x.shape[3]
    return functional.interpolate(x, size=tuple(size), mode="bilinear", align_corners=False, antialias=smaller)


def _session(content: bytes, device: str, source: str) -> onnxruntime.InferenceSession:
    """Return a session; with the device "auto" it is one of the CPU where the GPU fails."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1  # sums depend on the number of threads
    options.log_severity_level = 4  # errors are raised
    providers = _providers(device)
    try:  # its own fallback prints to the standard output
        session = onnxruntime.InferenceSession(content, options, providers=providers, enable_fallback=0)
    except Exception as error:  # onnxruntime has an error class for each kind of failure
        if device != "auto" or len(providers) == 1:
            raise DataError(f"{source}: cannot be read as an ONNX model: {_one_line(error)}") from error
        session = _session(content, "cpu", source)
        warn_of_cpu("onnxruntime", _one_line(error))
        return session
    used = ", ".join(session.get_providers())
    if device == "cuda" and _CUDA not in used:  # onnxruntime takes the CPU instead
        raise ParameterError(
            f"{source}: device is 'cuda', but onnxruntime cannot use CUDA here (it runs with {used}): install its CUDA "
            "libraries, or use device 'cpu'"
        )
    if device == "auto" and len(session.get_providers()) < len(providers):
        warn_of_cpu("onnxruntime", f"it runs with {used}")
    return session


def _providers(device: str) -> list[str]:
    available = onnxruntime.get_available_providers()
    if device not in ("auto", "cpu", "cuda"):
        find_device(device)
    if device == "cuda" and _CUDA not in available:
        raise ParameterError("device is 'cuda', but onnxruntime has no CUDA: install onnxruntime-gpu, or use 'cpu'")
    return [*([_CUDA] if device != "cpu" and _CUDA in available else []), "CPUExecutionProvider"]


def _one_line(error: Exception) -> str:
    return printable(error)[:300]
