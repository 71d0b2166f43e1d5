"""Trainings of the benchmark of networks on a GPU, and the clock of their steps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import torch
from numpy.typing import NDArray


def synchronise() -> None:
    """Wait until the GPU has finished."""
    if torch.cuda.is_initialized():
        torch.cuda.synchronize()


@dataclass(frozen=True)
class Setting:
    """A training.

    Attributes
    ----------
    batch : int
        Batch size.
    steps : int
        Steps or, for recognisers of objects, epochs.
    precision : str
        ``float32`` or ``bfloat16``.
    on : tuple of str
        Where it is run: ``cpu``, ``gpu``.
    other : dict
        Other changes of the parameters.
    """

    batch: int
    steps: int
    precision: str = "float32"
    on: tuple[str, ...] = ("cpu", "gpu")
    other: dict[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        """Return the settings for a table."""
        changes = "".join(f", {name} {value}" for name, value in self.other.items())
        return f"batch {self.batch}, {self.steps} x, {self.precision}{changes}"


@dataclass
class Clock:
    """Seconds of steps, and of waiting before each of them."""

    steps: list[float] = field(default_factory=list)
    waits: list[float] = field(default_factory=list)
    last: float | None = None

    def step(self, run: Callable[..., Any], *args: Any) -> Any:
        """Run and time a step."""
        synchronise()
        start = time.perf_counter()
        self.waits.append(0.0 if self.last is None else start - self.last)
        result = run(*args)
        synchronise()
        self.last = time.perf_counter()
        self.steps.append(self.last - start)
        return result

    def between(self, batches: Iterator[Any]) -> Iterator[Any]:
        """Yield batches; the time until the next one is asked for is that of a step."""
        while True:
            start = time.perf_counter()
            try:
                batch = next(batches)
            except StopIteration:
                return
            given = time.perf_counter()
            yield batch
            synchronise()
            self.waits.append(given - start)
            self.steps.append(time.perf_counter() - given)


@dataclass(frozen=True)
class Case:
    """A network.

    Attributes
    ----------
    name : str
        The name.
    train : callable
        (setting, device, clock) to a model.
    predict : callable
        (model, device) to class probabilities of what it was not trained on; it moves the model.
    truth : ndarray
        The true columns; negative where unknown.
    settings : list of Setting
        Trainings; the network of the first one predicts.
    mixed : bool
        Predict in bfloat16 too.
    n_weights : callable
        Model to the number of weights.
    """

    name: str
    train: Callable[[Setting, str, Clock], Any]
    predict: Callable[[Any, str], NDArray[Any]]
    truth: NDArray[Any]
    settings: list[Setting]
    mixed: bool
    n_weights: Callable[[Any], int]
