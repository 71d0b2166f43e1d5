"""Training of a PSPNet, and its optimiser Muon. Importing this module imports torch."""

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.models.machines.torch_training import find_device, limited_threads
from mlsroad_pipeline.papers.tomic2019.image_labels.crops import Batch, Crops, Sample
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet import MEAN, PSPNet, network_input
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import TrainingParameters

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

    @torch.no_grad()
    def step(self) -> None:  # type: ignore[override]  # no line search
        """Update the kernels."""
        for group in self.param_groups:
            for kernel in group["params"]:
                if kernel.grad is not None:
                    self._change(kernel, kernel.grad, group["lr"], group["momentum"], group["weight_decay"])

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


_POWER = 0.9  # exponent of the polynomial decay of the learning rate (PSPNet paper)
_AUXILIARY_WEIGHT = 0.4  # weight of the loss of the auxiliary head (PSPNet paper)
_BESIDE = 0.3  # ratio of the learning rate of AdamW to that of Muon


def train_network(
    samples: Sequence[Sample], *, n_classes: int, parameters: TrainingParameters | None = None,
    network: PSPNet | None = None, device: str = "auto",
) -> tuple[PSPNet, list[float]]:  # fmt: skip
    """Train a PSPNet."""
    training = TrainingParameters() if parameters is None else parameters
    crops = Crops(samples, n_classes, training, np.round(MEAN).astype(int).tolist())
    torch.manual_seed(training.random_state)
    model = PSPNet(n_classes, backbone=training.backbone, dropout=training.dropout) if network is None else network
    if model.n_classes != n_classes:
        raise ParameterError(f"the network has {model.n_classes} classes, not {n_classes}")
    chosen = find_device(device)
    model.to(chosen).to(memory_format=torch.channels_last).train()  # type: ignore[call-overload]  # not in its types
    weights = _class_weights(crops.shares, training.class_balance).to(chosen)
    optimisers = _optimisers(model, training)
    schedules = [torch.optim.lr_scheduler.LambdaLR(each, lambda step: _share(step, training)) for each in optimisers]
    losses = []
    with limited_threads(training.n_threads):
        for images, labels in _ahead(crops.batches(np.random.default_rng(training.random_state))):
            pixels = network_input(images).to(chosen)
            with torch.autocast(chosen.type, torch.bfloat16, enabled=_in_bfloat16(training.precision, chosen)):
                main, auxiliary = model(pixels)
            loss = _loss(main.float(), auxiliary.float(), torch.from_numpy(labels).to(chosen), weights)
            model.zero_grad()
            loss.backward()
            for optimiser, schedule in zip(optimisers, schedules, strict=True):
                optimiser.step()
                schedule.step()
            losses.append(float(loss.detach()))
    return model.to("cpu").to(memory_format=torch.contiguous_format).eval(), losses  # type: ignore[call-overload]  # as above


def _ahead(batches: Iterator[Batch]) -> Iterator[Batch]:
    """Yield batches, each prepared in a thread during the training step before it."""
    with ThreadPoolExecutor(1) as pool:
        drawn = pool.submit(next, batches, None)
        while (batch := drawn.result()) is not None:
            drawn = pool.submit(next, batches, None)
            yield batch


def _share(step: int, training: TrainingParameters) -> float:
    """Return the learning rate of a step as a share of the highest."""
    return min(1.0, (step + 1) / training.warm_up) * float(1 - step / training.n_steps) ** _POWER


def _in_bfloat16(precision: str, device: torch.device) -> bool:
    """Return whether to multiply in bfloat16: if requested, or if the processor has instructions for it."""
    if precision != "auto":
        return precision == "bfloat16"
    capabilities = torch.cpu.get_capabilities()
    return device.type == "cuda" or bool(capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"))


def _class_weights(shares: NDArray[np.float64], balance: float) -> Tensor:
    """Return class weights: a power of the inverse frequency, 1 on average over pixels; 0 for absent classes."""
    weights = np.where(shares > 0, np.maximum(shares, 1e-5) ** -balance, 0.0)
    return torch.from_numpy((weights / max((weights * shares).sum(), 1e-12)).astype(np.float32))


def _optimisers(model: PSPNet, training: TrainingParameters) -> list[torch.optim.Optimizer]:
    if training.optimiser == "sgd":
        descent = torch.optim.SGD(
            model.parameters(),
            training.learning_rate,
            momentum=training.momentum,
            weight_decay=training.weight_decay,
            nesterov=True,
        )
        return [descent]
    # Weight decay applies to kernels only, not to biases and normalisation.
    kernels = [weight for weight in model.parameters() if weight.ndim > 1]
    others = [weight for weight in model.parameters() if weight.ndim <= 1]
    if training.optimiser == "adamw":
        return [_adamw(kernels, others, training)]
    # Muon is for hidden layers; the input and output layers use AdamW.
    ends = {id(weight) for layer in model.end_layers() for weight in layer.parameters()}
    inner = [weight for weight in kernels if id(weight) not in ends]
    outer = [weight for weight in kernels if id(weight) in ends]
    slower = replace(training, learning_rate=_BESIDE * training.learning_rate)
    return [
        Muon(inner, training.learning_rate, training.momentum, training.weight_decay),
        _adamw(outer, others, slower),
    ]


def _adamw(kernels: list[nn.Parameter], others: list[nn.Parameter], training: TrainingParameters) -> torch.optim.AdamW:
    groups = [{"params": kernels, "weight_decay": training.weight_decay}, {"params": others, "weight_decay": 0.0}]
    return torch.optim.AdamW(groups, training.learning_rate, fused=True)


def _loss(main: Tensor, auxiliary: Tensor, labels: Tensor, weights: Tensor) -> Tensor:
    target = _thinned(labels, main)
    main = main.contiguous()  # one plane per class, as below
    logarithms = functional.log_softmax(main, dim=1)
    loss = functional.nll_loss(logarithms, target, weights, ignore_index=-1)
    # The soft IoU loss favours rare classes, since all classes have the same weight in the mean IoU.
    loss = loss + overlap_loss(logarithms.exp(), target)
    rest = functional.cross_entropy(auxiliary, _thinned(labels, auxiliary), weights, ignore_index=-1)
    return loss + _AUXILIARY_WEIGHT * rest


def _thinned(labels: Tensor, like: Tensor) -> Tensor:
    """Return the labels subsampled to the rows and columns of a head, evenly spaced from the first."""
    if like.shape[2:] == labels.shape[1:]:
        return labels
    return functional.interpolate(labels[:, None].float(), like.shape[2:])[:, 0].long()


def overlap_loss(probabilities: Tensor, labels: Tensor) -> Tensor:
    """Return 1 minus the mean soft IoU over the classes present in a batch."""
    n_classes = probabilities.shape[1]
    # Class masks are faster than gather and scatter: one pass over memory.
    own = (labels[:, None] == torch.arange(n_classes, device=labels.device)[:, None, None]).float()
    size = own.sum(dim=(0, 2, 3))
    shared = (probabilities * own).sum(dim=(0, 2, 3))
    covered = (probabilities * (labels >= 0)[:, None]).sum(dim=(0, 2, 3))
    shown = size > 0
    if not shown.any():
        return covered.sum() * 0
    return 1 - (shared / (size + covered - shared))[shown].mean()
