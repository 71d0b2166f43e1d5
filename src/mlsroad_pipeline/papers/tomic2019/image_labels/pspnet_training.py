"""Training of a PSPNet. Importing this module imports torch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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
from mlsroad_pipeline.papers.tomic2019.image_labels.muon import Muon
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet import MEAN, PSPNet, network_input
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import TrainingParameters

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
            loss = _loss(main.float(), auxiliary.float(), torch.from_numpy(labels).to(chosen), weights, training)
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
    return min(1.0, (step + 1) / training.warm_up) * float(1 - step / training.n_steps) ** training.power


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


def _loss(main: Tensor, auxiliary: Tensor, labels: Tensor, weights: Tensor, training: TrainingParameters) -> Tensor:
    target = _thinned(labels, main)
    main = main.contiguous()  # one plane per class, as below
    logarithms = functional.log_softmax(main, dim=1)
    loss = functional.nll_loss(logarithms, target, weights, ignore_index=-1)
    if training.overlap_weight:
        loss = loss + training.overlap_weight * overlap_loss(logarithms.exp(), target)
    if training.auxiliary_weight:
        rest = functional.cross_entropy(auxiliary, _thinned(labels, auxiliary), weights, ignore_index=-1)
        loss = loss + training.auxiliary_weight * rest
    return loss


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
