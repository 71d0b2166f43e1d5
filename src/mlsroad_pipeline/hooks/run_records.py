"""Records of a tracked run: parameters, scores, figures, data, code and environment. Imports MLflow."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import mlflow
from kedro.io import CatalogProtocol
from kedro.pipeline import Pipeline
from mlflow.entities import Metric, Param, RunTag
from mlflow.utils.validation import MAX_PARAM_VAL_LENGTH

from mlsroad_pipeline.algorithms.metrics.scores import scores_to_metrics
from mlsroad_pipeline.datasets.reports.figure_dataset import FigureDataset
from mlsroad_pipeline.datasets.reports.html_report_dataset import HtmlReportDataset
from mlsroad_pipeline.datasets.reports.metric_series_dataset import MetricSeriesDataset
from mlsroad_pipeline.datasets.reports.report_file import ReportFileDataset
from mlsroad_pipeline.datasets.reports.scores_dataset import ScoresDataset
from mlsroad_pipeline.hooks.data_fingerprint import fingerprint_files, source_files
from mlsroad_pipeline.hooks.run_details import environment, flatten_parameters, git_state, is_parameter

_BATCH = 100


def _batches(entries: list[Any]) -> Iterable[list[Any]]:
    """Split a list into batches of the size that MLflow accepts."""
    return (entries[start : start + _BATCH] for start in range(0, len(entries), _BATCH))


class RunRecords:
    """Records of one run.

    They go to the run that was active when the pipeline started, through separate clients, so that threads of a runner
    cannot write to another run.
    """

    def __init__(self, run_id: str, catalog: CatalogProtocol) -> None:
        self._run_id = run_id
        self._catalog = catalog
        self._sources: set[str] = set()

    def start(self, pipeline: Pipeline, project: Path) -> None:
        """Record parameters, code and environment."""
        self.log_parameters(pipeline)
        self.log_code_and_environment(project)
        for name in pipeline.inputs():
            dataset = None if is_parameter(name) else self._catalog.get(name)
            if dataset is not None and hasattr(dataset, "source_files"):
                self._sources.update(map(str, dataset.source_files()))

    def add(self, dataset_name: str, data: Any) -> None:
        """Record a saved result."""
        self._sources.update(source_files(data))
        dataset = self._catalog.get(dataset_name)
        if isinstance(dataset, ScoresDataset):
            self.log_scores(dataset)
        elif isinstance(dataset, MetricSeriesDataset):
            self.log_series(dataset, dataset_name.split(".", maxsplit=1)[0])
        elif isinstance(dataset, FigureDataset):
            self.log_file(dataset, "figures")
        elif isinstance(dataset, HtmlReportDataset):
            self.log_file(dataset, "reports")

    def finish(self) -> None:
        """Record the fingerprint of the raw files."""
        if self._sources:
            self.log_fingerprint(sorted(self._sources))

    def log_parameters(self, pipeline: Pipeline) -> None:
        """Record every parameter of the pipeline under its dotted name, and all in full as `parameters.json`."""
        parameters: dict[str, Any] = {}
        for name in sorted(filter(is_parameter, pipeline.inputs())):
            value = self._catalog.load(name)
            parameters.update(value if name == "parameters" else {name.removeprefix("params:"): value})
        # `a` and `a.b`, inputs of two nodes, are one parameter
        inner = {name for name in parameters if any(name.startswith(f"{other}.") for other in parameters)}
        flat = flatten_parameters({name: value for name, value in parameters.items() if name not in inner})
        client = mlflow.MlflowClient()
        limit = MAX_PARAM_VAL_LENGTH
        written = [Param(n, v if len(v) <= limit else v[: limit - 1] + "…") for n, v in flat.items()]
        for batch in _batches(written):
            client.log_batch(self._run_id, params=batch)
        client.log_text(self._run_id, json.dumps(flat, indent=2, ensure_ascii=False), "parameters.json")

    def log_code_and_environment(self, project: Path) -> None:
        """Record the commit and whether files differ from it, Python, the platform and all packages."""
        python = environment()
        tags = python.tags | git_state(project)
        if "git.commit" in tags:
            tags["mlflow.source.git.commit"] = tags["git.commit"]
        client = mlflow.MlflowClient()
        client.log_batch(self._run_id, tags=[RunTag(name, value) for name, value in tags.items()])
        client.log_text(self._run_id, "\n".join(python.packages) + "\n", "environment/pip_freeze.txt")

    def log_scores(self, dataset: ScoresDataset) -> None:
        """Record every defined score as the metric ``<slug>/<split>/<metric>/<class>``."""
        now = int(time.time() * 1000)
        metrics = [Metric(name, value, now, 0) for name, value in scores_to_metrics(dataset.load()).items()]
        for batch in _batches(metrics):
            mlflow.MlflowClient().log_batch(self._run_id, metrics=batch)

    def log_series(self, dataset: MetricSeriesDataset, slug: str) -> None:
        """Record every column as the metric ``<slug>/<column>`` by step."""
        now, table = int(time.time() * 1000), dataset.load()
        steps = table.iloc[:, 0].astype(int).tolist()
        metrics = [
            Metric(f"{slug}/{name}", value, now, step)
            for name in table.columns[1:]
            for step, value in zip(steps, table[name].astype(float).tolist(), strict=True)
        ]
        for batch in _batches(metrics):
            mlflow.MlflowClient().log_batch(self._run_id, metrics=batch)

    def log_file(self, dataset: ReportFileDataset, folder: str) -> None:
        """Record a file as an artifact."""
        with tempfile.TemporaryDirectory() as temporary:
            path = Path(temporary) / dataset.filename
            path.write_bytes(dataset.read_bytes())
            mlflow.MlflowClient().log_artifact(self._run_id, str(path), folder)

    def log_fingerprint(self, paths: list[str]) -> None:
        """Record the digest of all raw files as a tag and those of the files in `data_fingerprint.json`."""
        fingerprint = fingerprint_files(paths)
        client = mlflow.MlflowClient()
        client.set_tag(self._run_id, "data.fingerprint", fingerprint.digest)
        client.log_dict(self._run_id, fingerprint.table(), "data_fingerprint.json")
