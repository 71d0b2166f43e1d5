"""The image network on simulated images of unseen streets: mean IoU of the small backbone, times of training and use.

Run as ``python benchmarks/image_network.py [--streets N] [--threads N] [--steps N] [--magnification FACTORS]
[--development] [--weights FILE] [--images FOLDER] [--time]``. The network learns the images of ``--streets`` towns,
every second of which has more people, bicycles, signs and furniture than others, and is scored on three ordinary towns.
``--development`` scores it on other streets, on which its settings were chosen. ``--images`` keeps the training images
in a folder; ``--weights`` keeps the network in a file and reads it from there the next time, also from the study of
tomic2019, which learns the same images. ``--time`` takes the time of 60 steps, on random images, and does nothing else.
"""

import argparse
import json
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.cityscapes import (
    encode_label_image,
    image_classes,
    segmentation_table,
)
from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.papers.tomic2019.image_labels.crops import Sample
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet import PSPNet
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet_training import train_network
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet_weights import from_arrays, to_arrays
from mlsroad_pipeline.papers.tomic2019.image_labels.segmentation import segment_image
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import TrainingParameters
from mlsroad_pipeline.simulation import PRESETS, SimulationParameters, simulate_survey
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS

TRAINING, DEVELOPMENT, TEST = 3001, (4001, 4002, 4003, 4004, 4005, 4006), (5001, 5002, 5003)
"""Seeds: the first street of training, streets on which settings are chosen, streets on which they are scored."""

SIZE = {"image_width": 960, "image_height": 720}
"""Of the images. A sixth of the pixels of the paper's cameras."""

NETWORK, MAGNIFICATION = {"scale": (0.5, 1.1)}, (0.7, 0.9)
"""Changes of the defaults, which suit images of half that width."""

RICH = replace(STREETS["town"], people=3.0, two_wheelers=3.0, clutter=2.0, signs=2.0)
"""A town with more of what is rare."""


def scheme_of(name: str = "tomic2019") -> ClassScheme:
    """Return a class scheme of the configuration."""
    schemes = yaml.safe_load((Path(__file__).parents[1] / "conf/base/parameters_classes.yml").read_text())
    return ClassScheme.from_config(name, schemes["classes"]["schemes"][name])


def photographed(seed: int, *, interval: float = 12.0, rich: bool = False) -> SimulationParameters:
    """Return a street of 80 m that is hardly scanned, but photographed."""
    small = replace(PRESETS["small"], seed=seed, image_interval=interval, profile_rate=10.0, pulse_rate=1000.0, **SIZE)
    return replace(small, street=RICH) if rich else small


def images_of(parameters: SimulationParameters, scheme: ClassScheme) -> list[Sample]:
    """Return a street's images and their labels."""
    survey = simulate_survey(parameters, n_threads=1)
    return [(image.rgb, encode_label_image(image.label, scheme).astype(np.int8)) for image in survey.images]


def training_images(n_streets: int, scheme: ClassScheme, folder: Path | None = None) -> list[Sample]:
    """Return the images of the streets of training, from a folder where they are there already."""
    samples: list[Sample] = []
    for number in range(n_streets):
        file = None if folder is None else folder / f"{TRAINING + number}.npz"
        if file is None or not file.is_file():
            taken = images_of(photographed(TRAINING + number, interval=10.0, rich=number % 2 == 1), scheme)
            if file is not None:
                file.parent.mkdir(parents=True, exist_ok=True)
                np.savez(file, rgb=np.stack([rgb for rgb, _ in taken]), label=np.stack([mark for _, mark in taken]))
        else:
            with np.load(file, allow_pickle=False) as arrays:
                taken = list(zip(arrays["rgb"], arrays["label"], strict=True))
        samples += taken
    return samples


def trained(samples: list[Sample], n_classes: int, parameters: TrainingParameters) -> PSPNet:
    """Return a network trained on images, and print what it took."""
    wall, spent = time.perf_counter(), time.process_time()
    network, losses = train_network(samples, n_classes=n_classes, parameters=parameters)
    wall, spent = time.perf_counter() - wall, time.process_time() - spent
    print(f"{len(samples)} images, {parameters.n_steps} steps, loss {np.mean(losses[-100:]):.3f}")
    print(f"training: {wall:.0f} s, {spent:.0f} s of CPU, {parameters.n_threads} threads", flush=True)
    return network


def time_steps(n_classes: int, n_threads: int) -> None:
    """Print what a step of training takes, without what the first steps take once."""
    rng = np.random.default_rng(0)
    shape = (SIZE["image_height"], SIZE["image_width"])
    blocks = [rng.integers(0, n_classes, (shape[0] // 24, shape[1] // 24), dtype=np.int8) for _ in range(8)]
    samples: list[Sample] = [
        (rng.integers(0, 256, (*shape, 3), dtype=np.uint8), np.kron(block, np.ones((24, 24), np.int8)))
        for block in blocks
    ]
    taken = []
    for steps in (10, 70):
        wall = time.perf_counter()
        train_network(
            samples, n_classes=n_classes, parameters=TrainingParameters(n_steps=steps, n_threads=n_threads, **NETWORK)
        )
        taken.append(time.perf_counter() - wall)
    print(f"{(taken[1] - taken[0]) / 60:.4f} s a step, {n_threads} threads")


def confusion(network: PSPNet, samples: Iterable[Sample], magnification: Sequence[float]) -> NDArray[np.int64]:
    """Return the confusion of images' pixels."""
    n = network.n_classes
    matrix = np.zeros((n, n + 1), dtype=np.int64)
    for rgb, labels in samples:
        given = segment_image(network, rgb, magnification=magnification).argmax(axis=2)
        matrix += confusion_matrix(labels.ravel().astype(np.int64), given.ravel(), n)
    return matrix


def main() -> None:
    """Train and score."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--streets", type=int, default=24)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--steps", type=int, default=TrainingParameters.n_steps)
    parser.add_argument("--magnification", type=float, nargs="+", default=MAGNIFICATION)
    parser.add_argument("--development", action="store_true")
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--images", type=Path)
    parser.add_argument("--time", action="store_true")
    options = parser.parse_args()
    scheme = scheme_of()
    classes = image_classes(scheme)
    if options.time:
        time_steps(len(classes), options.threads)
        return
    if options.weights is not None and options.weights.is_file():
        with np.load(options.weights, allow_pickle=False) as arrays:
            network = from_arrays(dict(arrays), n_classes=len(classes), backbone="small")
    else:
        samples = training_images(options.streets, scheme, options.images)
        how = TrainingParameters(n_steps=options.steps, n_threads=options.threads, **NETWORK)
        network = trained(samples, len(classes), how)
        if options.weights is not None:
            np.savez(options.weights, **to_arrays(network))
    total = np.zeros((len(classes), len(classes) + 1), dtype=np.int64)
    for seed in DEVELOPMENT if options.development else TEST:
        samples = images_of(photographed(seed), scheme)
        spent = time.process_time()
        matrix = confusion(network, samples, options.magnification)
        spent = (time.process_time() - spent) / len(samples)
        total += matrix
        mean = float(segmentation_table(matrix, classes)["iou"].iloc[-1])
        row = {"stage": "image_network", "street": seed, "images": len(samples), "mean_iou": mean, "seconds": spent}
        print(json.dumps(row), flush=True)
    print(segmentation_table(total, classes).to_string(index=False))


if __name__ == "__main__":
    main()
