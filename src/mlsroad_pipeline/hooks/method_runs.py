"""Child runs of a tracked run, one per method: scores, series, figures, data sets and the registered model."""

import json
import os
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mlflow
import pandas as pd
from mlflow.entities import Dataset, DatasetInput, InputTag, LoggedModelInput, Metric, Param, Run
from mlflow.utils.mlflow_tags import MLFLOW_PARENT_RUN_ID
from mlflow.utils.validation import MAX_PARAM_VAL_LENGTH

from mlsroad_pipeline.algorithms.core.scene_key import TRAIN, SceneKey
from mlsroad_pipeline.algorithms.metrics.scores import scores_to_metrics, summary
from mlsroad_pipeline.datasets.model_registry_dataset import RegisteredModelDataset
from mlsroad_pipeline.hooks.interrupted_runs import PROCESS
from mlsroad_pipeline.hooks.run_details import fingerprint_files, source_files

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


_LABELLED = "survey"
"""Split of `label`."""


class DataSets:
    """Data sets by split.

    The files of a split are those of the first saved tasks that read any: the point clouds. Images, which only some
    methods read, are in the fingerprint of the run.
    """

    def __init__(self, survey: str) -> None:
        self._survey = survey
        self._files: dict[str, tuple[str, ...]] = {}
        self._made: dict[str, DatasetInput] = {}

    def add(self, tasks: Any) -> None:
        """Take the raw files of saved tasks; other results have none."""
        if not isinstance(tasks, Mapping):
            return
        found: dict[str, set[str]] = {}
        for key, task in tasks.items():
            files = [path for path in source_files({key: task}) if os.path.isfile(path)]  # a model is a folder
            if files and isinstance(key, str):
                found.setdefault(SceneKey.parse(key).split, set()).update(map(os.path.abspath, files))
        for split, paths in found.items():
            self._files.setdefault(split, tuple(sorted(paths)))

    def of(self, split: str) -> DatasetInput | None:
        """Return the data set of a split or of one of its parts such as `test_visible`, None if no file is known."""
        candidates = [name for name in self._files if split == name or split.startswith(f"{name}_")]
        if not candidates:
            return None
        name = max(candidates, key=len)
        if name not in self._made:
            context = {TRAIN: "training", _LABELLED: "labelling"}.get(name, "testing")
            title = self._survey if name == _LABELLED else f"{self._survey} {name}".strip()
            data = _data_set(self._files[name], title)
            self._made[name] = DatasetInput(data, [InputTag("mlflow.data.context", context)])
        return self._made[name]

    def all(self) -> list[DatasetInput]:
        """Return the data sets of all splits."""
        return [found for found in map(self.of, self._files) if found is not None]


def _data_set(files: Sequence[str], title: str) -> Dataset:
    """Return the data set of raw files; MLflow shows the name and the digest."""
    profile = {"num_files": len(files), "num_bytes": sum(os.path.getsize(path) for path in files)}
    place = files[0] if len(files) == 1 else os.path.commonpath([os.path.dirname(path) for path in files])
    return Dataset(
        name=title or Path(files[0]).name,
        digest=fingerprint_files(files)["digest"],
        source_type="local",
        source=json.dumps({"uri": place}),
        profile=json.dumps(profile),
    )


METHOD = "mlsroad.method"
"""Tag of a child run: the slug of the method."""
DATA, PROTOCOL = "mlsroad.data", "mlsroad.protocol"
"""Tags of a child run of a study: the recording, street or set of objects; the protocol, if there are several."""
_INHERITED = (
    "mlflow.user", "mlflow.source.name", "mlflow.source.type", "mlflow.source.git.commit", "git.commit", PROCESS
)  # fmt: skip


@dataclass
class _Child:
    run_id: str
    model: tuple[str, str, str] | None = None  # name, version, identifier of the logged model
    unlinked: list[Metric] = field(default_factory=list)
    inputs: set[tuple[str, str]] = field(default_factory=set)
    scores: list[pd.DataFrame] = field(default_factory=list)


def _copied(metric: Metric, model_id: str | None) -> Metric:
    names = (metric.key, metric.value, metric.timestamp, metric.step)
    return Metric(*names, model_id=model_id, dataset_name=metric.dataset_name, dataset_digest=metric.dataset_digest)


class MethodRuns:
    """Child runs by method; a child is created with the first record of its method."""

    def __init__(
        self, parent: Run, survey: str, data_sets: DataSets, parameters: Callable[[str], Mapping[str, str]]
    ) -> None:
        self._parent, self._survey, self._data_sets, self._parameters = parent, survey, data_sets, parameters
        self._children: dict[str, _Child] = {}
        self._lock = threading.RLock()

    def __contains__(self, method: str) -> bool:
        """Return whether a method has a run."""
        return method in self._children

    def run_id(self, method: str) -> str:
        """Return the identifier of the run of a method, which is created if there is none."""
        return self._child(method).run_id

    def _child(self, method: str, data: str = "", protocol: str = "") -> _Child:
        """Return the run of a method, in a study that on one data set."""
        with self._lock:
            key = "/".join(filter(None, (method, data, protocol)))
            if key not in self._children:
                info, tags = self._parent.info, self._parent.data.tags
                kept = {name: tags[name] for name in _INHERITED if name in tags}
                own = {tag: text for tag, text in ((METHOD, method), (DATA, data), (PROTOCOL, protocol)) if text}
                place = data or self._survey
                name = f"{method}, {protocol}" if protocol else method
                run = mlflow.MlflowClient().create_run(
                    info.experiment_id,
                    run_name=f"{name} on {place}" if place else name,
                    tags={
                        **kept,
                        MLFLOW_PARENT_RUN_ID: info.run_id,
                        **{tag: text for tag, text in own.items() if text},
                    },
                )
                self._children[key] = _Child(run.info.run_id)
                chosen = {"method": method, "data": data, "protocol": protocol} if data else {}
                log_params(run.info.run_id, {**self._parameters(method), **{n: v for n, v in chosen.items() if v}})
            return self._children[key]

    def open(self, method: str) -> None:
        """Make the run of a method the active one: what MLflow records now belongs to it."""
        mlflow.start_run(run_id=self.run_id(method), nested=True, log_system_metrics=False)

    def close(self, dataset: RegisteredModelDataset) -> None:
        """Make the parent active again and link the scores of the method to the model that was registered."""
        mlflow.end_run()
        client, child = mlflow.MlflowClient(), self._child(dataset.method)
        name, number = dataset.registered_name, str(dataset.saved_version)
        version = client.get_model_version(name, number)
        model_id = version.model_id or version.source.removeprefix("models:/")
        child.model = (name, number, model_id)
        if version.run_id != child.run_id:  # unchanged: the model of an earlier run
            client.log_inputs(child.run_id, models=[LoggedModelInput(model_id)])
        self._log_inputs(child, self._data_sets.of(TRAIN))
        log_metrics(child.run_id, [_copied(metric, model_id) for metric in child.unlinked])
        child.unlinked = []

    def log_scores(self, frame: pd.DataFrame) -> None:
        """Record a table of scores, each method in its run and linked to its model and data set."""
        for method, values in scores_to_metrics(frame).items():
            child = self._child(method)
            child.scores.append(frame[frame["method"] == method])
            for split in dict.fromkeys(name.partition("/")[0] for name in values):
                self._log_values(child, {n: v for n, v in values.items() if n.partition("/")[0] == split}, split)

    def log_study(self, frame: pd.DataFrame) -> None:
        """Record the scores of a study: a run per method, data set and protocol, whose metrics have plain names.

        Splits are ``<data>`` or ``<data>/<protocol>/<part>``; metrics of a second part begin with its name.
        """
        started: dict[str, str] = {}
        for (method, split), rows in frame.groupby(["method", "split"], sort=False):
            data, protocol, part = (*str(split).split("/"), "", "")[:3]
            child = self._child(str(method), data, protocol)
            prefix = "" if started.setdefault(child.run_id, part) == part else f"{part}/"
            named = scores_to_metrics(rows.assign(split="_"))[str(method)]
            self._log_values(child, {prefix + name.removeprefix("_/"): v for name, v in named.items()}, data)

    def log_series(self, method: str, table: pd.DataFrame) -> None:
        """Record every column of a table by step."""
        self._log(self._child(method), series_metrics(table))

    def _log_values(self, child: _Child, values: Mapping[str, float], split: str) -> None:
        """Record metrics of a split, linked to its data set."""
        data, stamp = self._data_sets.of(split), now()
        self._log_inputs(child, data)
        named = {"dataset_name": data.dataset.name, "dataset_digest": data.dataset.digest} if data else {}
        self._log(child, [Metric(name, value, stamp, 0, **named) for name, value in values.items()])

    def _log(self, child: _Child, metrics: list[Metric]) -> None:
        if child.model is None:
            child.unlinked += metrics
            log_metrics(child.run_id, metrics)
        else:
            log_metrics(child.run_id, [_copied(metric, child.model[2]) for metric in metrics])

    def _log_inputs(self, child: _Child, data: DatasetInput | None) -> None:
        if data is not None and (key := (data.dataset.name, data.dataset.digest)) not in child.inputs:
            mlflow.MlflowClient().log_inputs(child.run_id, datasets=[data])
            child.inputs.add(key)

    def finish(self, status: str) -> None:
        """End all children, and add the scores to the descriptions of their models."""
        client = mlflow.MlflowClient()
        for child in self._children.values():
            client.set_terminated(child.run_id, status)
            if child.model is not None and child.scores:
                name, number, _ = child.model
                RegisteredModelDataset.describe(name, number, summary(pd.concat(child.scores)))
