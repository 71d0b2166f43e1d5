"""Small runs of the benchmarks of speed: they print the lines that `make bench` reads; times are not tested."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"


@pytest.fixture
def benchmark(monkeypatch):
    """Function that imports a program of the folder of benchmarks."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    before = set(sys.modules)
    yield importlib.import_module
    for name in set(sys.modules) - before:
        if str(BENCHMARKS) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def rows_of(text):
    return [json.loads(line) for line in text.splitlines() if line.startswith("{")]


def test_every_benchmark_of_the_list_is_there(benchmark):
    for name in benchmark("run_all").BENCHMARKS:
        assert (BENCHMARKS / f"bench_{name}.py").is_file()


def test_a_small_graph_reaches_the_same_energy_each_time(benchmark):
    graph_cuts = benchmark("bench_graph_cuts")
    name = "cloud of 2,000, 5 labels, weight 0.4"
    (timed,) = graph_cuts.race_graphs(None, [name])[name].values()
    unary, edges, weights = graph_cuts.GRAPHS[name]()
    assert timed.result == pytest.approx(graph_cuts.own_run(unary, edges, weights))
    assert len(graph_cuts.GRAPHS) == 10
    assert 0 < timed.result < unary.mean(axis=0).min() * len(unary)


def test_a_small_forest_and_a_small_cloud_give_ratios(benchmark, capsys, rng):
    benchmark("bench_forest").race_forests(1, ((3, 200, 6, 3, 1),), n_rows=300)
    cloud = np.concatenate([rng.random((3000, 3)) * [20, 20, 0.1], [[10.0, 10.0, 30.0]]])
    benchmark("bench_ground").race_outliers(cloud, 1)
    rows = rows_of(capsys.readouterr().out)
    assert [row["outliers"] for row in rows[2:]] == [rows[2]["outliers"]] * 3
    run_all = benchmark("run_all")
    found = run_all.ratios(rows)
    assert {row["rival"] for row in found} == {"scikit-learn", "SciPy cKDTree, 1 thread"}
    table = run_all.ratio_table(found)
    assert str(len(cloud))[0] in table
    assert all(f"{row['ratio']:.2f}" in table for row in found)
