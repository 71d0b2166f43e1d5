"""Batches of metrics and parameters of the sizes that MLflow accepts."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import mlflow
import pandas as pd
from mlflow.entities import Metric, Param
from mlflow.utils.validation import MAX_PARAM_VAL_LENGTH

_BATCH = 100


def _batches(entries: Sequence[Any]) -> Iterable[list[Any]]:
    return (list(entries[start : start + _BATCH]) for start in range(0, len(entries), _BATCH))


def now() -> int:
    """Return the current time, ms."""
    return int(time.time() * 1000)


def log_params(run_id: str, parameters: Mapping[str, str]) -> None:
    """Record parameters; a value above the limit of MLflow is cut."""
    limit = MAX_PARAM_VAL_LENGTH
    written = [Param(n, v if len(v) <= limit else v[: limit - 1] + "…") for n, v in parameters.items()]
    for batch in _batches(written):
        mlflow.MlflowClient().log_batch(run_id, params=batch)


def log_metrics(run_id: str, metrics: Sequence[Metric]) -> None:
    """Record metrics."""
    for batch in _batches(metrics):
        mlflow.MlflowClient().log_batch(run_id, metrics=batch)


def plain_metrics(values: Mapping[str, float]) -> list[Metric]:
    """Return metrics of step 0 that belong to no model."""
    stamp = now()
    return [Metric(name, value, stamp, 0) for name, value in values.items()]


def series_metrics(table: pd.DataFrame, *, prefix: str = "") -> list[Metric]:
    """Return every column of a table but the first as a metric by step; the first column holds the steps."""
    stamp, steps = now(), table.iloc[:, 0].astype(int).tolist()
    return [
        Metric(f"{prefix}{name}", value, stamp, step)
        for name in table.columns[1:]
        for step, value in zip(steps, table[name].astype(float).tolist(), strict=True)
    ]
