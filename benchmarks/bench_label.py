"""`kedro run --pipelines=label` from LAZ to LAZ: points per second, and peak memory of the whole process tree.

    python benchmarks/bench_label.py --millions 5 20 100 --folder FOLDER
    python benchmarks/bench_label.py --millions 5 20 --methods patch_graph_mrf visual_words    # or --methods all
    python benchmarks/bench_label.py --millions 20 --backends loky dask --workers 4            # the same bytes?

A simulated street of that many points is made once and kept in FOLDER. The models must be registered (`make run`).
Memory is PSS summed over the process tree and processor time its sum, sampled every half second. What earlier runs of
`label` have stored in the project is removed first. `digest` is of the labelled LAZ and both inventories, the same for
all backends and workers.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import json
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import psutil
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.simulation import long_survey, stream_points
from mlsroad_pipeline.simulation.parameters.presets import PRESETS

REPOSITORY = Path(__file__).resolve().parents[1]


def make_survey(folder: Path, millions: int, n_threads: int) -> Path:
    """Write a simulated street and its trajectory, unless they are there."""
    path = folder / f"street_{millions}M" / "survey.laz"
    if path.exists():
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    parameters = replace(PRESETS["demo"], seed=23, pulse_rate=550_000.0)
    n_points = millions * 1_000_000
    stream = long_survey(parameters, n_points=n_points, n_threads=n_threads)
    fresh = path.with_suffix(".new.laz")
    write_points(fresh, stream_points(stream, n_points=n_points), stream.origin)
    stream.trajectory.to_csv(path.parent / "trajectory.csv", index=False, float_format="%.6f")
    fresh.rename(path)
    return path


def write_points(path: Path, clouds: Iterable[PointCloud], origin: NDArray[np.float64]) -> None:
    """Write clouds with intensity, time and colour to a LAZ file."""
    header = laspy.LasHeader(version="1.4", point_format=7)
    header.scales, header.offsets = np.full(3, 0.001), np.floor(origin)
    with laspy.open(path, mode="w", header=header) as writer:
        for cloud in clouds:
            record = laspy.ScaleAwarePointRecord.zeros(len(cloud), header=header)
            record.x, record.y, record.z = cloud.world_xyz().T
            record.intensity = np.round(cloud["intensity"] * 65535).astype(np.uint16)
            record.gps_time = cloud["gps_time"]
            record.red, record.green, record.blue = cloud["rgb"].T.astype(np.uint16) * 257
            writer.write_points(record)


def tree_cpu(process: psutil.Process) -> dict[int, float]:
    """Return the processor seconds of a process and of all below it so far, by process."""
    used = {}
    for member in [process, *process.children(recursive=True)]:
        try:
            times = member.cpu_times()
        except (psutil.NoSuchProcess, psutil.AccessDenied):
            continue
        used[member.pid] = times.user + times.system
    return used


def tree_pss(process: psutil.Process) -> dict[str, int]:
    """Return the proportional set sizes of a process and all below it, bytes: the driver's and that of all others."""
    sizes = {"driver": 0, "workers": 0}
    for member in [process, *process.children(recursive=True)]:
        try:
            size = int(member.memory_full_info().pss)
        except (psutil.NoSuchProcess, psutil.AccessDenied):
            continue
        sizes["driver" if member.pid == process.pid else "workers"] += size
    return sizes


def stage_seconds(log: str) -> dict[str, float]:
    """Read from a run's log how long each stage took."""
    return {name: float(seconds) for name, seconds in re.findall(r"(\w+): \d+ scenes: \d+ computed in ([\d.]+) s", log)}


def digest(folder: Path) -> str:
    """Return a digest of the labelled points and the inventories."""
    found = hashlib.blake2b(digest_size=8)
    for path in sorted(path for path in folder.iterdir() if path.suffix in (".laz", ".gpkg", ".parquet")):
        with path.open("rb") as file:
            found.update(hashlib.file_digest(file, "blake2b").digest())
    return found.hexdigest()


def run_label(
    survey: Path, output: Path, env: str, method: str, backend: str, n_workers: int, scheduler: str | None = None
) -> dict[str, Any]:
    """Label a survey in a fresh process and watch it."""
    command = [sys.executable, "-m", "kedro", "run", f"--env={env}", "--pipelines=label"]
    command.append(
        f"--params=label.survey={survey.parent},label.output={output},label.method={method},"
        f"execution.backend={backend},execution.n_workers={n_workers}"
        + (f",execution.scheduler={scheduler}" if scheduler else "")
    )
    shutil.rmtree(output, ignore_errors=True)  # a finished run would not be repeated
    start, peak, used = time.perf_counter(), {"driver": 0, "workers": 0}, dict[int, float]()
    path = output.with_suffix(".log")
    with path.open("w") as log:
        process = psutil.Popen(command, cwd=REPOSITORY, stdout=log, stderr=subprocess.STDOUT)
        while process.poll() is None:
            peak = max(peak, tree_pss(process), key=lambda sizes: sum(sizes.values()))
            used |= tree_cpu(process)
            time.sleep(0.5)
    seconds = time.perf_counter() - start
    if process.returncode:
        raise SystemExit(f"label failed: see {path}")
    return {
        "seconds": seconds,
        "cpu_seconds": sum(used.values()),
        "peak_gib": sum(peak.values()) / 2**30,
        "peak_driver_gib": peak["driver"] / 2**30,
        "stages": stage_seconds(path.read_text(encoding="utf-8")),
    }


def main() -> None:
    """Make the surveys, label them, print a table and JSON lines."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--millions", type=int, nargs="+", default=[5, 20])
    parser.add_argument("--folder", type=Path, default=REPOSITORY / "data/08_reporting/benchmarks/label")
    parser.add_argument("--env", default="local")
    parser.add_argument("--methods", nargs="+", default=["detrended_forest"])
    parser.add_argument("--backends", nargs="+", default=["loky"], choices=["loky", "dask", "sequential"])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only-make", action="store_true")
    arguments = parser.parse_args()
    methods = (
        [*methods_of("labelling"), *methods_of("detection")] if arguments.methods == ["all"] else arguments.methods
    )
    for millions in arguments.millions:
        survey = make_survey(arguments.folder, millions, n_threads=2)
        if arguments.only_make:
            continue
        for method, backend in itertools.product(methods, arguments.backends):
            output = arguments.folder / f"labelled_{millions}M_{method}_{backend}"
            found = run_label(survey, output, arguments.env, method, backend, arguments.workers)
            figures = {"points_per_s": round(millions * 1e6 / found["seconds"]), **found, "digest": digest(output)}
            rounded = {key: round(value, 2) if isinstance(value, float) else value for key, value in figures.items()}
            what = {"method": method, "backend": backend, "workers": arguments.workers, "million_points": millions}
            print(json.dumps({"benchmark": "label", **what, **rounded}), flush=True)


if __name__ == "__main__":
    main()
