"""Muon: momentum with orthogonalised steps. Importing this module imports torch."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import overload

import torch
from torch import Tensor

ROUNDS = ((7.7110, -22.1138, 16.2488), (3.2153, -2.4112, 0.5013), (2.2183, -1.5940, 0.4108))
"""Coefficients of x, x^3 and x^5 in each round, which map singular values of 0.02 to 1 towards 1.

The largest deviation from 1 is 0.85, 0.51 and 0.09 after the rounds; each minimises it by a linear program."""

_SIZE = 0.2  # root mean square of a step's values, as with AdamW, so that the same learning rates suit both


class Muon(torch.optim.Optimizer):
    """Stochastic gradient descent with momentum whose steps have singular values near one.

    A kernel is treated as the matrix from a neighbourhood to its output channels. AdamW follows the few directions of
    large gradients; Muon learns all directions at the same rate.
    """

    def __init__(
        self, kernels: Iterable[Tensor], learning_rate: float, momentum: float = 0.95, weight_decay: float = 0.0
    ) -> None:
        super().__init__(kernels, {"lr": learning_rate, "momentum": momentum, "weight_decay": weight_decay})

    @overload
    def step(self, closure: None = None) -> None: ...

    @overload
    def step(self, closure: Callable[[], float]) -> float: ...

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> float | None:
        """Update the kernels."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            for kernel in group["params"]:
                if kernel.grad is not None:
                    self._change(kernel, kernel.grad, group["lr"], group["momentum"], group["weight_decay"])
        return loss

    def _change(self, kernel: Tensor, gradient: Tensor, rate: float, momentum: float, decay: float) -> None:
        state = self.state[kernel]
        if not state:
            state["mean"] = torch.zeros_like(kernel)
        mean = state["mean"].lerp_(gradient, 1 - momentum)
        ahead = gradient.lerp(mean, momentum)  # Nesterov momentum
        last = ahead.movedim(1, -1)  # any order of columns is valid; this one is that of memory
        matrix = orthogonalised(last.flatten(1))
        size = _SIZE * max(matrix.shape) ** 0.5
        kernel.mul_(1 - rate * decay).add_(matrix.view(last.shape).movedim(-1, 1), alpha=-rate * size)


def orthogonalised(matrix: Tensor) -> Tensor:
    """Return an approximation of the matrix with the same singular vectors and singular values of 1.

    The iteration X <- (a + b X X' + c (X X')^2) X is computed on X X' alone, since all its factors commute. The kernels
    of a network have many more columns than rows, so this saves products with the wide matrix.
    """
    wide = matrix if matrix.shape[0] <= matrix.shape[1] else matrix.T
    wide = wide / (wide.norm() + 1e-7)
    gram = wide @ wide.T
    whole = _factor(gram, ROUNDS[0])
    done = whole
    for coefficients in ROUNDS[1:]:
        gram = done @ gram @ done
        done = _factor(gram, coefficients)
        whole = done @ whole
    out = whole @ wide
    return out if matrix.shape[0] <= matrix.shape[1] else out.T


def _factor(gram: Tensor, coefficients: tuple[float, float, float]) -> Tensor:
    linear, cubic, quintic = coefficients
    out = cubic * gram + quintic * (gram @ gram)
    out.diagonal().add_(linear)
    return out
