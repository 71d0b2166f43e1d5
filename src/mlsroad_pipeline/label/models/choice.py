"""Chosen model of a run of `label`, with the reason of the choice; loading of its bundle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import method_of
from mlsroad_pipeline.model_store.bundle_files import load_bundle
from mlsroad_pipeline.model_store.registered_models import ModelStore, RegisteredVersion
from mlsroad_pipeline.model_store.shipped_models import ShippedModel, load_shipped


@dataclass(frozen=True)
class StoredModel:
    """A model in a folder, as `mlsroad learn` writes it where no MLflow store is configured."""

    folder: str  # The folder
    method: str  # Slug of the method
    trained_on: str = ""  # Training data

    @property
    def name(self) -> str:
        """Return the folder."""
        return self.folder

    @classmethod
    def at(cls, folder: str) -> StoredModel:
        """Return the model of a folder; ReadError if it is damaged."""
        bundle = load_bundle(folder)
        facts = bundle.metadata.get("trained_on", {})
        text = ", ".join(f"{name} {value}" for name, value in facts.items()) if isinstance(facts, Mapping) else ""
        return cls(folder, bundle.slug, text)

    def load(self) -> ModelBundle:
        """Return the bundle; its metadata gain ``stored``."""
        bundle = load_bundle(self.folder)
        stored = {"name": Path(self.folder).name, "version": "", "folder": self.folder}
        return replace(bundle, metadata={**bundle.metadata, "stored": stored})


@dataclass(frozen=True)
class ModelChoice:
    """The chosen model."""

    model: ShippedModel | RegisteredVersion | StoredModel  # The model
    reason: str  # Reason of the choice, in one line

    @property
    def method(self) -> str:
        """Return the slug of the method."""
        return self.model.method

    @property
    def name(self) -> str:
        """Return the name of the model, with its version if it is a registered one."""
        return f"the shipped model {self.model.name}" if isinstance(self.model, ShippedModel) else self.model.name

    @property
    def trained_on(self) -> str:
        """Return the training data."""
        return f"trained on {self.model.trained_on or 'unknown data'}"


def load_choice(choice: ModelChoice, store: ModelStore | None = None) -> ModelBundle:
    """Return the bundle of a chosen model; ParameterError if its method is unknown."""
    bundle = _loaded(choice, store)
    method_of(bundle)
    return bundle


def _loaded(choice: ModelChoice, store: ModelStore | None) -> ModelBundle:
    if isinstance(choice.model, ShippedModel):
        return load_shipped(choice.model.name)
    if isinstance(choice.model, StoredModel):
        return choice.model.load()
    if store is None:
        raise ParameterError(f"{choice.name} needs an MLflow store: set MLFLOW_TRACKING_URI")
    return store.load(choice.model)
