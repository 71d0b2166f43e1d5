"""Time, memory and quality of the patch match graph; time of label transfer, refinement and votes on points.

    python benchmarks/bench_patch_graph.py [--scenes 20] [--length 50] [--threads 2]
    python benchmarks/bench_patch_graph.py --speed-up 5 --scenes 9 --length 10    # the claim of 1/k of luo2016

Scenes are planted: two grounds, a facade, trees, poles and cars as patches of 0.2 m with noisy descriptors of their
class. The gap is the cost of the found matches divided by that of brute force, on a sample of patches. `--speed-up`
trains with the search of luo2016 on 1, 2, 4 and so on up to `--threads` threads, alternately, and prints medians.
"""

from __future__ import annotations

import json
import resource
import time
from functools import partial

import numpy as np
from _common import parser, race
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.neighbors import radius_neighbors
from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import (
    TrainedGraph,
    class_probabilities,
    match_patches,
    train_graph,
)
from mlsroad_pipeline.papers.luo2016.patch_graph.costs import CostWeights, weigh_descriptors
from mlsroad_pipeline.papers.luo2016.patch_graph.iterations import SearchParameters
from mlsroad_pipeline.papers.luo2016.patch_graph.refinement import refine
from mlsroad_pipeline.papers.shared.patches.table import Patches, join_patches
from mlsroad_pipeline.papers.shared.patches.voting import vote_on_points

PRINTED = SearchParameters(promise=float("inf"), tolerance=0.0, exhaustive_budget=0, n_probes=0)
STEP, WIDTH, FACADE = 0.2, 20.0, 8.0
N_CLASSES = 6
SAMPLE = 300
POINTS = 1_000_000


def plane(a: float, b: float) -> np.ndarray:
    first, second = np.meshgrid(np.arange(0, a, STEP), np.arange(0, b, STEP))
    return np.stack([first.ravel(), second.ravel(), np.zeros(first.size)], axis=1)


def street_scene(number: int, length: float) -> Patches:
    """Return the patches of one scene."""
    rng, alike = np.random.default_rng(number), np.random.default_rng(1000)
    shapes, colours = alike.gamma(0.6, size=(N_CLASSES, 16)), alike.random((N_CLASSES, 3))
    ground, wall = plane(length, WIDTH), plane(length, FACADE)[:, [0, 2, 1]] + [0, WIDTH, 0]
    parts, labels = [ground, wall], [np.where(ground[:, 1] < WIDTH / 2, 0, 1), np.full(len(wall), 2)]
    ball = np.stack(np.meshgrid(*[np.arange(-10, 11)] * 3), axis=-1).reshape(-1, 3)
    ball = ball[((ball**2).sum(axis=1) < 100) & (rng.random(len(ball)) < 0.5)]
    for _ in range(max(1, int(length / 6))):
        place = rng.random(3) * [length, WIDTH, 0]
        parts += [ball * STEP + place + [0, 0, 5], np.outer(np.arange(30), [0, 0, STEP]) + place]
        parts += [rng.random((300, 3)) * [4, 2, 1.5] + rng.random(3) * [length, WIDTH / 2, 0]]
        labels += [np.full(len(ball), 3), np.full(30, 4), np.full(300, 5)]
    label = np.concatenate(labels)
    xyz = np.concatenate(parts) + rng.normal(0, 0.03, (len(label), 3))
    fpfh = shapes[label] * np.exp(0.5 * rng.standard_normal((len(label), 16)))
    rgb = np.clip(colours[label] + 0.1 * rng.standard_normal((len(label), 3)), 0, 1)
    return Patches(fpfh / fpfh.sum(axis=1, keepdims=True), rgb, xyz[:, 2], xyz, np.full(len(label), number), label)


def gap(patches: Patches, graph: TrainedGraph) -> float:
    """Return the cost of the matches of some patches over that of the best ones."""
    table = weigh_descriptors(patches, CostWeights(), with_colour=True)
    place = np.empty(len(patches), np.int64)
    place[graph.rows] = np.arange(len(patches))
    found = best = 0.0
    for u in np.random.default_rng(0).choice(len(patches), SAMPLE, replace=False).tolist():
        costs = np.abs(table[u, :4] - table[:, :4]).sum(axis=1)
        costs += ((table[u, 4:] - table[:, 4:]) ** 2 / (table[u, 4:] + table[:, 4:] + 1e-30)).sum(axis=1)
        found += costs[graph.rows[graph.matches[place[u]]]].sum()
        costs[patches.scene == patches.scene[u]] = np.inf
        cheapest = np.full(patches.scene.max() + 1, np.inf)
        np.minimum.at(cheapest, patches.scene, costs)
        best += np.sort(cheapest)[: graph.matches.shape[1]].sum()
    return float(found / best)


def report(stage: str, start: float, patches: int, threads: int, **more: float) -> None:
    seconds = time.perf_counter() - start
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"{stage:<10} {patches:9d} patches, {threads} threads  {seconds:8.2f} s  peak {memory:.2f} GiB", more or "")
    figures = {"seconds": round(seconds, 3), "peak_gib": round(memory, 3), **more}
    print(json.dumps({"kernel": f"patch_graph {stage}", "patches": patches, "threads": threads, **figures}), flush=True)


def speed_up(patches: Patches, rounds: int, threads: int) -> None:
    """Print the median time of training with the search of the paper on one thread and on several."""
    numbers = sorted({1, threads, *(2**k for k in range(threads.bit_length()) if 2**k <= threads)})
    works = {str(n): partial(train_graph, patches, search=PRINTED, n_threads=n) for n in numbers}
    found = race(works, repeats=rounds)
    for number, timed in found.items():
        facts = {"patches": len(patches), "threads": int(number), "seconds": round(timed.seconds, 3)}
        ratio = round(found["1"].seconds / timed.seconds, 2)
        print(json.dumps({"kernel": "patch_graph speed-up", **facts, "ratio": ratio}), flush=True)


def main() -> None:
    """Measure and print."""
    arguments = parser(__doc__)
    arguments.add_argument("--scenes", type=int, default=20)
    arguments.add_argument("--length", type=float, default=50.0, help="of a scene, metres")
    arguments.add_argument("--threads", type=int, default=2)
    arguments.add_argument("--speed-up", type=int, default=0, metavar="ROUNDS", help="measure only the speed-up")
    options = arguments.parse_args()
    small = join_patches([street_scene(s, 2.0) for s in range(9)])
    warm = train_graph(small, n_threads=options.threads)  # compiles
    if options.speed_up:
        scenes = [street_scene(s, options.length) for s in range(options.scenes)]
        speed_up(join_patches(scenes), options.speed_up, options.threads)
        return
    new = street_scene(options.scenes, options.length)
    pairs, indptr = radius_neighbors(new.centroid, radius=1.5 * STEP)
    rows = np.repeat(np.arange(len(new)), np.diff(indptr)).astype(np.int32)
    edges = np.stack([rows, pairs], axis=1)[rows < pairs]
    first = match_patches(small, warm)
    refine(
        class_probabilities(warm.labels[first.matches], N_CLASSES), small.rgb, edges[(edges < len(small)).all(axis=1)]
    )
    points = np.repeat(new.centroid, POINTS // len(new), axis=0)
    points += np.random.default_rng(0).uniform(-STEP / 2, STEP / 2, points.shape)
    vote_on_points(points[:1000], new.centroid, np.eye(N_CLASSES)[new.label], radius=0.3)
    patches = join_patches([street_scene(s, options.length) for s in range(options.scenes)])
    measure(patches, new, edges, points, options.threads)


def measure(
    patches: Patches, new: Patches, edges: NDArray[np.int32], points: NDArray[np.float64], threads: int
) -> None:
    """Print the times of training on patches, and of labelling the points of a new scene."""
    start = time.perf_counter()
    graph = train_graph(patches, n_threads=threads)
    report("training", start, len(patches), threads, iterations=len(graph.objective) - 1)
    start = whole = time.perf_counter()
    found = match_patches(new, graph)
    report("transfer", start, len(new), 1, iterations=len(found.objective) - 1)
    start = time.perf_counter()
    refined, shares = refine(class_probabilities(graph.labels[found.matches], N_CLASSES), new.rgb, edges)
    report("refinement", start, len(new), 1, right=round(float((refined == new.label).mean()), 4))
    start = time.perf_counter()
    vote_on_points(points, new.centroid, shares, radius=0.3)
    report("votes", start, len(new), 1, points=len(points))
    report("labelling", whole, len(new), 1)
    report("gap", time.perf_counter(), len(patches), 1, gap=round(gap(patches, graph), 4))


if __name__ == "__main__":
    main()
