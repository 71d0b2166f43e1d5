"""ETA of a run, and the summary of `make run`."""

import logging

import pandas as pd
import pytest
from kedro.framework.hooks import _create_hook_manager
from kedro.io import DataCatalog, MemoryDataset
from kedro.pipeline import Node, Pipeline
from kedro.runner import SequentialRunner

from mlsroad_pipeline.commands import summary
from mlsroad_pipeline.hooks import progress
from mlsroad_pipeline.hooks.progress import KEY, MEASURED, ProgressHooks, in_words, time_left

CLOCK = "mlsroad_pipeline.hooks.progress.time.perf_counter"


def chain(n):
    """Return n nodes, each of which takes its number of seconds on the clock."""
    return Pipeline([Node(lambda v: v, f"d{i}", f"d{i + 1}", name=f"node_{i}") for i in range(n)])


@pytest.fixture
def ended(monkeypatch, caplog):
    """Run a chain whose node i takes i seconds; return the logged lines."""
    clock = {"now": 0.0}
    monkeypatch.setattr(CLOCK, lambda: clock["now"])

    class Clock:
        from kedro.framework.hooks import hook_impl

        @hook_impl
        def after_node_run(self, node):
            clock["now"] += float(node.name.removeprefix("node_"))

    hooks, manager = ProgressHooks(), _create_hook_manager()
    manager.register(hooks)
    manager.register(Clock())

    def run(n, table=None):
        pipeline = chain(n)
        catalog = DataCatalog({"d0": MemoryDataset(1), KEY: MemoryDataset() if table is None else MemoryDataset(table)})
        caplog.clear()
        with caplog.at_level(logging.INFO, "mlsroad_pipeline.hooks.progress"):
            manager.hook.before_pipeline_run(run_params={}, pipeline=pipeline, catalog=catalog)
            SequentialRunner().run(pipeline, catalog, manager)
            manager.hook.after_pipeline_run(run_params={}, run_result={}, pipeline=pipeline, catalog=catalog)
        return [record.getMessage() for record in caplog.records], catalog

    return run


def test_a_second_run_knows_what_is_left_to_the_second(ended):
    first, catalog = ended(10)
    assert first and not any("left" in line for line in first)
    table = catalog.load(KEY)
    assert table["seconds"].tolist() == list(range(10))
    second, _ = ended(10, table)
    for line in second:
        n_done = int(line.split(" of ")[0])
        assert f"about {in_words(sum(range(n_done, 10)))} left; next: node {n_done}" in line


def test_nodes_that_did_not_run_keep_their_rows(ended):
    _, catalog = ended(9, pd.DataFrame({"node": ["node_1", "elsewhere"], "seconds": [50.0, 7.0]}))
    kept = catalog.load(KEY).set_index("node")["seconds"]
    assert kept["elsewhere"] == 7.0 and kept["node_1"] == 1.0 and len(kept) == 10


def test_short_pipelines_are_left_alone(ended):
    lines, catalog = ended(progress.MIN_NODES - 1)
    assert not lines and not catalog.exists(KEY)


def test_a_slower_machine_is_noticed():
    assert time_left(0.0, 100.0, 0.0) == 100.0
    assert time_left(100.0, 100.0, 200.0) == pytest.approx(191, abs=1)
    assert time_left(100.0, 100.0, 2.0) < 12


@pytest.mark.parametrize(("seconds", "words"), [(0, "0 s"), (59.4, "59 s"), (59.6, "1 min 0 s"), (185, "3 min 5 s")])
def test_durations_in_words(seconds, words):
    assert in_words(seconds) == words


def test_what_a_first_run_expects_names_the_nodes_of_make_run():
    from kedro.framework.project import configure_project, pipelines

    configure_project("mlsroad_pipeline")
    names = {node.short_name for node in pipelines["all_methods"].nodes}
    assert set(pd.read_csv(MEASURED)["node"]) == names


def test_summary_has_every_table_the_report_and_three_commands(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert summary.main() == 1
    assert "comparison.csv does not exist" in capsys.readouterr().err
    folder = tmp_path / summary.REPORTING
    folder.mkdir(parents=True)
    for number, name in enumerate(summary.TABLES):
        pd.DataFrame({"method": [f"method_{number}"], "mean_f1": [0.5]}).to_csv(folder / name, index=False)
    assert summary.main() == 0
    said = capsys.readouterr().out
    assert all(f"method_{number}  " in said for number in range(4)) and "0.500" in said
    assert str(folder / "report.html") in said
    assert said.count("\n    ") == 3
