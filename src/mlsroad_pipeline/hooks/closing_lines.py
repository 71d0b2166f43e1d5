"""Last lines of a run: the scores it computed and the reports it wrote."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
from kedro.framework.hooks import hook_impl
from kedro.io import CatalogProtocol

from mlsroad_pipeline.datasets.html_report_dataset import HtmlReportDataset
from mlsroad_pipeline.datasets.scores_dataset import ScoresDataset

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
