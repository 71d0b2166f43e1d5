"""Log of a run: progress with an ETA from the durations of earlier runs, then scores and reports."""

import logging
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
from kedro.framework.hooks import hook_impl
from kedro.io import CatalogProtocol
from kedro.pipeline import Pipeline
from kedro.pipeline.node import Node

from mlsroad_pipeline.datasets.report_files import HtmlReportDataset, ScoresDataset
from mlsroad_pipeline.hooks.stage_costs import save_rows

logger = logging.getLogger(__name__)

MOST_METHODS = 8
"""Largest number of methods whose scores are logged; larger comparisons end with a report."""
OVERALL = {
    **{"overall_accuracy": "overall accuracy", "mean_f1": "mean F1", "mean_iou": "mean IoU"},
    **{"precision": "precision", "recall": "recall", "f_score": "F-score"},
}
"""Metrics over all classes to their names."""


def score_lines(scores: pd.DataFrame) -> Iterator[str]:
    """Return one line per method and split: figures over all classes, then the F1 of each class.

    Examples
    --------
    >>> rows = [("forest", "test", "all", "mean_f1", 0.8, 9), ("forest", "test", "car", "f1", 0.7, 4)]
    >>> columns = ["method", "split", "class", "metric", "value", "support"]
    >>> list(score_lines(pd.DataFrame(rows, columns=columns)))
    ['forest, test: mean F1 0.800; F1: car 0.70']
    """
    known = scores[scores["value"].notna()]
    for (method, split), rows in known.groupby(["method", "split"], sort=False):
        whole = rows[rows["class"] == "all"].set_index("metric")["value"]
        overall = [f"{name} {whole[metric]:.3f}" for metric, name in OVERALL.items() if metric in whole]
        single = rows[(rows["class"] != "all") & (rows["metric"] == "f1") & (rows["support"] > 0)]
        classes = [f"{name} {value:.2f}" for name, value in zip(single["class"], single["value"], strict=True)]
        parts = [", ".join(overall)] * bool(overall) + [f"F1: {', '.join(classes)}"] * bool(classes)
        yield f"{method}, {split}: {'; '.join(parts)}"


class ClosingLinesHooks:
    """Log the scores and the paths of the reports of a run as its last lines."""

    def __init__(self) -> None:
        self._catalog: CatalogProtocol | None = None
        self._scores: list[pd.DataFrame] = []
        self._reports: list[str] = []

    @hook_impl
    def before_pipeline_run(self, catalog: CatalogProtocol) -> None:
        """Begin anew."""
        self._catalog, self._scores, self._reports = catalog, [], []

    @hook_impl
    def after_dataset_saved(self, dataset_name: str, data: Any) -> None:
        """Keep scores and the paths of reports."""
        dataset = None if self._catalog is None else self._catalog.get(dataset_name)
        if isinstance(dataset, ScoresDataset):
            self._scores.append(data)
        elif isinstance(dataset, HtmlReportDataset):
            self._reports.append(str(dataset._describe()["filepath"]))

    @hook_impl(trylast=True)
    def after_pipeline_run(self) -> None:
        """Log the lines."""
        if len(self._scores) <= MOST_METHODS:
            for line in (line for table in self._scores for line in score_lines(table)):
                logger.info(line)
        for path in self._reports:
            logger.info("Report: %s", path if "://" in path else Path(path).absolute())
        self._catalog, self._scores, self._reports = None, [], []


KEY = "node_seconds"
"""Catalog entry with the duration of each node: columns ``node`` and ``seconds``."""
MEASURED = Path(__file__).with_name("node_seconds.csv")
"""Durations of the nodes of `make run` on two cores: the expectation until a project has measured its own."""
MIN_NODES = 8
"""Smallest number of nodes of a reported pipeline; in shorter ones, such as `label`, the stages report scenes."""
INTERVAL = 5.0
"""Smallest interval between two lines, seconds."""


def in_words(seconds: float) -> str:
    """Return a duration as text, such as ``2 min 5 s``."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def time_left(done: float, ahead: float, spent: float) -> float:
    """Return the remaining time of a run, seconds.

    The expected time `ahead` is scaled by the ratio of the time `spent` to the expected time `done` of the completed
    nodes. The ratio is damped towards 1 early in a run.
    """
    damping = 10.0  # s
    pace = (spent + damping) / (done + damping)
    return ahead * pace


class ProgressHooks:
    """Log the number of completed nodes, the elapsed time and an estimate of the time left.

    Each successful run stores the durations of its nodes as the expectation for later runs. The first run uses those of
    `make run` on two cores; a pipeline of other nodes is reported without an ETA.
    """

    writes_to_project = True
    """`mlsroad` leaves the hook out where there is no project."""

    def __init__(self) -> None:
        self._catalog: CatalogProtocol | None = None
        self._expected: dict[str, float] = {}
        self._seconds: dict[str, float] = {}
        self._known = False
        self._began = self._node_began = self._reported = 0.0
        self._node = ""

    @hook_impl
    def before_pipeline_run(self, pipeline: Pipeline, catalog: CatalogProtocol) -> None:
        """Read the durations of the previous run."""
        self._catalog = None
        if len(pipeline.nodes) < MIN_NODES or KEY not in catalog:
            return
        self._catalog, self._seconds, self._node = catalog, {}, ""
        before = catalog.load(KEY) if catalog.exists(KEY) else pd.read_csv(MEASURED)
        kept = dict(zip(before["node"], before["seconds"].astype(float), strict=True))
        names = [node.short_name for node in pipeline.nodes]
        self._known = sum(name in kept for name in names) > len(names) / 2
        usual = float(before["seconds"].median())
        self._expected = {name: kept.get(name, usual) for name in names}
        self._began = self._reported = time.perf_counter()

    @hook_impl
    def before_dataset_loaded(self, node: Node) -> None:
        """Record the start of a node, at its first input, and the end of the previous one."""
        if self._catalog is not None and node.short_name != self._node:
            self._start_node(node.short_name)

    def _start_node(self, name: str) -> None:
        now = time.perf_counter()
        if self._node:
            self._seconds[self._node] = now - self._node_began
        self._node, self._node_began = name, now
        if name and self._seconds and now - self._reported >= INTERVAL:
            self._reported = now
            logger.info("%s; next: %s", self.line(now - self._began), name.replace("_", " "))

    def line(self, spent: float) -> str:
        """Return the progress line for an elapsed time in seconds."""
        text = f"{len(self._seconds)} of {len(self._expected)} steps, {in_words(spent)}"
        if not self._known:
            return text
        done = sum(self._expected[name] for name in self._seconds)
        left = time_left(done, sum(self._expected.values()) - done, spent)
        return f"{text}, about {in_words(left)} left"

    @hook_impl
    def after_pipeline_run(self) -> None:
        """Store the durations of the nodes; rows of other pipelines are kept."""
        if self._catalog is None:
            return
        self._start_node("")
        table = pd.DataFrame({"node": list(self._seconds), "seconds": list(self._seconds.values())})
        save_rows(self._catalog, KEY, table.round({"seconds": 3}))
        self._catalog = None

    @hook_impl
    def on_pipeline_error(self) -> None:
        """Discard the run."""
        self._catalog = None
