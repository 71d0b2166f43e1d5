"""`kedro run --pipelines=label` from LAZ to LAZ: points per second, and peak memory of the whole process tree.

    python benchmarks/bench_label.py --millions 5 20 100 --folder FOLDER
    python benchmarks/bench_label.py --millions 5 20 --methods patch_graph_mrf visual_words    # or --methods all
    python benchmarks/bench_label.py --millions 20 --backends loky dask --scheduler tcp://127.0.0.1:8786

A simulated street of that many points is made once and kept in FOLDER. The models must be registered (`make run`).
Memory is PSS summed over the process tree and processor time its sum, sampled every half second. `digest` is of the
labelled LAZ and both inventories; it is the same for all backends and numbers of workers.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import shutil
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from _common import REPOSITORY, RESULTS, parser, stage_seconds, watched
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.simulation import SurveyStream, long_survey, stream_points
from mlsroad_pipeline.simulation.parameters.presets import PRESETS

FOLDER = RESULTS / "benchmarks/label"


def long_street(n_points: int, n_threads: int = 2) -> SurveyStream:
    """Return the simulated street of the benchmarks of `label`."""
    parameters = replace(PRESETS["demo"], seed=23, pulse_rate=550_000.0)
    return long_survey(parameters, n_points=n_points, n_threads=n_threads)


def make_survey(folder: Path, millions: int) -> Path:
    """Write a simulated street and its trajectory, unless they are there."""
    path = folder / f"street_{millions}M" / "survey.laz"
    if path.exists():
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    stream = long_street(millions * 1_000_000)
    fresh = path.with_suffix(".new.laz")
    write_points(fresh, stream_points(stream, n_points=millions * 1_000_000), stream.origin)
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
    """Label a survey in a new process and measure it."""
    parameters = f"label.survey={survey.parent},label.output={output},label.method={method}"
    parameters += f",execution.backend={backend},execution.n_workers={n_workers}"
    parameters += f",execution.scheduler={scheduler}" if scheduler else ""
    command = [sys.executable, "-m", "kedro", "run", f"--env={env}", "--pipelines=label", f"--params={parameters}"]
    shutil.rmtree(output, ignore_errors=True)  # a finished run would not be repeated
    seconds, tree = watched(command, output.with_suffix(".log"), cwd=REPOSITORY)
    return {
        "seconds": seconds,
        "cpu_seconds": tree.cpu,
        "peak_gib": tree.peak_bytes / 2**30,
        "peak_driver_gib": tree.peak["driver"] / 2**30,
        "stages": stage_seconds(output.with_suffix(".log").read_text(encoding="utf-8")),
    }


def main() -> None:
    """Make the surveys, label them, and print a line of JSON per run."""
    arguments = parser(__doc__)
    arguments.add_argument("--millions", type=int, nargs="+", default=[5, 20])
    arguments.add_argument("--folder", type=Path, default=FOLDER)
    arguments.add_argument("--env", default="local")
    arguments.add_argument("--methods", nargs="+", default=["detrended_forest"])
    arguments.add_argument("--backends", nargs="+", default=["loky"], choices=["loky", "dask", "sequential"])
    arguments.add_argument("--scheduler", help="address of the scheduler of the backend dask")
    arguments.add_argument("--workers", type=int, default=2)
    options = arguments.parse_args()
    methods = options.methods
    if methods == ["all"]:
        methods = [*methods_of("labelling"), *methods_of("detection")]
    for millions in options.millions:
        survey = make_survey(options.folder, millions)
        for method, backend in itertools.product(methods, options.backends):
            output = options.folder / f"labelled_{millions}M_{method}_{backend}"
            found = run_label(survey, output, options.env, method, backend, options.workers, options.scheduler)
            figures = {"points_per_s": round(millions * 1e6 / found["seconds"]), **found, "digest": digest(output)}
            rounded = {key: round(value, 2) if isinstance(value, float) else value for key, value in figures.items()}
            what = {"method": method, "backend": backend, "workers": options.workers, "million_points": millions}
            print(json.dumps({"benchmark": "label", **what, **rounded}), flush=True)


if __name__ == "__main__":
    main()
