"""Supervoxels compared with PCL's: speed on one and two threads, number, boundary recall, under-segmentation, ceiling.

    MLSROAD_RIVALS=FOLDER python benchmarks/bench_vccs.py [--cloud street_5M_off] [--repeats 5] [--no-quality]

The folder holds `build/bench_pcl` and `build/bench_pcl_native` (PCL as it is shipped, and compiled for this processor)
and the clouds `<cloud>.npz` (xyz, rgb, cls, instance) and `<cloud>.pcd`.

Speed: the programs alternate and the median is printed; compilation and reading are not timed. PCL's time covers
construction, `extract`, `getSupervoxelAdjacency` and destruction, without `getLabeledCloud`; ours covers everything
that `segment_supervoxels` returns, including the label of every point. Both get the same points, colours and weights
and fit normals to the voxels.

Quality: PCL's labels come from its `--dump`; the reference is the class and instance of every point; near pairs are the
ten nearest neighbours of 200,000 points. Points that PCL leaves without a label form one segment.
"""

import json
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from _common import RIVALS, cloud_arrays, parser, pcl_programs, race, run_pcl, show
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.metrics.partition import evaluate_partition
from mlsroad_pipeline.algorithms.supervoxels.vccs import Supervoxels, segment_supervoxels

SETTINGS = [(0.05, 0.1), (0.2, 0.6)]
"""Voxel size and seed resolution, metres."""


def run_ours(data: dict, size: float, seed: float, coloured: bool, n_threads: int) -> Supervoxels:
    """Segment with this project."""
    rgb = data["rgb"] if coloured else None
    return segment_supervoxels(data["xyz"], rgb=rgb, voxel_size=size, seed_resolution=seed, n_threads=n_threads)


def race_programs(data: dict, programs: dict[str, Path], cloud: Path, size: float, seed: float, repeats: int) -> None:
    """Race all programs."""
    works: dict[str, Callable[[], object]] = {
        name: partial(run_pcl, program, "vccs", cloud, voxel=size, seed=seed, threads=1)
        for name, program in programs.items()
    }
    for coloured in (False, True):
        for n in (1, 2):
            name = f"mlsroad{' rgb' if coloured else ''}, {n} thread{'s' if n > 1 else ''}"
            works[name] = partial(run_ours, data, size, seed, coloured, n)
    for name, timed in race(works, repeats=repeats).items():
        made = timed.result
        number = made["supervoxels"] if isinstance(made, dict) else len(made) - made.n_islands
        show(f"VCCS {size:g} / {seed:g} m", len(data["xyz"]), {name: timed}, supervoxels=number)


def print_quality(data: dict, programs: dict[str, Path], cloud: Path, size: float, seed: float) -> None:
    """Score the partitions of PCL and of this project, with and without colour."""
    partitions = {
        f"mlsroad{' rgb' if coloured else ''}": run_ours(data, size, seed, coloured, 1).labels
        for coloured in (False, True)
    }
    for name, program in list(programs.items())[-1:]:
        with tempfile.TemporaryDirectory() as folder:
            dump = Path(folder) / "labels"
            run_pcl(program, "vccs", cloud, voxel=size, seed=seed, threads=1, dump=dump)
            partitions[name] = np.fromfile(dump, np.uint32).astype(np.int64)
    chosen = np.random.default_rng(0).permutation(len(data["xyz"]))[:200_000]
    near = cKDTree(data["xyz"]).query(data["xyz"][chosen], k=11)[1][:, 1:]
    pairs = np.stack([np.repeat(chosen, 10), near.ravel()], axis=1)
    references = {"class": data["cls"].astype(int), "object": data["instance"].astype(int) * 16 + data["cls"]}
    for reference, truth in references.items():
        for name, labels in partitions.items():
            quality = evaluate_partition(labels, truth, pairs=pairs)
            row = {"voxel": size, "seed": seed, "reference": reference, "partition": name}
            row |= {"segments": quality.n_segments, "boundary_recall": round(quality.boundary_recall, 4)}
            row |= {"under_segmentation": round(quality.under_segmentation_error, 5)}
            print(json.dumps(row | {"ceiling": round(quality.accuracy_ceiling, 5)}), flush=True)


def main() -> None:
    """Run all races."""
    arguments = parser(__doc__)
    arguments.add_argument("--cloud", default="street_5M_off")
    arguments.add_argument("--repeats", type=int, default=5)
    arguments.add_argument("--no-quality", action="store_true")
    options = arguments.parse_args()
    data, cloud, programs = cloud_arrays(options.cloud), RIVALS / f"{options.cloud}.pcd", pcl_programs()
    for size, seed in SETTINGS:  # compiles
        for coloured in (False, True):
            run_ours({k: v[:1000] for k, v in data.items()}, size, seed, coloured, 2)
    for size, seed in SETTINGS:
        race_programs(data, programs, cloud, size, seed, options.repeats)
        if not options.no_quality:
            print_quality(data, programs, cloud, size, seed)


if __name__ == "__main__":
    main()
