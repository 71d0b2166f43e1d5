"""What networks share: where they run, results that repeat, rates, and weights as plain arrays.

This module imports PyTorch; what need not run a network does not import it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.models.bundle import arrays_under


def find_device(wanted: str) -> torch.device:
    """Return where networks run.

    Parameters
    ----------
    wanted : {"auto", "cpu", "cuda"}
        "auto" is a GPU where there is one.

    Returns
    -------
    torch.device
        The device.

    Raises
    ------
    ParameterError
        If a GPU is asked for and there is none, or the name is unknown.
    """
    if wanted not in ("auto", "cpu", "cuda"):
        raise ParameterError(f"device must be one of auto, cpu, cuda, got {wanted!r}")
    there = torch.cuda.is_available()
    if wanted == "cuda" and not there:
        raise ParameterError("device is 'cuda', but this machine has no GPU that PyTorch can use")
    return torch.device("cuda" if wanted != "cpu" and there else "cpu")


@contextmanager
def reproducible(seed: int) -> Iterator[None]:
    """Make what PyTorch draws and adds up depend on the seed alone, and leave its state as it was.

    Parameters
    ----------
    seed : int
        The seed.

    Yields
    ------
    None
        One thread computes meanwhile: sums over threads depend on their number.
    """
    with limited_threads(1), torch.random.fork_rng():
        torch.manual_seed(seed)
        yield


@contextmanager
def limited_threads(count: int) -> Iterator[None]:
    """Let PyTorch use so many threads: on busy cores its threads wait for each other more than they help.

    Parameters
    ----------
    count : int
        Threads.

    Yields
    ------
    None
        Their former number holds again afterwards.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def learning_rate(step: int, n_steps: int, greatest: float) -> float:
    """Return the rate of a step: it rises over the first fifth and falls to 0 as a cosine.

    Parameters
    ----------
    step, n_steps : int
        The step, from 0, and how many there are.
    greatest : float
        The greatest rate.

    Returns
    -------
    float
        The rate.
    """
    warm = max(0.2 * n_steps, 1.0)
    if step < warm:
        return greatest * (0.04 + 0.96 * 0.5 * (1 - float(np.cos(np.pi * step / warm))))
    return greatest * 0.5 * (1 + float(np.cos(np.pi * (step - warm) / max(n_steps - warm, 1.0))))


def load_weights(network: nn.Module, arrays: Mapping[str, NDArray], prefix: str, what: str) -> None:
    """Give a network its weights.

    Parameters
    ----------
    network : Module
        The network.
    arrays : mapping of str to ndarray
        Weights among other arrays.
    prefix : str
        What the names of the network's weights begin with.
    what : str
        What messages call the network.

    Raises
    ------
    DataError
        If a weight is missing, left over or of another shape.
    """
    state = {name: torch.from_numpy(np.array(values)) for name, values in arrays_under(arrays, prefix).items()}
    try:
        network.load_state_dict(state)
    except RuntimeError as error:
        told = str(error).partition("\n")[2].strip().replace("\n\t", "; ")
        raise DataError(f"the weights do not fit {what}: {told}") from error
