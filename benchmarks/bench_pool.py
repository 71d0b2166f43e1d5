"""CPU time and memory of one process that labels a scene with a shipped model, and of the steps of its members.

    python benchmarks/bench_pool.py street/survey.laz [--model pool] [--points 120000] [--repeats 5]

One thread. The scene is the middle of the file. Start: imports, reading and the first scene, with compiled kernels.
"""

from __future__ import annotations

import json
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from _common import parser, race

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters, StageParameters
from mlsroad_pipeline.algorithms.core.stage_results import Ground
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import describe_scene, voxel_probabilities
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import label_softly
from mlsroad_pipeline.algorithms.models.pool.labeller import NETWORK, TREES, members_of
from mlsroad_pipeline.algorithms.models.superpoint_transformer.building import build_graph
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inputs import Scale, even_points, prepare_inputs
from mlsroad_pipeline.algorithms.models.superpoint_transformer.labeller import (
    parameters_of,
    predict_superpoints,
    prepare,
)
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.model_store.shipped_models import load_shipped

Works = dict[str, Callable[[], Any]]


def steps_of_trees(scene: PointCloud, ground: Ground, member: ModelBundle) -> Works:
    """Return the steps of boosted trees on a scene."""
    voxels = describe_scene(scene, ground)
    name = f"{len(member.arrays['n_leaves'])} trees with smoothing, {len(voxels.values)} voxels"
    return {
        "voxel features": lambda: describe_scene(scene, ground),
        name: lambda: voxel_probabilities(voxels, member),
    }


def steps_of_network(scene: PointCloud, member: ModelBundle) -> Works:
    """Return the steps of the superpoint transformer on a scene."""
    parameters, scale = parameters_of(member), Scale.from_arrays(member.arrays)
    stages = StageParameters.from_stored(member.metadata["parameters"])
    prepared = prepare(scene, stages)
    graph = build_graph(scene, *prepared, parameters.hierarchy)
    rows = even_points(graph, parameters.training.n_points)
    return {
        "ground, supervoxels and features": lambda: prepare(scene, stages),
        "hierarchy of superpoints": lambda: build_graph(scene, *prepared, parameters.hierarchy),
        "inputs of the network": lambda: prepare_inputs(graph, scale, rows),
        "inputs and network": lambda: predict_superpoints(graph, member, parameters),
    }


def main() -> None:
    """Measure and print a line of JSON per step."""
    arguments = parser(__doc__)
    arguments.add_argument("cloud", type=Path)
    arguments.add_argument("--model", default="pool")
    arguments.add_argument("--points", type=int, default=120_000)
    arguments.add_argument("--repeats", type=int, default=5)
    options = arguments.parse_args()
    cloud = LasFormat().read(options.cloud, ReadOptions())
    first = max(len(cloud) - options.points, 0) // 2
    scene = cloud.select(np.arange(first, min(first + options.points, len(cloud))))
    ground = find_ground(scene, GroundParameters())
    scene = scene.with_columns(ground=ground["ground"], height=ground["height"])
    model = load_shipped(options.model)
    label_softly(model, scene)
    start = {"program": "start", "cpu_seconds": round(time.process_time(), 2)}
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000
    print(json.dumps({"model": options.model, "points": len(scene)} | start | {"memory_mb": round(memory)}))
    works: Works = {"whole labelling": lambda: label_softly(model, scene)}
    if model.slug == "pool":
        members = members_of(model)
        works |= steps_of_trees(scene, ground, members[TREES]) | steps_of_network(scene, members[NETWORK])
    for name, timed in race(works, repeats=options.repeats, warm_up=1).items():
        per_point = round(1e6 * timed.cpu / len(scene), 2)
        print(json.dumps({"program": name, "cpu_seconds": round(timed.cpu, 3), "us_per_point": per_point}))


if __name__ == "__main__":
    main()
