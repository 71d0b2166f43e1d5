"""Small runs of the benchmarks of speed: they print the lines that `make bench` reads; times are not tested."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
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


def test_a_disturbed_street_has_probabilities_and_keeps_its_ground(benchmark):
    streets = benchmark("judge_streets")
    rng = np.random.default_rng(0)
    local = rng.uniform(0, 9, (300, 3))
    height = np.where(np.arange(300) % 3 == 0, 0.0, local[:, 2])
    probabilities = rng.dirichlet(np.ones(len(streets.SCHEME)), 100).astype(np.float32)
    owner = np.where(np.arange(300) % 50 == 7, -1, np.arange(300) % 100)
    evidence = streets.ClassEvidence(probabilities, owner, streets.group_shares(streets.SCHEME))
    codes = [streets.TAXONOMY[name] for name in ("light_pole", "car")]
    objects = pd.DataFrame({"label": codes, "instance": [3, 4], "x": 4.0, "y": 5.0})
    street = streets.Street("s", local, np.zeros(3), height, evidence, owner, owner, objects)
    first, again, other = (streets.disturb(street, seed) for seed in (1, 1, 2))
    assert first.evidence.probabilities.sum(axis=1) == pytest.approx(np.ones(100), abs=1e-5)
    assert np.array_equal(first.evidence.probabilities, again.evidence.probabilities)
    assert not np.allclose(first.evidence.probabilities, other.evidence.probabilities)
    moved = first.local - local
    still, raised, pole = height == 0, height > 1, owner == 3
    assert (moved[still & ~pole] == 0).all() and (moved[:, 2] == 0).all()
    shear = moved[1, :2] / height[1]
    rest = raised & ~pole
    assert moved[rest, :2] / height[rest, None] == pytest.approx(np.tile(shear, (rest.sum(), 1)))
    lean = moved[raised & pole, :2] / height[raised & pole, None] - shear
    assert np.ptp(lean, axis=0) == pytest.approx(0, abs=1e-9)
    assert np.abs(lean).max() > 1e-4


def test_drawn_poles_are_labelled_tree_and_drawn_trunks_pole(benchmark):
    streets = benchmark("judge_streets")
    codes = [streets.TAXONOMY[name] for name in ("light_pole", "tree", "car")]
    objects = pd.DataFrame({"label": np.repeat(codes, 40), "instance": np.arange(1, 121), "x": 0.0, "y": 0.0})
    instance = np.repeat(np.arange(1, 121), 2)
    truth = np.repeat(objects["label"].to_numpy(), 2)
    truth[81:160:2] = streets.TAXONOMY["trunk"]  # a crown and a trunk of each tree
    logits = np.tile(np.arange(len(streets.SCHEME), dtype=float), (240, 1))
    owner = np.arange(240)
    evidence = streets.ClassEvidence(np.exp(logits), owner, streets.group_shares(streets.SCHEME))
    street = streets.Street("s", np.zeros((240, 3)), np.zeros(3), np.zeros(240), evidence, truth, instance, objects)
    out = streets.confuse_poles(street, logits, np.random.default_rng(2))
    tree, pole = streets.SCHEME.classes.index("tree"), streets.SCHEME.classes.index("pole")
    changed = out[:, tree] == pole
    assert ((out[:, pole] == tree) == changed).all()
    assert 10 <= changed[:80].sum() <= 30 and (changed[:80:2] == changed[1:80:2]).all()
    assert not changed[80:160:2].any() and 4 <= changed[81:160:2].sum() <= 16
    assert not changed[160:].any()
