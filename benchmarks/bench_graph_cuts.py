"""Speed of alpha-expansion, compared with gco, PyMaxflow in a loop, and CGAL.

    MLSROAD_RIVALS=rivals_data python benchmarks/bench_graph_cuts.py

`$MLSROAD_RIVALS` holds `graph.bin` (287,000 voxels of a street, 1.24 million edges, 5 labels), gco and PyMaxflow in
`venv/`, CGAL's program in `build/`. Ten made graphs span sizes, labels and smoothness; on them gco alone is compared.
Times are processor times. Every program minimises the same Potts energy until no expansion lowers it, starting from the
cheapest label of each node (gco: label 0, as its interface has it). Runs alternate, medians are printed, compilation is
not timed.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from _common import RIVALS, Timed, found_program, parser, race, show
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.energy.alpha_expansion import minimize

REPEATS = 3
GCO = """
import sys, time, numpy as np, gco
def run(unary, edges, weights, initial):
    start = time.process_time()
    graph = gco.GCO()
    graph.create_general_graph(len(unary), unary.shape[1], True)
    graph.set_data_cost(unary)
    graph.set_all_neighbors(edges[:, 0], edges[:, 1], weights)
    graph.set_smooth_cost(1.0 - np.eye(unary.shape[1]))
    graph.expansion(-1)
    labels = graph.get_labels()
    return time.process_time() - start, labels
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
    start = time.process_time()
    lowest, lowered = energy(labels, unary, edges, weights), True
    while lowered:
        lowered = False
        for alpha in range(unary.shape[1]):
            tried = expand(labels, alpha, unary, edges, weights)
            cost = energy(tried, unary, edges, weights)
            if cost < lowest - 1e-6:
                labels, lowest, lowered = tried, cost, True
    return time.process_time() - start, labels
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


def image_graph(height: int, width: int, n_labels: int, weight: float) -> tuple[NDArray, NDArray, NDArray]:
    """Return the graph of an image whose pixels are joined to their right and lower neighbours."""
    rng, index = np.random.default_rng(0), np.arange(height * width).reshape(height, width)
    right, down = (index[:, :-1], index[:, 1:]), (index[:-1], index[1:])
    edges = np.concatenate([np.column_stack([a.ravel(), b.ravel()]) for a, b in (right, down)]).astype(np.int32)
    truth = (index // width * 4 // height + index % width * 4 // width * 3) % n_labels
    unary = rng.normal(0, 1, (index.size, n_labels)) - 2 * np.eye(n_labels)[truth.ravel()]
    return (unary - unary.min()).astype(np.float32), edges, np.full(len(edges), weight, np.float32)


def cloud_graph(n_nodes: int, n_labels: int, weight: float) -> tuple[NDArray, NDArray, NDArray]:
    """Return a graph of points in random order that are joined to their eight nearest ones."""
    rng = np.random.default_rng(0)
    xyz = rng.random((n_nodes, 3)) * [100, 30, 1]
    near = cKDTree(xyz).query(xyz, 9)[1][:, 1:]
    pairs = np.column_stack([np.repeat(np.arange(n_nodes), 8), near.ravel()])
    edges = np.unique(np.sort(pairs, axis=1), axis=0).astype(np.int32)
    truth = ((xyz[:, 0] // 10 + xyz[:, 1] // 10) % n_labels).astype(int)
    unary = rng.normal(0, 1.5, (n_nodes, n_labels)) - 2 * np.eye(n_labels)[truth]
    return (
        (unary - unary.min()).astype(np.float32),
        edges,
        (weight * np.exp(-rng.random(len(edges)))).astype(np.float32),
    )


GRAPHS: dict[str, Callable[[], tuple[NDArray, NDArray, NDArray]]] = {
    "image 250 x 248, 5 labels, weight 0.5": partial(image_graph, 250, 248, 5, 0.5),
    "image 250 x 248, 5 labels, weight 1": partial(image_graph, 250, 248, 5, 1.0),
    "image 250 x 248, 5 labels, weight 3": partial(image_graph, 250, 248, 5, 3.0),
    "image 250 x 248, 2 labels, weight 1": partial(image_graph, 250, 248, 2, 1.0),
    "image 100 x 100, 20 labels, weight 1": partial(image_graph, 100, 100, 20, 1.0),
    "image 500 x 500, 5 labels, weight 1": partial(image_graph, 500, 500, 5, 1.0),
    "cloud of 2,000, 5 labels, weight 0.4": partial(cloud_graph, 2000, 5, 0.4),
    "cloud of 30,000, 10 labels, weight 0.4": partial(cloud_graph, 30_000, 10, 0.4),
    "cloud of 30,000, 10 labels, weight 2": partial(cloud_graph, 30_000, 10, 2.0),
    "cloud of 100,000, 5 labels, weight 0.1": partial(cloud_graph, 100_000, 5, 0.1),
}
"""Ten graphs that span sizes, labels and smoothness."""


def read_graph(file: Path) -> tuple[NDArray, NDArray, NDArray]:
    """Return unary terms, edges and weights of a graph file."""
    with file.open("rb") as stream:
        n, m, n_labels = (int(number) for number in np.fromfile(stream, "<i4", 3))
        edges = np.fromfile(stream, "<i4", 2 * m).reshape(m, 2)
        weights = np.fromfile(stream, "<f4", m)
        return np.fromfile(stream, "<f4", n * n_labels).reshape(n, n_labels), edges, weights


def write_graph(file: Path, unary: NDArray, edges: NDArray, weights: NDArray) -> None:
    """Write a graph file."""
    with file.open("wb") as stream:
        np.array([len(unary), len(edges), unary.shape[1]], "<i4").tofile(stream)
        edges.astype("<i4").tofile(stream)
        weights.astype("<f4").tofile(stream)
        unary.astype("<f4").tofile(stream)


def own_run(unary: NDArray, edges: NDArray, weights: NDArray) -> float:
    """Minimise in this process; return the energy."""
    return minimize(unary, edges, weights)[1]


def python_run(python: Path, program: str, graph: Path) -> Timed:
    """Minimise with a Python library in its own process."""
    done = subprocess.run([python, "-c", program + READ, graph], check=True, capture_output=True, text=True)
    seconds, energy = map(float, done.stdout.split()[-2:])
    return Timed(seconds, seconds, energy)


def cgal_run(program: Path, graph: Path) -> Timed:
    """Minimise with CGAL in its own process."""
    command = [program, "--kernel", "alpha", "--graph", graph, "--repeats", "1"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    answer = json.loads(done.stdout.strip().splitlines()[-1])
    return Timed(float(answer["min_s"]), float(answer["min_s"]), float(answer["energy"]))


def race_graph(kernel: str, n_nodes: int, works: dict[str, Callable[[], Any]]) -> dict[str, Timed]:
    """Race programs on a graph."""
    found = race(works, repeats=REPEATS)
    for program, timed in found.items():
        show(kernel, n_nodes, {program: timed}, processor=True, energy=timed.result)
    return found


def race_graphs(python: Path | None, names: Iterable[str] = GRAPHS) -> dict[str, dict[str, Timed]]:
    """Race gco, where a Python has it, on made graphs; return the results by graph and program."""
    found = {}
    with TemporaryDirectory() as folder:
        for name in names:
            graph = GRAPHS[name]()
            write_graph(file := Path(folder) / "graph.bin", *graph)
            works: dict[str, Callable[[], Any]] = {"mlsroad": partial(own_run, *graph)}
            if python is not None:
                works["gco"] = partial(python_run, python, GCO, file)
            found[name] = race_graph(f"alpha-expansion, {name}", len(graph[0]), works)
    return found


def main() -> None:
    """Run all races."""
    parser(__doc__).parse_args()
    rng = np.random.default_rng(0)
    xyz = rng.uniform(0, 3, (500, 3))
    pairs = cKDTree(xyz).query_pairs(0.5, output_type="ndarray").astype(np.int32)
    minimize(rng.random((500, 5), np.float32), pairs, rng.random(len(pairs), np.float32))  # compiles
    with_gco, with_maxflow = (found_program("venv", "bin", "python", module=name) for name in ("gco", "maxflow"))
    race_graphs(with_gco)
    file = RIVALS / "graph.bin"
    if not file.is_file():
        print("not found: graph.bin (set MLSROAD_RIVALS)")
        return
    graph, cgal = read_graph(file), found_program("build", "bench_cgal")
    works: dict[str, Callable[[], Any]] = {"mlsroad": partial(own_run, *graph)}
    if with_gco is not None:
        works["gco"] = partial(python_run, with_gco, GCO, file)
    if with_maxflow is not None:
        works["PyMaxflow in a loop"] = partial(python_run, with_maxflow, PYMAXFLOW, file)
    if cgal is not None:
        works["CGAL"] = partial(cgal_run, cgal, file)
    race_graph("alpha-expansion", len(graph[0]), works)


if __name__ == "__main__":
    main()
