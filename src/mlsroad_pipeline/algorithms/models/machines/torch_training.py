"""Device, reproducibility, learning rate and weights of neural networks.

This module imports PyTorch; modules that run no network must not import it.
"""

import functools
import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.plain_text import printable, shortened
from mlsroad_pipeline.algorithms.models.bundle import arrays_under

logger = logging.getLogger(__name__)

_NO_GPU = "Found no NVIDIA driver"
"""Part of the warning of PyTorch with CUDA on a computer without a GPU."""


def find_device(wanted: str) -> torch.device:
    """Return the device that networks run on."""
    if wanted not in ("auto", "cpu", "cuda"):
        raise ParameterError(f"device must be one of auto, cpu, cuda, got {wanted!r}")
    if wanted == "cpu":
        return torch.device("cpu")
    failure = _cuda_failure()
    if failure is None:
        return torch.device("cuda")
    if wanted == "cuda":
        reason = f"cannot use the GPU ({failure})" if failure else "finds no GPU"
        raise ParameterError(f"device is 'cuda', but PyTorch {reason}: use 'auto' or 'cpu'")
    if failure:
        warn_of_cpu("PyTorch", failure)
    return torch.device("cpu")


@functools.lru_cache(maxsize=8)
def warn_of_cpu(library: str, failure: str) -> None:
    """Warn that networks run on the CPU, although there is a GPU; once per reason."""
    logger.warning(
        "Networks run on the CPU, which is slower: %s cannot use the GPU (%s). Repair CUDA, or set the device to cpu",
        library,
        failure,
    )


@functools.lru_cache(maxsize=1)
def _cuda_failure() -> str | None:
    """Return why PyTorch cannot use a GPU: None if it can, an empty text if there is none."""
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            available = torch.cuda.is_available()
        if available:
            torch.zeros(1, device="cuda").add_(1).item()
            return None
    except (RuntimeError, AssertionError) as error:  # no memory, no kernels for it, used by another process alone
        return shortened(printable(error), 200) or type(error).__name__
    texts = [shortened(printable(item.message), 200) for item in caught]
    return next((text for text in texts if _NO_GPU not in text), "")


@contextmanager
def reproducible(seed: int) -> Iterator[None]:
    """Run PyTorch reproducibly: seeded, in one thread, with deterministic convolutions, and restore its state."""
    cudnn = torch.backends.cudnn
    # A GPU that is not in use is left alone: reading its random state would take its memory.
    used = [torch.cuda.current_device()] if torch.cuda.is_initialized() else []
    with (
        limited_threads(1),
        torch.random.fork_rng(devices=used),
        cudnn.flags(enabled=cudnn.enabled, benchmark=False, deterministic=True, allow_tf32=cudnn.allow_tf32),
    ):
        torch.manual_seed(seed)
        yield


@contextmanager
def limited_threads(count: int) -> Iterator[None]:
    """Limit the threads of PyTorch, which block each other on busy cores."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def learning_rate(step: int, n_steps: int, greatest: float) -> float:
    """Return the learning rate of a step: cosine warm-up over the first fifth, then cosine decay to 0."""
    warm = max(0.2 * n_steps, 1.0)
    if step < warm:
        return greatest * (0.04 + 0.96 * 0.5 * (1 - float(np.cos(np.pi * step / warm))))
    return greatest * 0.5 * (1 + float(np.cos(np.pi * (step - warm) / max(n_steps - warm, 1.0))))


def load_weights(network: nn.Module, arrays: Mapping[str, NDArray], prefix: str, what: str) -> None:
    """Load the weights of a network from arrays."""
    state = {name: torch.from_numpy(np.array(values)) for name, values in arrays_under(arrays, prefix).items()}
    try:
        network.load_state_dict(state)
    except RuntimeError as error:
        reasons = str(error).partition("\n")[2].strip().replace("\n\t", "; ")
        raise DataError(f"the weights do not fit {what}: {reasons}") from error
