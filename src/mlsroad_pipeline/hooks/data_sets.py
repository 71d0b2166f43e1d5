"""Data sets of a tracked run: the raw files of each split, with name and digest."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mlflow.entities import Dataset, DatasetInput, InputTag

from mlsroad_pipeline.algorithms.core.scene_key import TRAIN, SceneKey
from mlsroad_pipeline.hooks.data_fingerprint import fingerprint_files, source_files

_CONTEXT = "mlflow.data.context"
_LABELLED = "survey"
"""Split of `label`."""


@dataclass(frozen=True)
class DataSet:
    """Raw files of one split; MLflow shows the name, the digest and the context."""

    name: str
    digest: str
    context: str
    files: tuple[str, ...]

    def as_input(self) -> DatasetInput:
        """Return the input of a run."""
        folder = os.path.commonpath([os.path.dirname(path) for path in self.files])
        profile = {"num_files": len(self.files), "num_bytes": sum(os.path.getsize(path) for path in self.files)}
        data = Dataset(
            name=self.name,
            digest=self.digest,
            source_type="local",
            source=json.dumps({"uri": self.files[0] if len(self.files) == 1 else folder}),
            profile=json.dumps(profile),
        )
        return DatasetInput(data, [InputTag(_CONTEXT, self.context)])


class DataSets:
    """Data sets by split.

    The files of a split are those of the first saved tasks that read any: the point clouds. Images, which only some
    methods read, are in the fingerprint of the run.
    """

    def __init__(self, survey: str) -> None:
        self._survey = survey
        self._files: dict[str, tuple[str, ...]] = {}
        self._made: dict[str, DataSet] = {}

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

    def of(self, split: str) -> DataSet | None:
        """Return the data set of a split or of one of its parts such as `test_visible`, None if no file is known."""
        candidates = [name for name in self._files if split == name or split.startswith(f"{name}_")]
        if not candidates:
            return None
        name = max(candidates, key=len)
        if name not in self._made:
            context = {TRAIN: "training", _LABELLED: "labelling"}.get(name, "testing")
            title = self._survey if name == _LABELLED else f"{self._survey} {name}".strip()
            files = self._files[name]
            self._made[name] = DataSet(title or Path(files[0]).name, fingerprint_files(files).digest, context, files)
        return self._made[name]

    def all(self) -> list[DataSet]:
        """Return the data sets of all splits."""
        return [found for found in map(self.of, self._files) if found is not None]
