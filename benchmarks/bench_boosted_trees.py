"""CPU time of voxel features, boosted trees and whole labelling.

    python benchmarks/bench_boosted_trees.py street_1M.laz [--rounds 150] [--repeats 3]

One thread. The trees are trained on 6,000 voxels with the labels of the trees of the package: their number and size
count, not their labels. Compilation and reading stay outside.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.baselines.boosted_trees.labeller import (
    describe_scene,
    label_cloud,
    voxel_probabilities,
)
from mlsroad_pipeline.algorithms.baselines.boosted_trees.parameters import BoostedTreesParameters
from mlsroad_pipeline.algorithms.baselines.boosted_trees.sampling import sample_voxels
from mlsroad_pipeline.algorithms.baselines.boosted_trees.training import fit
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.core.stage_results import Ground
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.datasets.models.shipped_models import load_shipped
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.options import ReadOptions


def median_cpu(work: Callable[[], Any], repeats: int) -> float:
    """Return the median CPU time of some calls after one that compiles, seconds."""
    work()
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
    return float(np.median(seconds))


def train_on(cloud: PointCloud, ground: Ground, shipped: ModelBundle, rounds: int) -> ModelBundle:
    """Return boosted trees that imitate the trees of the package on a cloud."""
    labels, _ = label_cloud(cloud, shipped)
    n_classes = len(shipped.classes)
    parameters = BoostedTreesParameters(rounds=rounds, max_per_class=6000 // n_classes, min_child_samples=5)
    sets = np.eye(n_classes, dtype=np.bool_)
    voxels = sample_voxels(cloud, ground, labels, sets, parameters=parameters)
    return fit([voxels], parameters=parameters, ground=GroundParameters(), scheme=bundle_scheme(shipped), trained_on={})


def main() -> None:
    """Measure and print a line of JSON per program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cloud", type=Path)
    parser.add_argument("--rounds", type=int, default=150)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    cloud = LasFormat().read(options.cloud, ReadOptions())
    ground = find_ground(cloud, GroundParameters())
    model = train_on(cloud, ground, load_shipped("general"), options.rounds)
    features = describe_scene(cloud, ground)
    n_voxels, n_trees = len(features.values), len(model.arrays["n_leaves"])
    programs: dict[str, Callable[[], Any]] = {
        "voxel features": lambda: describe_scene(cloud, ground),
        f"{n_trees} trees with smoothing": lambda: voxel_probabilities(features, model),
        "boosted_trees, ground to labels": lambda: label_cloud(cloud, model),
    }
    for name, work in programs.items():
        cpu = median_cpu(work, options.repeats)
        row = {"program": name, "points": len(cloud), "voxels": n_voxels, "cpu_seconds": round(cpu, 3)}
        per = {"us_per_voxel": round(1e6 * cpu / n_voxels, 2), "us_per_point": round(1e6 * cpu / len(cloud), 3)}
        print(json.dumps(row | per))


if __name__ == "__main__":
    main()
