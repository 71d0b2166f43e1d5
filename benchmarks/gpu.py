"""Networks on a GPU: time of training and prediction beside two threads of a CPU, memory, and equality of results.

    python benchmarks/gpu.py --prepare FILE                 # simulates six streets; writes the data (minutes)
    python benchmarks/gpu.py --data FILE [--out JSON] [--dry] [--only NAME ...] [--threads N] [--limit SECONDS]

Each network is trained from the same seed and data on the CPU and on the GPU, in float32 and, where it offers that, in
bfloat16, with its batch size and with a larger one. The network of the GPU then predicts objects, superpoints or images
of other streets on both devices with the same weights. `--dry` runs tiny sizes on the CPU in place of a GPU. A step is
that of the network alone: forward, backward and update; `wait` is the mean time per step in which it waits for its
batch, which the CPU prepares. Only --prepare needs Kedro's dependencies.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gpu_data import Data, make_data
from gpu_trial import Case, Clock, Setting, synchronise
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.models.machines import torch_training

WARM_UP = 3
"""Steps left out of the median, in which libraries choose their kernels."""

REPEATS = 5
"""Timed predictions on the GPU, of which the median is taken; on the CPU there are two."""


class Report:
    """Printed lines, which are kept for the JSON file."""

    def __init__(self, file: Path | None, limit: float) -> None:
        self.file, self.limit, self.start = file, limit, time.perf_counter()
        self.rows: list[dict[str, Any]] = []

    @property
    def late(self) -> bool:
        """Return whether the time is over."""
        return time.perf_counter() - self.start > self.limit

    def add(self, **row: Any) -> None:
        """Print a line and write the file anew."""
        self.rows.append(row)
        shown = "  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items())
        print(f"[{time.perf_counter() - self.start:6.1f} s] {shown}", flush=True)
        if self.file is not None:
            self.file.write_text(json.dumps(self.rows, indent=1), encoding="utf-8")


def score(probabilities: NDArray[Any], truth: NDArray[Any]) -> dict[str, float]:
    """Return the accuracy and its mean over the true classes."""
    right, known = probabilities.argmax(axis=1) == truth, truth >= 0
    return {
        "accuracy": float(right[known].mean()),
        "mean_recall": float(np.mean([right[truth == c].mean() for c in np.unique(truth[known])])),
    }


def train_all(case: Case, devices: dict[str, str], report: Report) -> Any:
    """Train with each setting on each device; return the model of the first setting on the last device."""
    kept = None
    for number, setting in enumerate(case.settings):
        medians: dict[str, float] = {}
        for place in setting.on:
            if report.late:
                report.add(case=case.name, setting=str(setting), device=place, skipped="no time left")
                continue
            try:
                model, medians[place] = train_once(case, setting, place, devices[place], report)
            except Exception:  # one failure does not lose the others
                traceback.print_exc()
                report.add(case=case.name, setting=str(setting), device=place, failed=traceback.format_exc()[-400:])
                continue
            kept = model if number == 0 else kept
        if len(medians) == 2:
            report.add(case=case.name, setting=str(setting), steps_cpu_to_gpu=medians["cpu"] / medians["gpu"])
    return kept


def train_once(case: Case, setting: Setting, place: str, device: str, report: Report) -> tuple[Any, float]:
    """Train once; report times, memory and scores."""
    clock = Clock()
    if device == "cuda":
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats()
    start = time.perf_counter()
    model = case.train(setting, device, clock)
    synchronise()
    seconds = time.perf_counter() - start
    memory = torch.cuda.max_memory_allocated() / 2**20 if device == "cuda" else 0.0
    first = min(WARM_UP, len(clock.steps) - 1)
    median, wait = float(np.median(clock.steps[first:])), float(np.mean(clock.waits[min(1, first) :]))
    report.add(
        case=case.name, setting=str(setting), device=place, weights=case.n_weights(model), step_ms=1000 * median,
        wait_ms=1000 * wait, steps=len(clock.steps), training_s=seconds, gpu_peak_mib=memory,
        **score(case.predict(model, device), case.truth),
    )  # fmt: skip
    return model, median


def predict_all(case: Case, model: Any, devices: dict[str, str], report: Report) -> None:
    """Predict with the same weights on both devices and report times and differences."""
    base, slow = timed_prediction(case, model, devices["cpu"], 2)
    report.add(case=case.name, prediction="cpu float32", rows=len(base), seconds=slow)
    ways: list[tuple[str, bool, Any]] = [("gpu, PyTorch's defaults", True, nullcontext)]
    ways.append(("gpu, float32 without TF32", False, nullcontext))
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
        report.add(
            case=case.name, prediction=name, seconds=fast, cpu_to_gpu=slow / fast,
            largest_difference=float(difference.max()), mean_difference=float(difference.mean()),
            equal_classes=float((found.argmax(axis=1) == base.argmax(axis=1)).mean()),
        )  # fmt: skip


def repeat(case: Case, model: Any, devices: dict[str, str], report: Report) -> None:
    """Report whether a second training on the GPU gives the same bits, with deterministic convolutions if not."""

    def again() -> NDArray[Any]:
        return case.predict(case.train(case.settings[0], devices["gpu"], Clock()), devices["gpu"])

    first = case.predict(model, devices["gpu"])
    same = bool(np.array_equal(first, again()))
    report.add(case=case.name, repeated_training_equal=same)
    if not same:
        torch.backends.cudnn.deterministic = True
        try:
            same = bool(np.array_equal(again(), again()))
        finally:
            torch.backends.cudnn.deterministic = False
        report.add(case=case.name, repeated_training_equal_with_deterministic_cudnn=same)


def timed_prediction(case: Case, model: Any, device: str, repeats: int) -> tuple[NDArray[Any], float]:
    """Return probabilities and the median time, after a first prediction."""
    found, taken = case.predict(model, device), []
    for _ in range(repeats):
        start = time.perf_counter()
        found = case.predict(model, device)
        synchronise()
        taken.append(time.perf_counter() - start)
    return found, float(np.median(taken))


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Let trainings use several threads that otherwise use one, for results that do not depend on the number."""
    limited, torch_training.limited_threads = torch_training.limited_threads, nullcontext  # type: ignore[assignment]
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch_training.limited_threads = limited


def main() -> None:
    """Prepare the data, or train and predict."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--prepare", type=Path, metavar="FILE")
    parser.add_argument("--data", type=Path, metavar="FILE")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--dry", action="store_true")
    parser.add_argument("--only", nargs="+")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--limit", type=float, default=150.0, help="seconds after which no training starts")
    options = parser.parse_args()
    if options.prepare is not None:
        make_data(options.prepare)
        return
    if options.data is None:
        parser.error("--data FILE is needed; --prepare FILE writes it")
    report = Report(options.out, options.limit)
    devices = {"cpu": "cpu", "gpu": "cpu" if options.dry else "cuda"}
    describe(report, devices["gpu"], options.threads)
    from gpu_cases import CASES  # noqa: PLC0415  its imports are part of what may fail

    data = Data(options.data, tiny=options.dry)
    with threads(options.threads):
        for name, build in CASES.items():
            if options.only and name not in options.only:
                continue
            try:
                case = build(data, options.dry)
                model = train_all(case, devices, report)
                if model is not None:
                    predict_all(case, model, devices, report)
                    if not report.late:
                        repeat(case, model, devices, report)
            except Exception:  # as above
                traceback.print_exc()
                report.add(case=name, failed=traceback.format_exc()[-400:])
    report.add(finished=True)


def describe(report: Report, device: str, n_threads: int) -> None:
    """Report hardware and versions, and start the GPU."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown")
    flags = next((line for line in lines if line.startswith("flags")), "")
    gpu = torch.cuda.get_device_name() if device == "cuda" else "none"
    report.add(
        gpu=gpu, cpu=model, cpu_cores=os.cpu_count(), threads=n_threads, python=platform.python_version(),
        torch=torch.__version__, numpy=np.__version__, amx_bf16="amx_bf16" in flags, avx512_bf16="avx512_bf16" in flags,
        cudnn_tf32=torch.backends.cudnn.allow_tf32,
    )  # fmt: skip
    x = torch.randn(8, 3, 64, 64, device=device)
    torch.nn.functional.conv2d(x, torch.randn(8, 3, 3, 3, device=device)).sum().item()


if __name__ == "__main__":
    main()
