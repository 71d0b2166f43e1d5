"""Networks on a GPU: time of training and prediction compared with threads of a CPU, memory, and equality of results.

    python benchmarks/gpu.py --prepare FILE                 # simulates six streets; writes the data (minutes)
    python benchmarks/gpu.py --data FILE [--dry] [--only NAME ...] [--threads N] [--limit SECONDS]

Networks are trained from the same seed and data on both devices, in float32 and bfloat16, and predict with the same
weights. `--dry` runs tiny sizes on the CPU in place of a GPU. `wait`: mean time per step waiting for a batch.
"""

from __future__ import annotations

import json
import os
import platform
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import torch
from _common import configured, configured_scheme, configured_stages, parser
from numpy.typing import NDArray
from run_all import processor

from mlsroad_pipeline.algorithms.cameras.cityscapes import encode_label_image, image_classes
from mlsroad_pipeline.algorithms.models.machines import torch_training
from mlsroad_pipeline.algorithms.models.superpoint_transformer import training
from mlsroad_pipeline.algorithms.models.superpoint_transformer.graph import SuperpointGraph
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inputs import even_points, prepare_inputs
from mlsroad_pipeline.algorithms.models.superpoint_transformer.labeller import prepare
from mlsroad_pipeline.algorithms.models.superpoint_transformer.network import to_tensors
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import SuperpointTransformerParameters
from mlsroad_pipeline.algorithms.models.superpoint_transformer.training_graphs import training_graphs
from mlsroad_pipeline.papers.luo2019.jointnet import training as jointnet_training
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import JointNetParameters
from mlsroad_pipeline.papers.luo2019.jointnet.recogniser import JointNetRecogniser
from mlsroad_pipeline.papers.tomic2019.image_labels import pspnet_training
from mlsroad_pipeline.papers.tomic2019.image_labels.segmentation import segment_image
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import TrainingParameters
from mlsroad_pipeline.simulation import PRESETS, simulate_survey
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS

TRAIN, TEST = (3001, 3002, 3003, 3004), (4001, 4002)
"""Seeds of the streets."""
LEAST, MOST, EACH, IMAGES = 30, 250, 10, 4
"""Least and most points of an object, least number of training objects of a class, images of a street."""
REACH = {TRAIN[0]: 20.0, TEST[0]: 15.0}
"""Radius of the scenes whose superpoints are taken, metres."""
WARM_UP, REPEATS, EVERY = 3, 5, 3
"""Steps left out of the median, timed predictions, and pixels along each side of which one is compared."""
GPU = ("gpu",)
SCHEME = "tomic2019"

Data = dict[bool, dict[str, list[Any]]]
"""Objects, images and superpoints by whether they are of test streets."""


def make_data(file: Path) -> None:
    """Simulate the streets and write objects, images and superpoints of training and of test streets."""
    scheme = configured_scheme(SCHEME)
    rich = replace(STREETS["town"], people=3.0, two_wheelers=3.0, clutter=2.0, signs=2.0)
    data: Data = {test: {"objects": [], "images": [], "graphs": []} for test in (False, True)}
    for seed in (*TRAIN, *TEST):
        survey = simulate_survey(replace(PRESETS["small"], seed=seed, street=rich, image_interval=16.0))
        found = data[seed in TEST]
        found["objects"] += instances(survey.cloud, seed)
        for i in np.linspace(0, len(survey.images) - 1, IMAGES).astype(int).tolist():
            image = survey.images[i]
            found["images"].append((image.rgb, encode_label_image(image.label, scheme).astype(np.int16)))
        if seed in REACH:
            found["graphs"].append(graph_of(survey.cloud, REACH[seed]))
    common = np.bincount([label for *_, label in data[False]["objects"]], minlength=256) >= EACH
    for found in data.values():
        found["objects"] = [one for one in found["objects"] if common[one[2]]]
    joblib.dump(data, file, compress=3)
    print(f"{file}: {file.stat().st_size / 2**20:.2f} MiB")


def instances(cloud: Any, seed: int) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64], int]]:
    """Yield the points, intensities and classes of the objects of a street, subsampled."""
    rng, order = np.random.default_rng(seed), np.argsort(cloud["instance"], kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(cloud["instance"][order])) + 1):
        if len(rows) >= LEAST and cloud["instance"][rows[0]]:
            drawn = np.sort(rng.permutation(rows)[:MOST])
            xyz = cloud.xyz[drawn].astype(np.float64)
            yield xyz - xyz.mean(axis=0), cloud["intensity"][drawn].astype(np.float64), int(cloud["label"][rows[0]])


def graph_of(cloud: Any, reach: float) -> dict[str, NDArray[Any]]:
    """Return the superpoints of the middle of a street."""
    stages, given = configured_stages(detrend=False), SuperpointTransformerParameters(augmentation={"cuts": 0})
    middle = np.median(cloud.xyz[:, :2], axis=0)
    scene = cloud.select(np.flatnonzero(np.linalg.norm(cloud.xyz[:, :2] - middle, axis=1) < reach))
    options = {"parameters": given, "stages": stages, "scheme": configured_scheme(SCHEME)}
    return training_graphs(scene, *prepare(scene, stages), **options)["scanned"]


@dataclass(frozen=True)
class Setting:
    """A training: batch size, steps (epochs of recognisers), precision, devices."""

    batch: int
    steps: int
    precision: str = "float32"
    on: tuple[str, ...] = ("cpu", "gpu")

    def __str__(self) -> str:
        """Return the settings for a table."""
        return f"batch {self.batch}, {self.steps} x, {self.precision}"


@dataclass
class Clock:
    """Seconds of steps, and of waiting before each of them."""

    steps: list[float] = field(default_factory=list)
    waits: list[float] = field(default_factory=list)
    last: float | None = None

    def step(self, run: Callable[..., Any], *args: Any) -> Any:
        """Run and time a step."""
        start = seconds_now()
        self.waits.append(0.0 if self.last is None else start - self.last)
        result = run(*args)
        self.last = seconds_now()
        self.steps.append(self.last - start)
        return result

    def between(self, batches: Iterator[Any]) -> Iterator[Any]:
        """Yield batches; the time until the next one is requested is that of a step."""
        start = time.perf_counter()
        for batch in batches:
            given = time.perf_counter()
            yield batch
            self.waits.append(given - start)
            start = seconds_now()
            self.steps.append(start - given)


@dataclass(frozen=True)
class Case:
    """A network: its training, class probabilities of data it was not trained on, their true columns (-1: unknown)."""

    name: str
    train: Callable[[Setting, str, Clock], Any]
    predict: Callable[[Any, str], NDArray[Any]]
    truth: NDArray[Any]
    settings: list[Setting]
    mixed: bool
    """Whether it predicts in bfloat16 too."""
    networks: Callable[[Any], list[torch.nn.Module]]


def seconds_now() -> float:
    """Wait until the GPU has finished; return the time."""
    if torch.cuda.is_initialized():
        torch.cuda.synchronize()
    return time.perf_counter()


@contextmanager
def replaced(owner: Any, name: str, wrap: Callable[[Any], Any]) -> Iterator[None]:
    """Replace a function while a network is trained."""
    kept = getattr(owner, name)
    setattr(owner, name, wrap(kept))
    try:
        yield
    finally:
        setattr(owner, name, kept)


def jointnet(data: Data, dry: bool) -> Case:
    """Return the case of JointNet; it predicts objects of other streets."""
    base = JointNetParameters(**configured("jointnet"))
    parts = (data[of]["objects"][: 60 if dry else None] for of in (False, True))
    (xyz, intensity, label), (seen, brightness, true) = (zip(*part, strict=True) for part in parts)

    def train(setting: Setting, device: str, clock: Clock) -> Any:
        how = replace(
            base.training, epochs=setting.steps, batch_size=setting.batch, device=device, n_members=1,
            regression_share=0.0, mixed_precision=setting.precision == "bfloat16",
        )  # fmt: skip
        with replaced(jointnet_training._Run, "_step", lambda step: lambda *args: clock.step(step, *args)):
            model = JointNetRecogniser(replace(base, training=how))
            return model.fit(list(xyz), np.array(label), intensities=list(intensity))

    def predict(model: Any, device: str) -> NDArray[Any]:
        for network in model.networks_:
            network.to(device)
        return model.predict_proba(list(seen), intensities=list(brightness))

    classes = np.unique(label)
    truth = np.where(np.isin(true, classes), np.searchsorted(classes, true), -1)
    settings = [Setting(32, 6), Setting(32, 6, "bfloat16", GPU), Setting(256, 6), Setting(256, 6, "bfloat16", GPU)]
    return Case("jointnet", train, predict, truth, small(settings, dry), True, lambda model: model.networks_)


def image_network(data: Data, dry: bool) -> Case:
    """Return the case of the image network; it predicts images of other streets."""
    base = TrainingParameters(**configured("image_labels")["network"])
    samples, test = (data[of]["images"][: 2 if dry else None] for of in (False, True))
    n_classes = len(image_classes(configured_scheme(SCHEME)))

    def train(setting: Setting, device: str, clock: Clock) -> Any:
        how = replace(
            base, n_steps=setting.steps, batch_size=setting.batch, precision=setting.precision,
            n_threads=torch.get_num_threads(), **({"crop": 64} if dry else {}),
        )  # fmt: skip
        with replaced(pspnet_training, "_ahead", lambda ahead: lambda batches: clock.between(ahead(batches))):
            return pspnet_training.train_network(samples, n_classes=n_classes, parameters=how, device=device)[0]

    def predict(model: Any, device: str) -> NDArray[Any]:
        model.to(device)
        found = [segment_image(model, rgb, n_threads=torch.get_num_threads()) for rgb, _ in test]
        return np.concatenate([each[::EVERY, ::EVERY].reshape(-1, each.shape[2]) for each in found])

    truth = np.concatenate([labels[::EVERY, ::EVERY].ravel() for _, labels in test]).astype(np.int64)
    settings = [Setting(6, 12, how) for how in ("float32", "bfloat16")]
    settings += [Setting(64, 8, how, GPU) for how in ("float32", "bfloat16")]
    return Case("image_network", train, predict, truth, small(settings, dry), True, lambda model: [model])


def superpoint_transformer(data: Data, dry: bool) -> Case:
    """Return the case of the superpoint transformer; it predicts the superpoints of another street."""
    base = SuperpointTransformerParameters(**configured("superpoint_transformer"))
    graphs, (test, *_) = ([SuperpointGraph.from_arrays(one) for one in data[of]["graphs"]] for of in (False, True))

    def train(setting: Setting, device: str, clock: Clock) -> Any:
        how = replace(base.training, n_steps=setting.steps, batch_size=setting.batch, device=device)
        how = replace(base, training=replace(how, n_threads=torch.get_num_threads()))
        with replaced(training, "_ahead", lambda ahead: lambda *args: clock.between(ahead(*args))):
            return training.train_network(graphs, n_classes=len(configured_scheme(SCHEME)), parameters=how)

    def predict(model: Any, device: str) -> NDArray[Any]:
        inputs = prepare_inputs(test, model.scale, even_points(test, base.training.n_points))
        with torch.inference_mode():
            scores = model.network.to(device)(to_tensors(inputs, torch.device(device)))[0]
            return torch.softmax(scores, dim=1).cpu().numpy()

    histogram = test.levels[0].histogram
    truth = np.where(histogram.sum(axis=1) > 0, histogram.argmax(axis=1), -1)
    settings = small([Setting(4, 15), Setting(16, 4)], dry)
    return Case("superpoint_transformer", train, predict, truth, settings, False, lambda model: [model.network])


CASES = {case.__name__: case for case in (jointnet, image_network, superpoint_transformer)}


def small(settings: list[Setting], dry: bool) -> list[Setting]:
    """Return the settings, or tiny ones."""
    return [replace(s, batch=min(s.batch, 4), steps=min(s.steps, 2)) for s in settings] if dry else settings


def report(**row: Any) -> None:
    """Print a line of JSON."""
    print(json.dumps(row), flush=True)


def train_all(case: Case, devices: dict[str, str], late: float) -> Any:
    """Train with each setting on each device; return the model of the first setting on the last device."""
    kept = None
    for number, setting in enumerate(case.settings):
        medians: dict[str, float] = {}
        for place in setting.on:
            if time.perf_counter() > late:
                report(case=case.name, setting=str(setting), device=place, skipped="no time left")
                continue
            model, medians[place] = train_once(case, setting, place, devices[place])
            kept = model if number == 0 else kept
        if len(medians) == 2:
            report(case=case.name, setting=str(setting), steps_cpu_to_gpu=medians["cpu"] / medians["gpu"])
    return kept


def train_once(case: Case, setting: Setting, place: str, device: str) -> tuple[Any, float]:
    """Train once; report times, memory and scores."""
    clock = Clock()
    if device == "cuda":
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats()
    start = time.perf_counter()
    model = case.train(setting, device, clock)
    seconds = seconds_now() - start
    memory = torch.cuda.max_memory_allocated() / 2**20 if device == "cuda" else 0
    weights = sum(weight.numel() for network in case.networks(model) for weight in network.parameters())
    first = min(WARM_UP, len(clock.steps) - 1)
    median, wait = float(np.median(clock.steps[first:])), float(np.mean(clock.waits[min(1, first) :]))
    right, known = case.predict(model, device).argmax(axis=1) == case.truth, case.truth >= 0
    recall = float(np.mean([right[case.truth == c].mean() for c in np.unique(case.truth[known])]))
    report(
        case=case.name, setting=str(setting), device=place, weights=weights, step_ms=1000 * median,
        wait_ms=1000 * wait, steps=len(clock.steps), training_s=seconds, gpu_peak_mib=memory,
        accuracy=float(right[known].mean()), mean_recall=recall,
    )  # fmt: skip
    return model, median


def predict_all(case: Case, model: Any, devices: dict[str, str]) -> None:
    """Predict with the same weights on both devices and report times and differences."""
    base, slow = timed_prediction(case, model, devices["cpu"], 2)
    report(case=case.name, prediction="cpu float32", rows=len(base), seconds=slow)
    ways = [("gpu, PyTorch's defaults", True, nullcontext), ("gpu, float32 without TF32", False, nullcontext)]
    if case.mixed:
        ways.append(("gpu, bfloat16", True, lambda: torch.autocast(devices["gpu"], torch.bfloat16)))
    for name, rounded, context in ways:
        torch.backends.cudnn.allow_tf32 = rounded
        try:
            with context():
                found, fast = timed_prediction(case, model, devices["gpu"], REPEATS)
        finally:
            torch.backends.cudnn.allow_tf32 = True
        difference = np.abs(found.astype(np.float64) - base)
        report(
            case=case.name, prediction=name, seconds=fast, cpu_to_gpu=slow / fast,
            largest_difference=float(difference.max()), mean_difference=float(difference.mean()),
            equal_classes=float((found.argmax(axis=1) == base.argmax(axis=1)).mean()),
        )  # fmt: skip


def timed_prediction(case: Case, model: Any, device: str, repeats: int) -> tuple[NDArray[Any], float]:
    """Return probabilities and the median time, after a first prediction."""
    found, taken = case.predict(model, device), []
    for _ in range(repeats):
        start = time.perf_counter()
        found = case.predict(model, device)
        taken.append(seconds_now() - start)
    return found, float(np.median(taken))


def main() -> int:
    """Prepare the data, or train and predict; end with status 1 if a network failed."""
    arguments = parser(__doc__)
    arguments.add_argument("--prepare", type=Path, metavar="FILE")
    arguments.add_argument("--data", type=Path, metavar="FILE")
    arguments.add_argument("--dry", action="store_true")
    arguments.add_argument("--only", nargs="+", choices=CASES, default=list(CASES))
    arguments.add_argument("--threads", type=int, default=2)
    arguments.add_argument("--limit", type=float, default=150.0, help="seconds after which no training starts")
    options = arguments.parse_args()
    if options.prepare is not None:
        make_data(options.prepare)
        return 0
    if options.data is None:
        arguments.error("give --data FILE, which --prepare FILE writes")
    late, failed = time.perf_counter() + options.limit, False
    devices = {"cpu": "cpu", "gpu": "cpu" if options.dry else "cuda"}
    gpu = "none" if options.dry else torch.cuda.get_device_name()
    report(gpu=gpu, cpu=processor(), cpu_cores=os.cpu_count(), threads=options.threads)
    report(python=platform.python_version(), torch=torch.__version__, numpy=np.__version__)
    data = joblib.load(options.data)
    torch.set_num_threads(options.threads)
    # Trainings that use one thread, for results that do not depend on the number, get all of them.
    with replaced(torch_training, "limited_threads", lambda _: nullcontext):
        for name in options.only:
            try:
                case = CASES[name](data, options.dry)
                model = train_all(case, devices, late)
                if model is not None:
                    predict_all(case, model, devices)
            except Exception:  # reported; the other networks are measured
                failed = True
                report(case=name, failed=traceback.format_exc()[-400:])
    return int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
