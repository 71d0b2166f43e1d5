"""Label a simulated road of any length: blocks are simulated, labelled and removed one after the other.

    python benchmarks/billion.py --million-points 20                 # a first figure
    python benchmarks/billion.py --million-points 1000 --folder FOLDER

Each block is a LAZ file with trajectory, colour and intensity, and one run of `mlsroad label`. Objects that a border
between two blocks cuts are not joined. The table `blocks.csv` in FOLDER has a row per block: points, metres of road,
seconds of simulation and labelling, CPU seconds and peak memory of labelling (PSS of all processes), bytes of input and
output. A killed run continues after the last block in the table. `--keep` keeps the results of the blocks.
"""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from _common import RESULTS, parser, watched
from bench_label import long_street, write_points

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.simulation import stream_points

SPARE = 0.5
"""Seconds of the trajectory before the first and after the last point of a block."""


def blocks_of(clouds: Iterator[PointCloud], n_points: int) -> Iterator[list[PointCloud]]:
    """Join streamed clouds to blocks of at least a number of points."""
    block: list[PointCloud] = []
    for cloud in clouds:
        block.append(cloud)
        if sum(map(len, block)) >= n_points:
            yield block
            block = []
    if block:
        yield block


def write_block(folder: Path, block: list[PointCloud], trajectory: pd.DataFrame) -> tuple[Path, float]:
    """Write a block and its part of the trajectory; return the file and the metres of road."""
    path = folder / "survey.laz"
    times = [time for cloud in block for time in (cloud["gps_time"].min(), cloud["gps_time"].max())]
    write_points(path, block, block[0].origin)
    seconds = trajectory["gps_time"]
    part = trajectory[seconds.between(min(times) - SPARE, max(times) + SPARE)]
    part.to_csv(folder / "trajectory.csv", index=False, float_format="%.6f")
    driven = trajectory[seconds.between(min(times), max(times))]
    return path, float(np.hypot(np.diff(driven["x"]), np.diff(driven["y"])).sum())


def label(path: Path, output: Path, workers: int) -> dict[str, float]:
    """Label a file in a process of its own, and return its costs."""
    command = [str(Path(sys.executable).with_name("mlsroad")), "label", str(path), "-o", str(output)]
    seconds, tree = watched([*command, "--workers", str(workers)], output.with_suffix(".log"))
    return {"label_s": seconds, "label_cpu_s": tree.cpu, "peak_gib": tree.peak_bytes / 2**30}


def bytes_below(folder: Path) -> int:
    """Return the size of all files below a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def main() -> None:
    """Simulate and label the blocks, and print a row for each and the sum."""
    arguments = parser(__doc__)
    arguments.add_argument("--million-points", type=float, default=20)
    arguments.add_argument("--block", type=float, default=10, help="million points of a block")
    arguments.add_argument("--folder", type=Path, default=RESULTS / "benchmarks/billion")
    arguments.add_argument("--workers", type=int, default=2)
    arguments.add_argument("--keep", action="store_true", help="keep the results of the blocks")
    options = arguments.parse_args()
    n_points, folder = round(options.million_points * 1e6), options.folder
    folder.mkdir(parents=True, exist_ok=True)
    table = folder / "blocks.csv"
    rows: list[dict[str, Any]] = pd.read_csv(table).to_dict("records") if table.is_file() else []
    stream = long_street(n_points)
    begin = time.perf_counter()
    for number, block in enumerate(blocks_of(stream_points(stream, n_points=n_points), round(options.block * 1e6))):
        place, output = folder / "block", folder / f"labelled_{number:04d}"
        if number >= len(rows):
            for stale in (place, output):
                shutil.rmtree(stale, ignore_errors=True)
            place.mkdir()
            path, metres = write_block(place, block, stream.trajectory)
            row = {"block": number, "points": sum(map(len, block)), "road_m": metres}
            row |= {"simulation_s": time.perf_counter() - begin, **label(path, output, options.workers)}
            rows.append(row | {"input_bytes": path.stat().st_size, "output_bytes": bytes_below(output)})
            pd.DataFrame(rows).to_csv(table, index=False, float_format="%.3f")
            print(json.dumps(rows[-1]), flush=True)
            if not options.keep:
                shutil.rmtree(output)
        begin = time.perf_counter()
    print(json.dumps({"benchmark": "billion", **summary(pd.DataFrame(rows))}))


def summary(rows: pd.DataFrame) -> dict[str, float]:
    """Return the sums over all blocks, and costs per point and per kilometre of road."""
    total = rows.drop(columns=["block", "peak_gib"]).sum()
    kilometres = total["road_m"] / 1000
    found = {name: float(total[name]) for name in total.index}
    found |= {"peak_gib": float(rows["peak_gib"].max()), "label_s_per_km": total["label_s"] / kilometres}
    found |= {"cpu_us_per_point": 1e6 * total["label_cpu_s"] / total["points"]}
    return {name: round(float(value), 3) for name, value in found.items()}


if __name__ == "__main__":
    main()
