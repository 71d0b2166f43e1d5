"""Speed of alpha-expansion beside gco, PyMaxflow in a loop, and CGAL, where they are found.

The graph and the rivals are those that ``$MLSROAD_RIVALS`` holds: ``graph.bin`` (287,000 voxels of a street, 1.24
million edges, 5 labels), gco and PyMaxflow in ``venv/``, CGAL's program in ``build/``. Every entrant minimises the same
Potts energy until no expansion lowers it, starting from each node's cheapest label, gco from label 0, as its interface
has it. Runs alternate, medians are printed, compilation is outside. One JSON line per figure follows the table.

    MLSROAD_RIVALS=rivals_data python benchmarks/bench_graph_cuts.py
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.energy.alpha_expansion import minimize

REPEATS = 3
GCO = """
import sys, time, numpy as np, gco
def run(unary, edges, weights, initial):
    start = time.perf_counter()
    graph = gco.GCO()
    graph.create_general_graph(len(unary), unary.shape[1], True)
    graph.set_data_cost(unary)
    graph.set_all_neighbors(edges[:, 0], edges[:, 1], weights)
    graph.set_smooth_cost(1.0 - np.eye(unary.shape[1]))
    graph.expansion(-1)
    labels = graph.get_labels()
    return time.perf_counter() - start, labels
"""
PYMAXFLOW = """
import sys, time, numpy as np, maxflow
def energy(labels, unary, edges, weights):
    cut = labels[edges[:, 0]] != labels[edges[:, 1]]
    return unary[np.arange(len(unary)), labels].sum() + weights[cut].sum()
def expand(labels, alpha, unary, edges, weights):
    nodes, (i, j) = np.arange(len(unary)), edges.T
    keep, take = unary[nodes, labels].copy(), unary[:, alpha].copy()
    neither = weights * (labels[i] != labels[j])
    first, second = weights * (labels[j] != alpha), weights * (labels[i] != alpha)
    take += np.bincount(i, first - neither, len(nodes)) - np.bincount(j, first, len(nodes))
    low = np.minimum(keep, take)
    graph = maxflow.Graph[float](len(nodes), len(i))
    graph.add_nodes(len(nodes))
    graph.add_edges(i, j, first + second - neither, np.zeros(len(i)))
    graph.add_grid_tedges(nodes, take - low, keep - low)
    graph.maxflow()
    return np.where(graph.get_grid_segments(nodes), alpha, labels)
def run(unary, edges, weights, labels):
    start = time.perf_counter()
    lowest, lowered = energy(labels, unary, edges, weights), True
    while lowered:
        lowered = False
        for alpha in range(unary.shape[1]):
            tried = expand(labels, alpha, unary, edges, weights)
            cost = energy(tried, unary, edges, weights)
            if cost < lowest - 1e-6:
                labels, lowest, lowered = tried, cost, True
    return time.perf_counter() - start, labels
"""
READ = """
with open(sys.argv[1], "rb") as file:
    n, m, l = np.fromfile(file, "<i4", 3)
    edges = np.fromfile(file, "<i4", 2 * m).reshape(m, 2).astype(np.int64)
    weights = np.fromfile(file, "<f4", m).astype(float)
    unary = np.fromfile(file, "<f4", n * l).reshape(n, l).astype(float)
seconds, labels = run(unary, edges, weights, unary.argmin(axis=1))
cut = labels[edges[:, 0]] != labels[edges[:, 1]]
print(seconds, unary[np.arange(n), labels].sum() + weights[cut].sum())
"""


def read_graph(file: Path) -> tuple[NDArray, NDArray, NDArray]:
    """Return unary terms, edges and weights of a graph file."""
    with file.open("rb") as stream:
        n, m, n_labels = (int(number) for number in np.fromfile(stream, "<i4", 3))
        edges = np.fromfile(stream, "<i4", 2 * m).reshape(m, 2)
        weights = np.fromfile(stream, "<f4", m)
        return np.fromfile(stream, "<f4", n * n_labels).reshape(n, n_labels), edges, weights


def own_run(unary: NDArray, edges: NDArray, weights: NDArray) -> tuple[float, float]:
    start = time.perf_counter()
    _, energy = minimize(unary, edges, weights)
    return time.perf_counter() - start, energy


def python_run(python: Path, program: str, graph: Path) -> tuple[float, float]:
    done = subprocess.run([python, "-c", program + READ, graph], check=True, capture_output=True, text=True)
    seconds, energy = done.stdout.split()[-2:]
    return float(seconds), float(energy)


def cgal_run(program: Path, graph: Path) -> tuple[float, float]:
    command = [program, "--kernel", "alpha", "--graph", graph, "--repeats", "1"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    answer = json.loads(done.stdout.strip().splitlines()[-1])
    return float(answer["min_s"]), float(answer["energy"])


def entrants(rivals: Path) -> dict[str, Callable[[], tuple[float, float]]]:
    graph = rivals / "graph.bin"
    runs: dict[str, Callable[[], tuple[float, float]]] = {"mlsroad": partial(own_run, *read_graph(graph))}
    python, cgal = rivals / "venv" / "bin" / "python", rivals / "build" / "bench_cgal"
    for name, module, program in (("gco", "gco", GCO), ("PyMaxflow in a loop", "maxflow", PYMAXFLOW)):
        if python.exists() and not subprocess.run([python, "-c", f"import {module}"], check=False).returncode:
            runs[name] = partial(python_run, python, program, graph)
        else:
            print(f"not found: {module}")
    if cgal.exists():
        runs["CGAL"] = partial(cgal_run, cgal, graph)
    else:
        print("not found: bench_cgal")
    return runs


def main() -> int:
    """Run the race and print the table."""
    rng = np.random.default_rng(0)
    xyz = rng.uniform(0, 3, (500, 3))
    pairs = cKDTree(xyz).query_pairs(0.5, output_type="ndarray").astype(np.int32)
    minimize(rng.random((500, 5), np.float32), pairs, rng.random(len(pairs), np.float32))  # compiles
    rivals = Path(os.environ.get("MLSROAD_RIVALS", ""))
    if not (rivals / "graph.bin").is_file():
        print("not found: graph.bin (set MLSROAD_RIVALS)")
        return 0
    runs = entrants(rivals)
    results: dict[str, list[tuple[float, float]]] = {name: [] for name in runs}
    for _ in range(REPEATS):
        for name, run in runs.items():
            results[name].append(run())
    for name, measured in results.items():
        seconds, energy = median(row[0] for row in measured), measured[0][1]
        print(f"alpha-expansion {name:<22} {seconds:8.3f} s   energy {energy:14.3f}")
    for name, measured in results.items():
        seconds, energy = median(row[0] for row in measured), measured[0][1]
        print(
            json.dumps({"kernel": "alpha-expansion", "program": name, "seconds": round(seconds, 4), "energy": energy})
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
