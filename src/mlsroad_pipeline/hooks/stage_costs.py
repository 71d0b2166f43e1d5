"""Costs of each node of a run: wall time, processor time, and memory of the driver and its workers."""

import threading
import time
from collections.abc import Iterator
from contextlib import suppress

import pandas as pd
import psutil
from kedro.framework.context import KedroContext
from kedro.framework.hooks import hook_impl
from kedro.io import CatalogProtocol
from kedro.pipeline import Pipeline
from kedro.pipeline.node import Node


def save_rows(catalog: CatalogProtocol, key: str, table: pd.DataFrame) -> None:
    """Save the rows of the nodes of this run; rows of other nodes are kept."""
    if catalog.exists(key):
        before = catalog.load(key)
        table = pd.concat([before[~before["node"].isin(table["node"])], table], ignore_index=True)
    catalog.save(key, table)


KEY = "stage_costs"
"""Parameter with the sampling interval of the memory in seconds, and catalog entry of the table."""
GIB = 2**30


def _processes() -> Iterator[psutil.Process]:
    driver = psutil.Process()
    yield driver
    yield from driver.children(recursive=True)


def _processor_seconds() -> dict[int, float]:
    """Return the processor time of each process of the tree so far."""
    used = {}
    for process in _processes():
        with suppress(psutil.NoSuchProcess):  # the process has just ended
            times = process.cpu_times()
            used[process.pid] = times.user + times.system
    return used


def _memory() -> int:
    """Return the sum of the proportional set sizes of all processes of the tree, bytes."""
    total = 0
    for process in _processes():
        with suppress(psutil.NoSuchProcess):
            total += process.memory_full_info().pss
    return total


class StageCostsHooks:
    """Measure every node, including loading and saving, if the parameter `stage_costs` is set.

    Memory is sampled, so that a peak between two samples is missed. The processor time of a worker that ends within a
    node is not counted. Nodes must run sequentially, which is the default.
    """

    writes_to_project = True
    """`mlsroad` leaves the hook out where there is no project."""

    def __init__(self) -> None:
        self._interval: float | None = None
        self._catalog: CatalogProtocol | None = None
        self._rows: dict[str, dict[str, str | float]] = {}
        self._start, self._used = 0.0, dict[int, float]()
        self._peak = 0
        self._stop = threading.Event()
        self._watch: threading.Thread | None = None

    @hook_impl
    def after_context_created(self, context: KedroContext) -> None:
        """Read the parameter."""
        self._interval = context.config_loader["parameters"].get(KEY)

    @hook_impl
    def before_pipeline_run(self, pipeline: Pipeline, catalog: CatalogProtocol) -> None:
        """Start to sample the memory."""
        if self._interval is None or KEY in pipeline.inputs():
            return
        self._catalog, self._rows = catalog, {}
        self._stop.clear()
        self._watch = threading.Thread(target=self._sample, args=(self._interval,), name="stage-costs", daemon=True)
        self._watch.start()

    def _sample(self, interval: float) -> None:
        while not self._stop.wait(interval):
            self._peak = max(self._peak, _memory())

    @hook_impl
    def before_dataset_loaded(self, node: Node) -> None:
        """Record the start of a node at its first input."""
        self._record(node)

    @hook_impl
    def after_node_run(self, node: Node) -> None:
        """Record the costs of a node."""
        self._record(node)

    @hook_impl
    def after_dataset_saved(self, node: Node) -> None:
        """Record the costs of a node with its output: scene tasks run when the mapping of tasks is saved."""
        self._record(node)

    def _record(self, node: Node) -> None:
        if self._catalog is None:
            return
        used = _processor_seconds()
        if node.short_name not in self._rows:
            self._start, self._used, self._peak = time.perf_counter(), used, 0
        self._peak = max(self._peak, _memory())
        self._rows[node.short_name] = {
            "makes": node.outputs[0] if node.outputs else "",
            "seconds": time.perf_counter() - self._start,
            "cpu_seconds": sum(max(total - self._used.get(pid, 0.0), 0.0) for pid, total in used.items()),
            "peak_gib": self._peak / GIB,
        }

    @hook_impl
    def after_pipeline_run(self) -> None:
        """Save the table; rows of other nodes are kept."""
        if self._catalog is not None:
            table = pd.DataFrame.from_dict(self._rows, orient="index").rename_axis("node").reset_index()
            save_rows(self._catalog, KEY, table)
        self._end()

    @hook_impl
    def on_pipeline_error(self) -> None:
        """Stop sampling."""
        self._end()

    def _end(self) -> None:
        self._stop.set()
        if self._watch is not None:
            self._watch.join()
        self._catalog, self._watch = None, None
