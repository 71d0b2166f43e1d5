"""Tables of the benchmark of recordings."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.metrics.calibration import ReliabilityTable
from mlsroad_pipeline.algorithms.metrics.confusion import LabellingScores, scores
from mlsroad_pipeline.algorithms.metrics.scores import ALL, COLUMNS, check_scores
from mlsroad_pipeline.papers.comparison.recordings.parameters import PROTOCOLS
from mlsroad_pipeline.papers.comparison.recordings.plan import Run, StudyPlan, model_key

PARTS = ("all", "test")
"""Scored points of a recording: all, or those of its test part."""


def study_tables(
    plan: StudyPlan, results: Mapping[str, Mapping[str, Any]], times: Mapping[str, Mapping[str, NDArray]]
) -> dict[str, pd.DataFrame]:
    """Make the tables of all stored runs; splits of the scores are ``<source>/<protocol>/<part>``."""
    long, wide, bins = [], [], []
    for run in stored_runs(plan, results):
        result = results[run.key]
        trained = times.get(model_key(plan, run), {})
        for part in (name for name in PARTS if name in result):
            figures = scored_part(plan, run, result[part])
            long.append(_long_rows(run, part, figures))
            wide.append(benchmark_row(run, part, figures, result, trained))
            bins.append(_bins(run, part, figures.table))
    scores = check_scores(pd.concat(long, ignore_index=True))
    return {"scores": scores, "benchmark": pd.DataFrame(wide), "reliability": pd.concat(bins)}


def stored_runs(plan: StudyPlan, results: Mapping[str, Any]) -> list[Run]:
    """Return the stored runs of known recordings, ordered by recording, protocol and method."""
    runs = [run for run in map(Run.parse, results) if run.source in plan.sources]
    sources = list(plan.sources)
    return sorted(runs, key=lambda run: (sources.index(run.source), PROTOCOLS.index(run.protocol), run.method))


@dataclass(frozen=True)
class PartScores:
    """Scores of one part of a recording."""

    figures: LabellingScores
    names: tuple[str, ...]  # classes of the scheme
    counted: NDArray[np.bool_]  # classes that are part of means
    table: ReliabilityTable
    auroc: float
    brier_score: float

    def mean(self, metric: str) -> float:
        """Return the mean of a metric over the classes that are counted; NaN if there is none."""
        values = np.nan_to_num(getattr(self.figures, metric)[self.counted])
        return float(values.mean()) if len(values) else float("nan")

    def of_class(self, metric: str) -> Iterator[tuple[str, float, int]]:
        """Yield name, value and support of each counted class."""
        for label in np.flatnonzero(self.counted):
            yield self.names[label], float(getattr(self.figures, metric)[label]), int(self.figures.support[label])


def scored_part(plan: StudyPlan, run: Run, stored: Mapping[str, NDArray]) -> PartScores:
    """Return the scores of a part: means are over the recording's classes that have enough points in it."""
    figures, names = scores(stored["matrix"]), plan.scheme.classes
    own = plan.sources[run.source].classes
    counted = np.array([name in own for name in names]) & (figures.support >= plan.study.least_points)
    table = ReliabilityTable(stored["bin_counts"], stored["bin_hits"], stored["bin_confidences"])
    return PartScores(figures, names, counted, table, float(stored["auroc"]), float(stored["brier_score"]))


def _overall(part: PartScores) -> dict[str, float]:
    return {
        "overall_accuracy": part.figures.overall_accuracy,
        "mean_iou": part.mean("iou"),
        "mean_f1": part.mean("f1"),
        "calibration_error": part.table.calibration_error,
        "auroc": part.auroc,
        "brier_score": part.brier_score,
    }


def _long_rows(run: Run, part: str, found: PartScores) -> pd.DataFrame:
    split, total = f"{run.source}/{run.protocol}/{part}", int(found.figures.support.sum())
    rows: list[tuple[Any, ...]] = [
        (run.method, split, name, metric, value, support)
        for metric in ("iou", "f1")
        for name, value, support in found.of_class(metric)
    ]
    rows += [(run.method, split, ALL, metric, value, total) for metric, value in _overall(found).items()]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def benchmark_row(
    run: Run, part: str, found: PartScores, result: Mapping[str, Any], trained: Mapping[str, NDArray]
) -> dict[str, Any]:
    """Return a row of the wide table: overall figures, IoU and F1 per class, seconds per million points, date."""
    times = result["times"]
    millions = float(times["points"]) / 1e6
    per_class = {f"{metric}_{name}": value for metric in ("iou", "f1") for name, value, _ in found.of_class(metric)}
    return {
        "source": run.source,
        "protocol": run.protocol,
        "method": run.method,
        "part": part,
        "points": int(found.figures.support.sum()),
        **_overall(found),
        **per_class,
        "seconds_per_million": float(times["seconds"]) / millions,
        "cpu_seconds_per_million": float(times["cpu_seconds"]) / millions,
        "train_cpu_seconds": float(trained["cpu_seconds"]) if "cpu_seconds" in trained else float("nan"),
        "finished": str(result["finished"]["date"]),
    }


def _bins(run: Run, part: str, table: ReliabilityTable) -> pd.DataFrame:
    ends = np.arange(1, len(table.counts) + 1) / len(table.counts)
    return pd.DataFrame(
        {
            "source": run.source, "protocol": run.protocol, "method": run.method, "part": part,
            "confidence_below": ends, "points": table.counts, "confidence": table.confidence,
            "accuracy": table.accuracy,
        }
    )  # fmt: skip


def shown_part(protocol: str) -> str:
    """Return the part that reports show: all points of recordings that a run was not trained on, else the test part."""
    return "test" if protocol.startswith("own") else "all"


def shown_rows(benchmark: pd.DataFrame) -> pd.DataFrame:
    """Return one row per run: that of its `shown_part`."""
    parts: Sequence[str] = [shown_part(protocol) for protocol in benchmark["protocol"]]
    return benchmark[benchmark["part"] == np.array(parts)].reset_index(drop=True)
