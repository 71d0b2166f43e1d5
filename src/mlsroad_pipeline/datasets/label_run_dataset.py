"""Kedro dataset of the folder of a run of `label`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, NoReturn

from kedro.io import AbstractDataset, DatasetError

from mlsroad_pipeline.execution.run_folder import RunFolder


class LabelRunDataset(AbstractDataset[NoReturn, RunFolder]):
    """Handle of the folder of the configured run of `label`, which holds its state and its record."""

    def __init__(self, *, filepath: str, settings: str, metadata: Mapping[str, Any] | None = None) -> None:
        self._run = RunFolder(str(filepath), json.loads(settings))
        self.metadata = metadata

    def load(self) -> RunFolder:
        """Return the handle."""
        return self._run

    def save(self, data: NoReturn) -> None:
        """Raise DatasetError: the folder follows from the parameters."""
        raise DatasetError(f"{self._run.path}: the folder of a run is not saved as a dataset")

    def _exists(self) -> bool:
        return True

    def _describe(self) -> dict[str, Any]:
        return {"filepath": self._run.path}
