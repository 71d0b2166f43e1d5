"""Kedro dataset that runs the per-scene tasks of a node and stores their results."""

import logging
import os
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from typing import Any

from kedro.io import AbstractDataset, DatasetError

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MlsRoadError
from mlsroad_pipeline.execution.backends import run_jobs
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.fingerprints import Fingerprinter, installation
from mlsroad_pipeline.execution.progress import start_progress
from mlsroad_pipeline.execution.result_files import is_valid_name
from mlsroad_pipeline.execution.settings import Execution
from mlsroad_pipeline.execution.shared_values import share_values
from mlsroad_pipeline.execution.store import MANIFEST, Record, SceneStore
from mlsroad_pipeline.execution.store_files import StoreFiles
from mlsroad_pipeline.execution.task import SceneError, SceneFailure, SceneTask
from mlsroad_pipeline.execution.worker import Outcome, SceneJob, describe_error, import_function

logger = logging.getLogger(__name__)


class SceneStoreDataset(AbstractDataset[Mapping[str, SceneTask], SceneCollection]):
    """Store of per-scene results; saving runs the tasks in parallel, except those with a valid stored result.

    Catalog entry:

    ```yaml
    supervoxels:
      type: mlsroad_pipeline.datasets.scene_store_dataset.SceneStoreDataset
      filepath: data/04_feature/supervoxels
      scene_validator: my_package.checks.check_partition
      execution:
        backend: loky
        n_workers: 4
    ```

    Parameters
    ----------
    filepath : str
        The folder of the store, local or a URL of fsspec. It must be empty, absent or a scene store, because a store
        removes unknown files.
    execution : mapping, optional
        Arguments of `execution.Execution`.
    scene_validator : str, optional
        Dotted name of a function that is called with each result in its worker and raises an error for a wrong one,
        which is then not stored. (Kedro reserves the key `validator` and would apply it to the tasks.)
    keep : bool, default False
        Whether stored results of scenes without a task stay, so that some scenes can be computed alone.
    credentials : mapping, optional
        Credentials for the file system.
    fs_args : mapping, optional
        Further arguments for the file system.
    metadata : mapping, optional
        Any metadata; ignored.

    Raises
    ------
    ParameterError
        If `execution` is invalid, or if the validator cannot be imported.

    Examples
    --------
    >>> from mlsroad_pipeline.execution.task import SceneTask
    >>> from mlsroad_pipeline.datasets.scene_store_dataset import SceneStoreDataset
    >>> import numpy as np
    >>> store = SceneStoreDataset(filepath="memory://doc/squares", execution={"backend": "sequential"})
    >>> store.save({"s1": SceneTask(dict, parameters={"values": np.arange(3) ** 2})})
    >>> store.load()["s1"].load()
    {'values': array([0, 1, 4])}
    """

    def __init__(
        self,
        *,
        filepath: str,
        execution: Mapping[str, Any] | None = None,
        scene_validator: str | None = None,
        keep: bool = False,
        credentials: Mapping[str, Any] | None = None,
        fs_args: Mapping[str, Any] | None = None,
        metadata: Mapping[str, Any] | None = None,
    ) -> None:
        self._store = SceneStore.at(str(filepath), {**(credentials or {}), **(fs_args or {})})
        self._execution = Execution.from_config(execution)
        self._validator_name = scene_validator
        self._keep = keep
        self._validator = None if scene_validator is None else import_function(scene_validator, "validator")
        self.metadata = metadata

    def load(self) -> SceneCollection:
        """Return handles of all scenes."""
        records = self._store.read_manifest()
        if records is None:
            raise DatasetError(f"{self._store.url} is not a complete scene store: run the stage that fills it")
        return SceneCollection(self._store, records)

    def save(self, data: Mapping[str, SceneTask]) -> None:
        """Run the tasks without a valid stored result, and write the manifest of all scenes.

        The error of scenes that failed comes when all others are stored.
        """
        start, backend = time.perf_counter(), self._execution.backend
        _check_tasks(data)
        store = self._store
        store.check_ours()
        fingerprints, failures = self._fingerprints(data)
        records = self._valid_records(fingerprints, data)
        missing = [key for key in fingerprints if key not in records]
        if missing or failures or not self._is_manifest_of(records):
            token = store.begin()
            store.clean()
            try:
                tasks = [data[key] for key in missing]
                if backend in ("loky", "dask"):
                    tasks = share_values(tasks, StoreFiles(store.url, store.options))
                same = installation() if backend == "dask" else ""
                jobs = [
                    SceneJob(key, task, fingerprints[key], store, token, backend, self._validator_name, same)
                    for key, task in zip(missing, tasks, strict=True)
                ]
                for outcome in self._run(jobs):
                    if outcome.record is not None:
                        records[outcome.key] = outcome.record
                    if outcome.failure is not None:
                        failures.append(outcome.failure)
                if failures:
                    raise SceneError(store.name, tuple(sorted(failures, key=lambda f: f.scene)), len(data))
                store.finish(records, token=token, keep=self._keep)
            finally:
                store.release(token)
        seconds, valid = time.perf_counter() - start, len(data) - len(missing)
        summary = f"{len(data)} scenes: {len(missing)} computed in {seconds:.1f} s, {valid} already valid"
        logger.info("%s: %s", store.name, summary)

    def _is_manifest_of(self, records: Mapping[str, Record]) -> bool:
        """Return whether the manifest holds these records, and others only if they are kept."""
        manifest = self._store.read_manifest()
        if manifest is None:
            return False
        return all(manifest.get(key) == record for key, record in records.items()) and (
            self._keep or len(manifest) == len(records)
        )

    def _fingerprints(self, tasks: Mapping[str, SceneTask]) -> tuple[dict[str, str], list[SceneFailure]]:
        fingerprinter = Fingerprinter()
        fingerprints, failures = {}, []
        for key in sorted(tasks):
            task = tasks[key]
            try:
                fingerprints[key] = fingerprinter.task(
                    task.function, task.inputs, task.parameters, validator=self._validator
                )
            except MlsRoadError as error:  # a missing source file fails only its own scene
                failures.append(SceneFailure(key, ", ".join(task.sources()) or None, describe_error(error)))
        return fingerprints, failures

    def _valid_records(self, fingerprints: Mapping[str, str], tasks: Mapping[str, SceneTask]) -> dict[str, Record]:
        checksums = self._execution.verify == "checksum"

        def valid(key: str) -> Record | None:
            record = self._store.read_record(key)
            if record is None or record.task != fingerprints[key]:
                return None
            if not all(os.path.exists(output) for output in tasks[key].outputs):
                return None
            return record if self._store.is_intact(key, record, checksums=checksums) else None

        with ThreadPoolExecutor(self._execution.n_local_workers) as pool:
            records = zip(fingerprints, pool.map(valid, fingerprints), strict=True)
            return {key: record for key, record in records if record is not None}

    def _run(self, jobs: list[SceneJob]) -> Iterator[Outcome]:
        progress = start_progress(self._store.name, len(jobs), shown=self._execution.progress)
        try:
            with closing(run_jobs(jobs, self._execution)) as outcomes:
                for outcome in outcomes:
                    progress.step()
                    if outcome.failure is not None:
                        logger.error("%s; the other scenes continue\n%s", outcome.failure, outcome.failure.traceback)
                    yield outcome
        finally:
            progress.close()

    def _exists(self) -> bool:
        return self._store.is_complete()

    def _describe(self) -> dict[str, Any]:
        return {"filepath": self._store.url, "execution": self._execution, "scene_validator": self._validator_name}


def _check_tasks(data: object) -> None:
    if not isinstance(data, Mapping):
        raise DataError(f"a scene store takes a mapping of scene to SceneTask, got {type(data).__name__}")
    for key, task in data.items():
        if not is_valid_name(key) or key == MANIFEST:
            raise DataError(f"scene key {key!r} is invalid or reserved: use letters, digits, '_', '.' and '-'")
        if not isinstance(task, SceneTask):
            raise DataError(f"scene {key!r}: a scene store takes SceneTasks, got {type(task).__name__}")
