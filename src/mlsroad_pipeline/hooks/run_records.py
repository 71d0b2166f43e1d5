"""Records of a tracked run: parameters, scores, figures, data, code and environment. Imports MLflow."""

import json
import re
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mlflow
import numpy as np
import pandas as pd
from kedro.io import CatalogProtocol
from kedro.pipeline import Pipeline
from mlflow.entities import LoggedModelInput, Run, RunTag

from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.datasets import report_files
from mlsroad_pipeline.datasets.inventory_dataset import RoadInventoryDataset
from mlsroad_pipeline.datasets.model_registry_dataset import RegisteredModelDataset
from mlsroad_pipeline.execution.scratch import scratch_folder
from mlsroad_pipeline.hooks import method_runs, run_details
from mlsroad_pipeline.hooks.interrupted_runs import PROCESS, this_process

SUMMARY = "label_summary"
"""Catalog entry of the summary of `label`."""
STAGE_TABLES = {
    "ground_scores": "ground",
    "supervoxel_quality": "supervoxels",
    "segmentation_scores": "segmentation",
    "object_scores": "objects",
}
"""Catalog entries with one row per split or per kind of object, and the names of their metrics."""

_ILLEGAL = re.compile(r"[^\w.\- /]")


def _part(name: object) -> str:
    return _ILLEGAL.sub("_", str(name).replace("/", "_"))


def label_metrics(summary: Mapping[str, Any], seconds: float) -> dict[str, float]:
    """Return the metrics of a labelled survey."""
    points, confidence = int(summary["n_points"]), summary["confidence"]
    labelled = sum(summary["classes"].values())
    metrics: dict[str, float | None] = {
        "points": points,
        "files": int(summary["n_files"]),
        "seconds": seconds,
        "points_per_second": points / seconds,
        "warnings": len(summary["warnings"]),
        "unusual_properties": len(summary.get("unusual", ())),
        "objects": sum(summary["objects"].values()),
        "confidence/median": confidence["median"],
        "confidence/low_share": confidence["low_share"],
    }
    for name, count in summary["classes"].items():
        metrics[f"points/{_part(name)}"] = count
        metrics[f"share/{_part(name)}"] = count / labelled
    metrics |= {f"confidence/median/{_part(name)}": value for name, value in confidence["class_medians"].items()}
    metrics |= {f"objects/{_part(kind)}": count for kind, count in summary["objects"].items()}
    metrics |= {f"metres/{_part(kind)}": length for kind, length in summary.get("lines", {}).items()}
    return {name: float(value) for name, value in metrics.items() if value is not None and np.isfinite(value)}


def stage_metrics(table: pd.DataFrame, stage: str) -> dict[str, float]:
    """Return ``<split>/<stage>/<column>`` of a table with one row per split, or per kind."""
    groups = table["split" if "split" in table else "kind"]
    numbers = [name for name in table.columns if pd.api.types.is_numeric_dtype(table[name])]
    values = {
        f"{_part(group)}/{stage}/{_part(name)}": float(value)
        for name in numbers
        for group, value in zip(groups, table[name], strict=True)
    }
    return {name: value for name, value in values.items() if np.isfinite(value)}


MAX_TABLE_ROWS = 10_000
"""Largest inventory that is also shown as a table; larger ones are files alone."""


class RunRecords:
    """Records of the run of one command and of its children, one per method.

    They go through separate clients to the run that was active when the pipeline started, so that threads of a runner
    cannot write to another run.
    """

    def __init__(self, run: Run, run_params: Mapping[str, Any], pipeline: Pipeline, catalog: CatalogProtocol) -> None:
        self._run_id, self._run_params = run.info.run_id, run_params
        self._pipeline, self._catalog = pipeline, catalog
        self._sources: set[str] = set()
        self._name, survey = (
            run_details.run_name(run_params, pipeline, catalog),
            run_details.survey_name(pipeline, catalog),
        )
        self._data_sets = method_runs.DataSets(survey)
        self._began = time.perf_counter()
        self._start(run)
        parent = mlflow.get_run(self._run_id)
        self._methods = method_runs.MethodRuns(parent, survey, self._data_sets, self._parameters_of)

    def _start(self, run: Run) -> None:
        names = self._run_params.get("pipeline_names") or [self._run_params.get("pipeline_name") or "__default__"]
        if run.info.run_name == "+".join(names):  # the name by kedro-mlflow, not one of the user's
            mlflow.MlflowClient().update_run(self._run_id, name=self._name)
        else:
            self._name = run.info.run_name
        self._log_parameters()
        self._log_code_and_environment(Path(self._run_params.get("project_path") or Path.cwd()))

    def _parameters_of(self, method: str) -> dict[str, str]:
        own = [n for n in self._pipeline.nodes if any(made.startswith(f"{method}.") for made in n.outputs)]
        if own or (group := f"params:{method}") not in self._pipeline.inputs():
            return run_details.short_parameters(run_details.pipeline_parameters(Pipeline(own), self._catalog))
        return run_details.short_parameters(
            run_details.flatten_parameters({method: self._catalog.load(group)})
        )  # in a study, one plan takes all

    def before_saving(self, dataset_name: str) -> None:
        """Open the run of the method whose model is registered now."""
        dataset = self._catalog.get(dataset_name)
        if isinstance(dataset, RegisteredModelDataset):
            self._methods.open(dataset.method)

    def add(self, dataset_name: str, data: Any) -> None:
        """Record a saved result."""
        self._sources.update(run_details.source_files(data))
        self._data_sets.add(data)
        dataset, (owner, _, rest) = self._catalog.get(dataset_name), dataset_name.partition(".")
        run_id = (
            self._methods.run_id(owner)
            if owner in METHODS and isinstance(dataset, report_files.FigureDataset | report_files.HtmlReportDataset)
            else self._run_id
        )
        if isinstance(dataset, RegisteredModelDataset):
            self._methods.close(dataset)
        elif isinstance(dataset, report_files.ScoresDataset) and owner.endswith("_study"):
            self._methods.log_study(dataset.load())
        elif isinstance(dataset, report_files.ScoresDataset):
            self._methods.log_scores(dataset.load())
        elif isinstance(dataset, report_files.MetricSeriesDataset) and owner in METHODS:
            self._methods.log_series(owner, dataset.load())
        elif isinstance(dataset, report_files.MetricSeriesDataset):
            method_runs.log_metrics(run_id, method_runs.series_metrics(dataset.load(), prefix=f"{rest}/"))
        elif isinstance(dataset, report_files.FigureDataset | report_files.HtmlReportDataset):
            self._log_file(run_id, dataset, "figures" if isinstance(dataset, report_files.FigureDataset) else "reports")
        elif isinstance(dataset, RoadInventoryDataset):
            self._log_inventory(dataset, data)
        elif dataset_name in STAGE_TABLES:
            method_runs.log_metrics(run_id, method_runs.plain_metrics(stage_metrics(data, STAGE_TABLES[dataset_name])))
        elif dataset_name == SUMMARY:
            self._log_label(data)

    def finish(self, status: str) -> None:
        """Record the data sets and the fingerprint of the raw files, and end the children."""
        client = mlflow.MlflowClient()
        if status == "FINISHED":
            if found := self._data_sets.all():
                client.log_inputs(self._run_id, datasets=found)
            if self._sources:
                fingerprint = run_details.fingerprint_files(sorted(self._sources))
                client.set_tag(self._run_id, "data.fingerprint", fingerprint["digest"])
                client.log_dict(self._run_id, fingerprint, "data_fingerprint.json")
        self._methods.finish(status)

    def _log_parameters(self) -> None:
        """Record the parameters of the pipeline under their dotted names, and all in full as `parameters.json`."""
        flat = run_details.pipeline_parameters(self._pipeline, self._catalog)
        method_runs.log_params(self._run_id, run_details.short_parameters(flat))
        text = json.dumps(flat, indent=2, ensure_ascii=False)
        mlflow.MlflowClient().log_text(self._run_id, text, "parameters.json")

    def _log_code_and_environment(self, project: Path) -> None:
        """Record the commit and whether files differ from it, the runner, Python, the platform and all packages."""
        versions, packages = run_details.environment()
        tags = versions | run_details.git_state(project)
        if "git.commit" in tags:
            tags["mlflow.source.git.commit"] = tags["git.commit"]
        tags[PROCESS] = this_process()
        tags["runner"] = run_details.runner_name(self._run_params.get("runner"))
        client = mlflow.MlflowClient()
        command = client.get_run(self._run_id).data.tags.get("kedro_command", "")
        tags["kedro_command"] = run_details.typed_command(command, self._run_params.get("env"), sys.argv)
        client.log_batch(self._run_id, tags=[RunTag(name, value) for name, value in tags.items()])
        client.log_text(self._run_id, "\n".join(packages) + "\n", "environment/pip_freeze.txt")

    def _log_label(self, summary: Mapping[str, Any]) -> None:
        """Record what `label` found, and name the run after the model."""
        client, model = mlflow.MlflowClient(), summary["model"]
        method_runs.log_metrics(
            self._run_id, method_runs.plain_metrics(label_metrics(summary, time.perf_counter() - self._began))
        )
        labelled_with = run_details.model_name(model)
        tags = {"mlsroad.method": summary["method"], "mlsroad.model": labelled_with}
        if summary.get("unusual"):
            tags["mlsroad.unusual"] = "; ".join(summary["unusual"])
        for tag, value in tags.items():
            client.set_tag(self._run_id, tag, str(value))
        client.update_run(self._run_id, name=f"{self._name} with {labelled_with}")
        if run_details.is_registered(model):
            version = client.get_model_version(str(model["name"]), str(model["version"]))
            model_id = version.model_id or version.source.removeprefix("models:/")
            client.log_inputs(self._run_id, models=[LoggedModelInput(model_id)])

    def _log_file(self, run_id: str, dataset: report_files.ReportFileDataset[Any, Any], folder: str) -> None:
        """Record a file as an artifact."""
        with tempfile.TemporaryDirectory(dir=scratch_folder()) as temporary:
            path = Path(temporary) / dataset.filename
            path.write_bytes(dataset.read_bytes())
            mlflow.MlflowClient().log_artifact(run_id, str(path), folder)

    def _log_inventory(self, dataset: RoadInventoryDataset, inventory: Any) -> None:
        """Record the file of an inventory and, once, its objects as a table."""
        client, path = mlflow.MlflowClient(), dataset.filepath
        client.log_artifact(self._run_id, str(path), "inventory")
        objects: pd.DataFrame = inventory.objects
        if path.suffix == ".parquet" and len(objects) <= MAX_TABLE_ROWS:
            client.log_table(self._run_id, data=objects, artifact_file="inventory/objects.json")
