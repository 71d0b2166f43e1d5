"""Models of the package, as a Kedro dataset that writes them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kedro.io import AbstractDataset

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.execution.path_parameters import local_path
from mlsroad_pipeline.model_store.shipped_models import REGISTRY, ShippedModel, save_shipped, shipped_models


class ShippedModelDataset(AbstractDataset[tuple[ModelBundle, ShippedModel], dict[str, ShippedModel]]):
    """Folder of the models in the package. Saving replaces one model; loading returns the registry."""

    def __init__(self, *, filepath: str, metadata: Mapping[str, Any] | None = None) -> None:
        self._folder = local_path(filepath, "filepath")
        self.metadata = metadata

    def load(self) -> dict[str, ShippedModel]:
        """Return the registry entries by name."""
        return shipped_models(self._folder)

    def save(self, data: tuple[ModelBundle, ShippedModel]) -> None:
        """Write the files, the registry entry and the card of a model."""
        save_shipped(*data, self._folder)

    def _exists(self) -> bool:
        return (self._folder / REGISTRY).is_file()

    def _describe(self) -> dict[str, Any]:
        return {"filepath": str(self._folder)}
