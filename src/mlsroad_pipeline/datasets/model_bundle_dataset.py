"""Trained models as folders of plain files."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from typing import Any

from kedro.io import AbstractDataset

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.execution.path_parameters import local_path
from mlsroad_pipeline.model_store.bundle_files import ModelFile, save_bundle


class ModelBundleDataset(AbstractDataset[ModelBundle, ModelFile]):
    """Folder of a trained model. Loading returns a handle: tasks take it as an input, and workers open the model."""

    def __init__(self, *, filepath: str, metadata: Mapping[str, Any] | None = None) -> None:
        self._folder = local_path(filepath, "filepath")
        self.metadata = metadata

    def load(self) -> ModelFile:
        """Return a handle of the folder."""
        return ModelFile(str(self._folder))

    def save(self, data: ModelBundle) -> None:
        """Write the model beside the previous one, then replace that."""
        fresh = self._folder.with_name(f".{self._folder.name}.new")
        shutil.rmtree(fresh, ignore_errors=True)
        save_bundle(data, fresh)
        if self._folder.exists():
            shutil.rmtree(self._folder)
        fresh.rename(self._folder)

    def _exists(self) -> bool:
        return (self._folder / "model.json").is_file()

    def _describe(self) -> dict[str, Any]:
        return {"filepath": str(self._folder)}
