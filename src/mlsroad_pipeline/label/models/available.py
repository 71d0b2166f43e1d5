"""The models that `label` can use, for the command line; needs no Kedro session."""

from __future__ import annotations

from dataclasses import dataclass

from mlsroad_pipeline.model_store.registered_models import MlflowStore, ModelStore
from mlsroad_pipeline.model_store.shipped_models import ShippedModel, shipped_models


@dataclass(frozen=True)
class AvailableModel:
    """A model that `label` can use."""

    name: str  # Name of a shipped model, or the registered name
    method: str  # Slug of the method
    version: str  # Version of the package of a shipped model, or the registered version
    aliases: tuple[str, ...]  # Aliases of a registered version
    shipped: bool  # Whether the model is part of the package
    trained_on: str  # Training data
    entry: ShippedModel | None = None  # Classes, scores, licence and size of a shipped model


def registered_models_at(uri: str) -> ModelStore:
    """Return the registered models of an MLflow store."""
    return MlflowStore(uri)


def available_models(store: ModelStore | None = None) -> list[AvailableModel]:
    """Return the shipped models, then the registered ones of a store (`MlflowStore`, or None for none)."""
    found = [
        AvailableModel(name, model.method, model.version, (), True, model.trained_on, model)
        for name, model in shipped_models().items()
    ]
    registered = () if store is None else store.versions()
    return found + [
        AvailableModel(item.registered_name, item.method, str(item.version), item.aliases, False, item.trained_on)
        for item in registered
    ]
