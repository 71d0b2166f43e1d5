"""Training a PSPNet. Importing this module imports torch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from mlsroad_pipeline.algorithms.exceptions import ParameterError
from mlsroad_pipeline.algorithms.image_labels.crops import Crops, Sample
from mlsroad_pipeline.algorithms.image_labels.pspnet import MEAN, PSPNet, network_input
from mlsroad_pipeline.algorithms.image_labels.training_parameters import TrainingParameters
from mlsroad_pipeline.algorithms.torch_training import find_device, limited_threads


def train_network(
    samples: Sequence[Sample], *, n_classes: int, parameters: TrainingParameters | None = None,
    network: PSPNet | None = None,
) -> tuple[PSPNet, list[float]]:  # fmt: skip
    """Train a PSPNet.

    Parameters
    ----------
    samples : sequence of (ndarray, ndarray)
        Images and labels; each is taken from the sequence when it is needed, so it may read them from files.
    n_classes : int
        Number of classes.
    parameters : TrainingParameters, optional
        How; the defaults where none are given.
    network : PSPNet, optional
        A network to go on with, such as one of published weights; it is changed. A new one by default.

    Returns
    -------
    network : PSPNet
        The network, ready to predict.
    losses : list of float
        Loss of every step.

    Raises
    ------
    DataError
        If there are no images, an image and its labels differ in size, or a label is outside -1 to ``n_classes - 1``.
    ParameterError
        If `network` has another number of classes.
    """
    how = TrainingParameters() if parameters is None else parameters
    crops = Crops(samples, n_classes, how, np.round(MEAN).astype(int).tolist())
    torch.manual_seed(how.random_state)
    model = PSPNet(n_classes, backbone=how.backbone, dropout=how.dropout) if network is None else network
    if model.n_classes != n_classes:
        raise ParameterError(f"the network has {model.n_classes} classes, not {n_classes}")
    device = find_device("auto")
    model.to(device).to(memory_format=torch.channels_last).train()  # type: ignore[call-overload]  # not in its types
    weights = _class_weights(crops.shares, how.class_balance).to(device)
    optimiser = _optimiser(model, how)
    schedule = torch.optim.lr_scheduler.LambdaLR(
        optimiser, lambda step: min(1.0, (step + 1) / how.warm_up) * (1 - step / how.n_steps) ** how.power
    )
    losses = []
    with limited_threads(how.n_threads):
        for images, labels in crops.batches(np.random.default_rng(how.random_state)):
            given = network_input(images).to(device)
            with torch.autocast(device.type, torch.bfloat16, enabled=_in_bfloat16(how.precision, device)):
                main, auxiliary = model(given)
            loss = _loss(main.float(), auxiliary.float(), torch.from_numpy(labels).to(device), weights, how)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            losses.append(float(loss.detach()))
    return model.to("cpu").to(memory_format=torch.contiguous_format).eval(), losses  # type: ignore[call-overload]  # as above


def _in_bfloat16(precision: str, device: torch.device) -> bool:
    """Say whether products are taken in bfloat16: where asked for, or where the processor has instructions for it."""
    if precision != "auto":
        return precision == "bfloat16"
    able = torch.cpu.get_capabilities()
    return device.type == "cuda" or bool(able.get("avx512_bf16") or able.get("amx_bf16"))


def _class_weights(shares: NDArray[np.float64], balance: float) -> Tensor:
    """Return weights of classes: a power of their inverse frequency, 1 on average over pixels; 0 for absent ones."""
    weights = np.where(shares > 0, np.maximum(shares, 1e-5) ** -balance, 0.0)
    return torch.from_numpy((weights / max((weights * shares).sum(), 1e-12)).astype(np.float32))


def _optimiser(model: PSPNet, how: TrainingParameters) -> torch.optim.Optimizer:
    if how.optimiser == "sgd":
        return torch.optim.SGD(
            model.parameters(), how.learning_rate, momentum=how.momentum, weight_decay=how.weight_decay, nesterov=True
        )
    # Decay keeps kernels small; offsets and scales of the normalisation are left alone.
    kernels = [weight for weight in model.parameters() if weight.ndim > 1]
    others = [weight for weight in model.parameters() if weight.ndim <= 1]
    groups = [{"params": kernels, "weight_decay": how.weight_decay}, {"params": others, "weight_decay": 0.0}]
    return torch.optim.AdamW(groups, how.learning_rate)


def _loss(main: Tensor, auxiliary: Tensor, labels: Tensor, weights: Tensor, how: TrainingParameters) -> Tensor:
    wanted = _thinned(labels, main)
    logarithms = functional.log_softmax(main, dim=1)
    loss = functional.nll_loss(logarithms, wanted, weights, ignore_index=-1)
    if how.overlap_weight:
        loss = loss + how.overlap_weight * overlap_loss(logarithms.exp(), wanted)
    if how.auxiliary_weight:
        rest = functional.cross_entropy(auxiliary, _thinned(labels, auxiliary), weights, ignore_index=-1)
        loss = loss + how.auxiliary_weight * rest
    return loss


def _thinned(labels: Tensor, like: Tensor) -> Tensor:
    """Return the labels of as many rows and columns as a head has, evenly spaced from the first on."""
    if like.shape[2:] == labels.shape[1:]:
        return labels
    return functional.interpolate(labels[:, None].float(), like.shape[2:])[:, 0].long()


def overlap_loss(probabilities: Tensor, labels: Tensor) -> Tensor:
    """Return 1 less the mean IoU of the classes that a batch shows, with probabilities in place of decisions.

    Parameters
    ----------
    probabilities : Tensor of shape (images, classes, height, width)
        Of the classes.
    labels : Tensor of int64, shape (images, height, width)
        Labels; pixels of -1 do not count.

    Returns
    -------
    Tensor
        The loss, 0 to 1; 0 where no pixel is labelled.

    References
    ----------
    .. [1] M. A. Rahman, Y. Wang, "Optimizing intersection-over-union in deep neural networks for image segmentation",
       ISVC, 2016.
    """
    counted = labels >= 0
    n_classes = probabilities.shape[1]
    known = labels.clamp(min=0)
    size = torch.bincount(known.flatten(), counted.flatten().float(), n_classes)
    own = probabilities.gather(1, known[:, None])[:, 0] * counted
    shared = torch.zeros(n_classes, device=own.device).index_add(0, known.flatten(), own.flatten())
    covered = (probabilities if counted.all() else probabilities * counted[:, None]).sum(dim=(0, 2, 3))
    shown = size > 0
    if not shown.any():
        return covered.sum() * 0
    return 1 - (shared / (size + covered - shared))[shown].mean()
