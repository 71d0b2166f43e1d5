"""Shared parts of the benchmarks: races, rows, memory, competing programs, configuration, recordings, commands."""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import psutil
import yaml
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import (
    FeatureParameters,
    GroundParameters,
    StageParameters,
    SupervoxelParameters,
)
from mlsroad_pipeline.algorithms.metrics.confusion import scores
from mlsroad_pipeline.algorithms.stages import build_supervoxels, describe_supervoxels, find_ground

REPOSITORY = Path(__file__).resolve().parents[1]
CONF = REPOSITORY / "conf"
RESULTS = REPOSITORY / "data/08_reporting"
DATA = Path(os.environ.get("MLSROAD_DATA", REPOSITORY.parent / "shared/data")).absolute()
"""Folder of the recordings."""
PANDASET = DATA / "real/pandaset/001/frames"
RIVALS = Path(os.environ.get("MLSROAD_RIVALS", "rivals_data"))
"""Folder of competing programs and their clouds."""


def parser(text: str | None) -> argparse.ArgumentParser:
    """Return a parser whose help is the docstring of a script."""
    return argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)


class Timed(NamedTuple):
    """Elapsed and processor seconds of a call, and its result."""

    seconds: float
    cpu: float
    result: Any = None


def clock(work: Callable[[], Any]) -> Timed:
    """Time a call; a call that times itself, such as one in another process, returns a `Timed`."""
    start, used = time.perf_counter(), time.process_time()
    result = work()
    if isinstance(result, Timed):
        return result
    return Timed(time.perf_counter() - start, time.process_time() - used, result)


def race(works: Mapping[str, Callable[[], Any]], *, repeats: int, warm_up: int = 0) -> dict[str, Timed]:
    """Call the works alternately; return the median times and the last result of each, without the first rounds."""
    found: dict[str, list[Timed]] = {name: [] for name in works}
    for _ in range(warm_up + repeats):
        for name, work in works.items():
            found[name].append(clock(work))
    return {
        name: Timed(*(median(column) for column in zip(*(run[:2] for run in runs[warm_up:]), strict=True)), runs[-1][2])
        for name, runs in found.items()
    }


def four_digits(seconds: float) -> float:
    """Return a time with four significant digits: decimal places would print the shortest times as 0."""
    return float(f"{seconds:.4g}")


def show(kernel: str, points: int, found: Mapping[str, Timed], *, processor: bool = False, **more: Any) -> None:
    """Print a line of a table and a line of JSON per program; `processor`: the processor time is compared."""
    for program, (wall, cpu, _) in found.items():
        seconds = cpu if processor else wall
        print(
            f"{kernel:46s} {points:>11,} {program:40s} {seconds:9.4f} s {points / max(seconds, 1e-9) / 1e6:8.2f} M/s",
            *(f"{key} {value}" for key, value in more.items()),
        )
        row = {"kernel": kernel, "points": points, "program": program, "seconds": four_digits(seconds)}
        known = {} if np.isnan(cpu) else {"cpu_seconds": four_digits(cpu)}
        print(json.dumps(row | known | more), flush=True)


def cloud_arrays(name: str) -> dict[str, NDArray]:
    """Return the arrays of a cloud of `$MLSROAD_RIVALS`."""
    path = RIVALS / f"{name}.npz"
    if not path.is_file():
        sys.exit(f"cloud not found: {path} (set MLSROAD_RIVALS)")
    with np.load(path) as stored:
        return dict(stored)


def voxel_centroids(xyz: NDArray, size: float) -> NDArray[np.float32]:
    """Return the mean points of the voxels of a cloud."""
    cells = np.floor((xyz - xyz.min(axis=0)) / size).astype(np.int64)
    _, owner, counts = np.unique(cells @ (1, 1 << 21, 1 << 42), return_inverse=True, return_counts=True)
    sums = [np.bincount(owner, xyz[:, axis].astype(np.float64)) for axis in range(3)]
    return (np.stack(sums, axis=1) / counts[:, None]).astype(np.float32)


def found_program(*parts: str, module: str | None = None) -> Path | None:
    """Return a program of `$MLSROAD_RIVALS`, or None with a message; a Python must be able to import `module`."""
    path = RIVALS.joinpath(*parts)
    if path.exists() and (
        module is None or not subprocess.run([path, "-c", f"import {module}"], check=False).returncode
    ):
        return path
    print(f"not found: {module or path} (set MLSROAD_RIVALS)")
    return None


def pcl_programs() -> dict[str, Path]:
    """Return the programs of PCL that are there, as it is shipped and compiled for this processor."""
    programs = {
        "PCL": found_program("build", "bench_pcl"),
        "PCL, native build": found_program("build", "bench_pcl_native"),
    }
    return {name: path for name, path in programs.items() if path is not None}


def run_pcl(program: Path, kernel: str, cloud: Path, **options: object) -> Timed:
    """Run a kernel of PCL once in its own process."""
    command = [program, "--kernel", kernel, "--pcd", cloud, "--repeats", 1]
    command += [word for name, value in options.items() for word in (f"--{name}", value)]
    out = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=True).stdout
    told = json.loads(out.strip().splitlines()[-1])
    return Timed(told["median_s"], told.get("cpu_s", float("nan")), told)


def added_kib(work: Callable[[], Any]) -> int:
    """Return by how much a call raised the peak of the resident memory of this process, KiB (Linux)."""

    def memory(field: str) -> int:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith(field))

    ctypes.CDLL("libc.so.6").malloc_trim(0)  # freed memory that the process holds would hide what the call takes
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # resets the peak
    before = memory("VmRSS")
    work()
    return memory("VmHWM") - before


class Tree:
    """Processor time and peak memory (PSS) of a process and all processes below it while it is open, by sampling."""

    def __init__(self, process: psutil.Process, *, interval: float = 0.5, memory: bool = True) -> None:
        self._process, self._interval, self._memory = process, interval, memory
        self._used: dict[int, float] = {}
        self.peak = {"driver": 0, "workers": 0}
        """Bytes at the moment of the largest sum."""
        self.largest = dict(self.peak)
        """Largest bytes of each part."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    @property
    def cpu(self) -> float:
        """Processor seconds so far."""
        return sum(self._used.values())

    @property
    def peak_bytes(self) -> int:
        """Largest sum over all processes."""
        return sum(self.peak.values())

    def sample(self) -> None:
        """Read processor time and memory."""
        sizes = {"driver": 0, "workers": 0}
        for member in members(self._process):
            try:
                times = member.cpu_times()
                size = int(member.memory_full_info().pss) if self._memory else 0
            except (psutil.NoSuchProcess, psutil.AccessDenied):
                continue
            self._used[member.pid] = times.user + times.system
            sizes["driver" if member.pid == self._process.pid else "workers"] += size
        self.peak = max(self.peak, sizes, key=lambda found: sum(found.values()))
        self.largest = {part: max(size, self.largest[part]) for part, size in sizes.items()}

    def _watch(self) -> None:
        while not self._stop.wait(self._interval):
            self.sample()

    def __enter__(self) -> Tree:
        self.sample()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()


def members(process: psutil.Process) -> list[psutil.Process]:
    """Return a process and all processes below it."""
    try:
        return [process, *process.children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def watched(
    command: list[str], log: Path, *, interval: float = 0.5, memory: bool = True, **options: Any
) -> tuple[float, Tree]:
    """Run a command whose output goes to a file; return its seconds and its processes; end on failure."""
    start = time.perf_counter()
    with log.open("w", encoding="utf-8") as stream:
        process = psutil.Popen(command, stdout=stream, stderr=subprocess.STDOUT, **options)
        with Tree(process, interval=interval, memory=memory) as tree:
            process.wait()
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} failed: see {log}")
    return time.perf_counter() - start, tree


def mlsroad(*arguments: object) -> None:
    """Run a command of `mlsroad`; an error ends the benchmark."""
    code = "import sys; sys.argv[0] = 'mlsroad'; from mlsroad_pipeline.commands.app import main; main()"
    words = list(map(str, arguments))
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"mlsroad {' '.join(words)}: {done.stderr.strip()}")


STREETS = [(kind, scanner) for kind in ("town", "suburb", "ring_road", "campus") for scanner in ("demo", "hdl32")]
"""Kinds and scanners of the simulated streets that inventories and lines are scored on."""


def simulated_street(folder: Path, kind: str, scanner: str, seed: int, length: int = 100) -> Path:
    """Simulate a street into a folder unless it is there."""
    street = folder / "streets" / f"{kind}_{scanner}"
    if not (street / "objects.csv").is_file():
        options = ("--preset", scanner, "--seed", seed, "--length", length, "--overwrite")
        mlsroad("simulate", "-o", street, *options, "--params", f"street={kind}", "--params", "with_images=false")
    return street


def stage_seconds(log: str) -> dict[str, float]:
    """Read from the log of a run how long each stage took."""
    return {name: float(seconds) for name, seconds in re.findall(r"(\w+): \d+ scenes: \d+ computed in ([\d.]+) s", log)}


def configured(group: str) -> dict[str, Any]:
    """Return a group of parameters of the base environment."""
    files = map(yaml.safe_load, (path.read_text(encoding="utf-8") for path in (CONF / "base").glob("parameters_*.yml")))
    return dict(next(groups[group] for groups in files if group in groups))


def configured_stages(*, detrend: bool = True) -> StageParameters:
    """Return how scenes are prepared; False leaves detrending out."""
    features = FeatureParameters(**configured("features"))
    return StageParameters(
        GroundParameters(**configured("ground_removal")),
        SupervoxelParameters(**configured("supervoxelise")),
        replace(features, detrend=features.detrend and detrend),
    )


def configured_scheme(name: str) -> ClassScheme:
    """Return a class scheme by its name."""
    return ClassScheme.from_config(name, configured("classes")["schemes"][name])


def prepare(scene: PointCloud, stages: StageParameters) -> dict[str, Any]:
    """Run the stages before the forest."""
    ground = find_ground(scene, stages.ground)
    supervoxels = build_supervoxels(scene, stages.supervoxels)
    features = describe_supervoxels(scene, ground, supervoxels, stages.features)
    return {"scene": scene, "supervoxels": supervoxels, "features": features}


def report(name: str, seed: int, matrix: NDArray, scheme: ClassScheme) -> None:
    """Print accuracy and F1 of a confusion matrix as a row of a table and as JSON."""
    found = scores(matrix)
    f1 = {label: round(float(value), 4) for label, value in zip(scheme.classes, found.f1, strict=True)}
    print(f"{name:10s} seed {seed:<5d} OA {found.overall_accuracy:.4f}  mean F1 {found.mean_f1:.4f}  {f1}")
    row = {"of": name, "seed": seed, "overall_accuracy": found.overall_accuracy, "mean_f1": found.mean_f1, "f1": f1}
    print(json.dumps(row), flush=True)


def markdown(table: pd.DataFrame) -> str:
    """Return a table in Markdown; undefined values are empty."""
    rows = [list(table.columns), ["---"] * table.shape[1], *table.astype(object).where(table.notna(), "").to_numpy()]
    return "\n".join("| " + " | ".join(str(value) for value in row) + " |" for row in rows)
