"""How far a long run is and how much time it will still take, from what its nodes took the last time."""

from __future__ import annotations

import logging
import time
from pathlib import Path

import pandas as pd
from kedro.framework.hooks import hook_impl
from kedro.io import CatalogProtocol
from kedro.pipeline import Pipeline
from kedro.pipeline.node import Node

from mlsroad_pipeline.hooks.node_tables import save_rows

logger = logging.getLogger(__name__)

KEY = "node_seconds"
"""The table in the catalog that keeps what each node took: columns ``node`` and ``seconds``."""
MEASURED = Path(__file__).with_name("node_seconds.csv")
"""What the nodes of `make run` took on two cores: expected as long as a project has not measured its own."""
MIN_NODES = 8
"""Shorter pipelines are not reported: `label` and its like tell of their scenes themselves."""
INTERVAL = 5.0
"""Least seconds between two lines."""


def in_words(seconds: float) -> str:
    """Return a duration as people say it."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def time_left(done: float, ahead: float, spent: float) -> float:
    """Return the seconds that a run will still take.

    What is ahead is stretched by how much slower or faster the run has been than expected so far. Early on, when little
    has been seen, the expectation counts for more.
    """
    trust = 10.0  # s of expectation that the pace so far is weighed against
    pace = (spent + trust) / (done + trust)
    return ahead * pace


class ProgressHooks:
    """Log how many nodes have ended, the time spent, and about how much is left.

    Each run that ends well keeps what its nodes took, and later ones expect that; before the first one what `make run`
    took on two cores is expected, and a pipeline of other nodes is told without time left. What a run does not compute
    again goes faster than expected, which the pace so far makes up for. Nodes have to run one after the other, as they
    do by default.
    """

    def __init__(self) -> None:
        self._catalog: CatalogProtocol | None = None
        self._expected: dict[str, float] = {}
        self._seconds: dict[str, float] = {}
        self._known = False
        self._began = self._node_began = self._told = 0.0
        self._node = ""

    @hook_impl
    def before_pipeline_run(self, pipeline: Pipeline, catalog: CatalogProtocol) -> None:
        """Read what the nodes took the last time."""
        self._catalog = None
        if len(pipeline.nodes) < MIN_NODES or KEY not in catalog:
            return
        self._catalog, self._seconds, self._node = catalog, {}, ""
        before = catalog.load(KEY) if catalog.exists(KEY) else pd.read_csv(MEASURED)
        kept = dict(zip(before["node"], before["seconds"].astype(float), strict=True))
        names = [node.name for node in pipeline.nodes]
        self._known = sum(name in kept for name in names) > len(names) / 2
        usual = float(before["seconds"].median())
        self._expected = {name: kept.get(name, usual) for name in names}
        self._began = self._told = time.perf_counter()

    @hook_impl
    def before_dataset_loaded(self, node: Node) -> None:
        """Note the node whose first input is loaded, and end the one before it."""
        if self._catalog is not None and node.name != self._node:
            self._turn_to(node.name)

    def _turn_to(self, name: str) -> None:
        now = time.perf_counter()
        if self._node:
            self._seconds[self._node] = now - self._node_began
        self._node, self._node_began = name, now
        if name and self._seconds and now - self._told >= INTERVAL:
            self._told = now
            logger.info("%s; next: %s", self.line(now - self._began), name.replace("_", " "))

    def line(self, spent: float) -> str:
        """Return the state of the run in words."""
        said = f"{len(self._seconds)} of {len(self._expected)} steps, {in_words(spent)}"
        if not self._known:
            return said
        done = sum(self._expected[name] for name in self._seconds)
        left = time_left(done, sum(self._expected.values()) - done, spent)
        return f"{said}, about {in_words(left)} left"

    @hook_impl
    def after_pipeline_run(self) -> None:
        """Keep what the nodes took; nodes of other pipelines keep their rows."""
        if self._catalog is None:
            return
        self._turn_to("")
        table = pd.DataFrame({"node": list(self._seconds), "seconds": list(self._seconds.values())})
        save_rows(self._catalog, KEY, table.round({"seconds": 3}))
        self._catalog = None

    @hook_impl
    def on_pipeline_error(self) -> None:
        """Forget the run."""
        self._catalog = None
