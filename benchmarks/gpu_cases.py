"""Networks of the benchmark on a GPU: how each is trained and predicts, and with which settings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from gpu_data import Data
from gpu_trial import Case, Clock, Setting
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.models.superpoint_transformer import optimisation
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inputs import even_points, prepare_inputs
from mlsroad_pipeline.algorithms.models.superpoint_transformer.network import to_tensors
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import SuperpointTransformerParameters
from mlsroad_pipeline.papers.luo2019.jointnet import training as jointnet_training
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import JointNetParameters
from mlsroad_pipeline.papers.luo2019.jointnet.recogniser import JointNetRecogniser
from mlsroad_pipeline.papers.luo2019.pointnet.parameters import PointNetParameters
from mlsroad_pipeline.papers.luo2019.pointnet.recogniser import PointNetRecogniser
from mlsroad_pipeline.papers.tomic2019.image_labels import pspnet_training
from mlsroad_pipeline.papers.tomic2019.image_labels.segmentation import segment_image
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import TrainingParameters

PAPER_SIZE = {
    "n_hidden": 4096, "map_channels": 64, "fusion_widths": [64, 64], "cnn3_widths": [64, 64, 128, 192],
}  # fmt: skip
"""Two fully connected layers of 4,096 in the convolutional module: 28 million weights with three views."""

EVERY = 3
"""One pixel in so many along each side is compared."""

GPU = ("gpu",)


@contextmanager
def timed(owner: Any, name: str, wrap: Callable[[Any], Any]) -> Iterator[None]:
    """Replace a function by one that takes its time."""
    kept = getattr(owner, name)
    setattr(owner, name, wrap(kept))
    try:
        yield
    finally:
        setattr(owner, name, kept)


def around(clock: Clock) -> Callable[[Any], Any]:
    """Return what times the calls of a function."""
    return lambda function: lambda *args: clock.step(function, *args)


def configured(name: str) -> dict[str, Any]:
    """Return parameters of the configuration."""
    file = Path(__file__).parents[1] / f"conf/base/parameters_{name}.yml"
    found: dict[str, Any] = yaml.safe_load(file.read_text(encoding="utf-8"))[name]
    return found


def small(settings: list[Setting], dry: bool) -> list[Setting]:
    """Return the settings, or tiny ones."""
    if not dry:
        return settings
    return [replace(s, batch=min(s.batch, 4), steps=min(s.steps, 2), other={**s.other}) for s in settings]


def recognition(
    data: Data, name: str, settings: list[Setting], mixed: bool,
    train: Callable[[Setting, str, Clock, Any], Any], networks: Callable[[Any], list[Any]],
) -> Case:  # fmt: skip
    """Return the case of a recogniser of objects."""
    objects, test = data.objects(test=False), data.objects(test=True)
    classes = np.unique(objects[2])
    truth = np.searchsorted(classes, test[2])

    def predict(model: Any, device: str) -> NDArray[Any]:
        for network in networks(model):
            network.to(device)
        kept = {"intensities": test[1]} if isinstance(model, JointNetRecogniser) else {}
        found: NDArray[Any] = model.predict_proba(test[0], **kept)
        return found

    return Case(
        name, lambda setting, device, clock: train(setting, device, clock, objects), predict, truth, settings, mixed,
        lambda model: sum(map(n_weights, networks(model))),
    )  # fmt: skip


def jointnet(
    data: Data, dry: bool, *, name: str, method: str, network: dict[str, Any], settings: list[Setting]
) -> Case:
    """Return the case of JointNet with the parameters of a method and changes of its layers."""
    base = JointNetParameters(**configured(method))
    base = replace(base, network=replace(base.network, **network))

    def train(setting: Setting, device: str, clock: Clock, objects: Any) -> Any:
        how = replace(
            base.training, epochs=setting.steps, batch_size=setting.batch, device=device, n_members=1,
            regression_share=0.0, mixed_precision=setting.precision == "bfloat16", **setting.other,
        )  # fmt: skip
        model = JointNetRecogniser(replace(base, training=how))
        with timed(jointnet_training._Run, "_step", around(clock)):
            return model.fit(objects[0], objects[2], intensities=objects[1])

    return recognition(data, name, small(settings, dry), True, train, lambda model: model.networks_)


def pointnet(data: Data, dry: bool) -> Case:
    """Return the case of PointNet."""
    base = PointNetParameters(**configured("pointnet"))

    def train(setting: Setting, device: str, clock: Clock, objects: Any) -> Any:
        how = replace(base, epochs=setting.steps, batch_size=setting.batch, device=device)
        model = PointNetRecogniser(how)
        with timed(PointNetRecogniser, "_step", around(clock)):
            return model.fit(objects[0], objects[2])

    settings = small([Setting(32, 6), Setting(256, 6)], dry)
    return recognition(data, "pointnet", settings, False, train, lambda model: [model.network_])


def images(data: Data, dry: bool, *, name: str, base: TrainingParameters, settings: list[Setting], seen: int) -> Case:
    """Return the case of a network for images; it predicts some of the images of other streets."""
    samples, test = data.images(test=False), data.images(test=True)
    test = [test[i] for i in np.linspace(0, len(test) - 1, min(seen, len(test))).astype(int)]

    def train(setting: Setting, device: str, clock: Clock) -> Any:
        how = replace(
            base, n_steps=setting.steps, batch_size=setting.batch, precision=setting.precision,
            n_threads=torch.get_num_threads(), **({"crop": 64} if dry else setting.other),
        )  # fmt: skip
        with timed(pspnet_training, "_ahead", lambda function: lambda batches: clock.between(function(batches))):
            return pspnet_training.train_network(
                samples, n_classes=data.n_pixel_classes, parameters=how, device=device
            )[0]

    def predict(model: Any, device: str) -> NDArray[Any]:
        model.to(device)
        found = [segment_image(model, rgb, n_threads=torch.get_num_threads()) for rgb, _ in test]
        return np.concatenate([each[::EVERY, ::EVERY].reshape(-1, each.shape[2]) for each in found])

    truth = np.concatenate([labels[::EVERY, ::EVERY].ravel() for _, labels in test]).astype(np.int64)
    return Case(name, train, predict, truth, small(settings, dry), True, n_weights)


def n_weights(network: torch.nn.Module) -> int:
    """Return the number of weights of a network."""
    return sum(weight.numel() for weight in network.parameters())


def superpoints(data: Data, dry: bool) -> Case:
    """Return the case of the superpoint transformer; it predicts the superpoints of another street."""
    base = SuperpointTransformerParameters(**configured("superpoint_transformer"))
    graphs, test = data.graphs(test=False), data.graphs(test=True)[0]

    def train(setting: Setting, device: str, clock: Clock) -> Any:
        how = replace(
            base.training, n_steps=setting.steps, batch_size=setting.batch, device=device,
            n_threads=torch.get_num_threads(),
        )  # fmt: skip
        with timed(optimisation, "_ahead", lambda function: lambda *args: clock.between(function(*args))):
            return optimisation.train_network(graphs, n_classes=data.n_classes, parameters=replace(base, training=how))

    def predict(model: Any, device: str) -> NDArray[Any]:
        inputs = prepare_inputs(test, model.scale, even_points(test, base.training.n_points))
        network = model.network.to(device)
        with torch.inference_mode():
            scores = network(to_tensors(inputs, torch.device(device)))[0]
            found: NDArray[Any] = torch.softmax(scores, dim=1).cpu().numpy()
        return found

    histogram = test.levels[0].histogram
    truth = np.where(histogram.sum(axis=1) > 0, histogram.argmax(axis=1), -1)
    settings = small([Setting(4, 15), Setting(16, 4)], dry)
    return Case(
        "superpoint_transformer", train, predict, truth, settings, False,
        lambda model: n_weights(model.network),
    )  # fmt: skip


def _jointnet_settings(epochs: int, long: int) -> list[Setting]:
    """Return trainings with the batch of the paper and a large one; `long` epochs on the GPU alone."""
    return [
        Setting(32, epochs), Setting(32, epochs, "bfloat16", GPU), Setting(256, epochs),
        Setting(256, epochs, "bfloat16", GPU), *([Setting(32, long, "float32", GPU)] if long else []),
    ]  # fmt: skip


def _jointnet(data: Data, dry: bool) -> Case:
    return jointnet(data, dry, name="jointnet", method="jointnet", network={}, settings=_jointnet_settings(6, 0))


def _jointnet_paper_size(data: Data, dry: bool) -> Case:
    network, settings = {} if dry else PAPER_SIZE, _jointnet_settings(2, 40)
    return jointnet(
        data, dry, name="jointnet_paper_size", method="jointnet_printed", network=network, settings=settings
    )


def _jointnet_printed(data: Data, dry: bool) -> Case:
    settings = _jointnet_settings(4, 40)
    return jointnet(data, dry, name="jointnet_printed", method="jointnet_printed", network={}, settings=settings)


def _image_network(data: Data, dry: bool) -> Case:
    base = TrainingParameters(**configured("image_labels")["network"])
    settings = [
        Setting(6, 12), Setting(6, 12, "bfloat16"), Setting(64, 8, "float32", GPU), Setting(64, 8, "bfloat16", GPU),
        Setting(6, 150, "bfloat16", GPU),
    ]  # fmt: skip
    return images(data, dry, name="image_network", base=base, settings=settings, seen=6)


def _pspnet(data: Data, dry: bool) -> Case:
    base = TrainingParameters(
        backbone="small" if dry else "resnet50", optimiser="sgd", momentum=0.9, weight_decay=1e-4, overlap_weight=0.0
    )
    large = {"crop": 713}
    settings = [
        Setting(2, 4), Setting(2, 10, "bfloat16", GPU), Setting(16, 6, "float32", GPU, large),
        Setting(16, 6, "bfloat16", GPU, large),
    ]  # fmt: skip
    return images(data, dry, name="pspnet_resnet50", base=base, settings=settings, seen=2)


CASES: dict[str, Callable[[Data, bool], Case]] = {
    "jointnet": _jointnet,
    "image_network": _image_network,
    "pspnet_resnet50": _pspnet,
    "jointnet_paper_size": _jointnet_paper_size,
    "pointnet": pointnet,
    "superpoint_transformer": superpoints,
    "jointnet_printed": _jointnet_printed,
}
"""Cases by name, in the order in which they run."""
