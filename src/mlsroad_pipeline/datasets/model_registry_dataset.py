"""Models in the MLflow registry, as a Kedro dataset."""

import logging
from collections.abc import Mapping
from typing import Any

import mlflow
import pandas as pd
from kedro.io import AbstractDataset

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.model_store.registration import describe_version, load_registered_bundle, register_bundle

LOGGER = logging.getLogger(__name__)


class RegisteredModelDataset(AbstractDataset[ModelBundle, ModelBundle]):
    """Model in the MLflow registry.

    Saving registers a new version of a changed model; loading reads the highest version or a given one.
    """

    def __init__(
        self, *, name: str, model_version: int | str | None = None, metadata: Mapping[str, Any] | None = None
    ) -> None:
        self._name = name
        self._model_version = model_version
        self.saved_version: int | None = None  # version of the last saved model
        self.metadata = metadata

    @property
    def registered_name(self) -> str:
        """Name of the model in the registry."""
        return self._name

    @property
    def method(self) -> str:
        """Slug of the method, as in the name."""
        return self._name.removeprefix("mlsroad-")

    def load(self) -> ModelBundle:
        """Return the model, with ``registered`` in its metadata."""
        return load_registered_bundle(self._name, model_version=self._model_version)

    def save(self, data: ModelBundle) -> None:
        """Register the model as a new version, unless the highest version is the same model."""
        number, is_new = register_bundle(data, self._name)
        self.saved_version = number
        LOGGER.info("%s %s version %s", "Registered" if is_new else "Unchanged:", self._name, number)

    @staticmethod
    def describe(name: str, number: str, scores: pd.DataFrame) -> None:
        """Add scores over all classes, one row per method and split, to the description of a version."""
        describe_version(name, number, scores)

    def _exists(self) -> bool:
        query = f"name='{self._name}'"
        versions = {found.version for found in mlflow.MlflowClient().search_model_versions(query)}
        return bool(versions) if self._model_version is None else str(self._model_version) in map(str, versions)

    def _describe(self) -> dict[str, Any]:
        return {"name": self._name, "model_version": self._model_version}
