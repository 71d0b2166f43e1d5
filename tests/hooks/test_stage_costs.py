"""Costs of nodes of known duration."""

import time

import numpy as np
import pandas as pd
import pytest
from kedro.framework.hooks import _create_hook_manager
from kedro.io import DataCatalog, MemoryDataset
from kedro.pipeline import Node, Pipeline
from kedro.runner import SequentialRunner

from mlsroad_pipeline.hooks.stage_costs import KEY, StageCostsHooks


def sleep(value):
    time.sleep(0.3)
    return value


def count(value):
    end = time.process_time() + 0.3
    while time.process_time() < end:
        pass
    return np.ones(20_000_000) + value  # 160 MB


@pytest.fixture
def measured():
    hooks, manager = StageCostsHooks(), _create_hook_manager()
    manager.register(hooks)
    hooks._interval = 0.05
    nodes = Pipeline([Node(sleep, "a", "b", name="sleep"), Node(count, "b", "c", name="count")])

    def run(catalog, pipeline=nodes):
        manager.hook.before_pipeline_run(run_params={}, pipeline=pipeline, catalog=catalog)
        SequentialRunner().run(pipeline, catalog, manager)
        manager.hook.after_pipeline_run(run_params={}, run_result={}, pipeline=pipeline, catalog=catalog)

    return run


def test_every_node_has_its_times_and_its_memory(measured):
    catalog = DataCatalog({"a": MemoryDataset(1), "c": MemoryDataset(), KEY: MemoryDataset()})
    measured(catalog)
    table = catalog.load(KEY).set_index("node")
    assert table["makes"].to_dict() == {"sleep": "b", "count": "c"}
    assert (table["seconds"] >= 0.3).all()
    assert table.loc["count", "cpu_seconds"] >= max(0.3, table.loc["sleep", "cpu_seconds"])
    assert table.loc["count", "peak_gib"] - table.loc["sleep", "peak_gib"] > 0.1


def test_nodes_that_did_not_run_keep_their_rows_and_reports_are_not_measured(measured):
    before = pd.DataFrame(
        {"node": ["other", "count"], "makes": "x", "seconds": 1e9, "cpu_seconds": 7.0, "peak_gib": 7.0}
    )
    catalog = DataCatalog({"a": MemoryDataset(1), "c": MemoryDataset(), KEY: MemoryDataset(before)})
    measured(catalog, Pipeline([Node(len, KEY, "n", name="report")]))
    pd.testing.assert_frame_equal(catalog.load(KEY), before)
    measured(catalog)
    found = catalog.load(KEY).set_index("node")["seconds"]
    assert list(found.index) == ["other", "sleep", "count"]
    assert found["other"] == 1e9 > found["count"]
