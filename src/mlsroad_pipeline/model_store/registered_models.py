"""Models in an MLflow registry: versions, aliases, loading. MLflow is imported by the functions that need it."""

import ast
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle

PREFIX = "mlsroad-"
"""Prefix of the registered names; the rest is the slug of the method."""


@dataclass(frozen=True)
class RegisteredVersion:
    """A version of a registered model."""

    method: str  # Slug of the method
    version: int  # The version
    aliases: tuple[str, ...] = ()  # Aliases of the version
    trained_on: str = ""  # Training data, as the training described them

    @property
    def registered_name(self) -> str:
        """Return the registered name."""
        return f"{PREFIX}{self.method}"

    @property
    def name(self) -> str:
        """Return the registered name and the version."""
        return f"{self.registered_name} version {self.version}"


class ModelStore(Protocol):
    """Registered models."""

    def versions(self) -> Sequence[RegisteredVersion]:
        """Return all versions of all methods."""

    def load(self, found: RegisteredVersion) -> ModelBundle:
        """Return a model."""


@dataclass(frozen=True)
class MlflowStore:
    """Registered models of an MLflow registry."""

    uri: str | None = None  # Tracking URI; None takes the one that MLflow is configured with

    def versions(self) -> list[RegisteredVersion]:
        """Return all versions of all methods, ordered by method and version."""
        from mlflow import MlflowClient  # noqa: PLC0415

        client = MlflowClient(tracking_uri=self.uri, registry_uri=self.uri)
        ours = f"name LIKE '{PREFIX}%'"
        aliases: dict[tuple[str, int], list[str]] = {}
        for model in _all_pages(client.search_registered_models, filter_string=ours):
            for alias, version in model.aliases.items():
                aliases.setdefault((model.name, int(version)), []).append(str(alias))
        found = [
            RegisteredVersion(
                version.name.removeprefix(PREFIX),
                int(version.version),
                tuple(sorted(aliases.get((version.name, int(version.version)), ()))),
                _plain(str(version.tags.get("trained_on", ""))),
            )
            for version in _all_pages(client.search_model_versions, filter_string=ours)
        ]
        return sorted(found, key=lambda item: (item.method, item.version))

    def load(self, found: RegisteredVersion) -> ModelBundle:
        """Return a model of the registry that MLflow is configured with."""
        from mlsroad_pipeline.model_store.registration import load_registered_bundle  # noqa: PLC0415

        return load_registered_bundle(f"{PREFIX}{found.method}", model_version=found.version)


def _plain(tag: str) -> str:
    """Return the tag of the training data, a mapping as text, as ``name value, name value``."""
    try:
        values = ast.literal_eval(tag)
    except (SyntaxError, ValueError):
        return tag
    return ", ".join(f"{name} {value}" for name, value in values.items()) if isinstance(values, dict) else tag


def _all_pages(search: Any, **query: str) -> list[Any]:
    """Return the results of all pages of a search."""
    found, token = [], None
    while True:
        page = search(**query, page_token=token)
        found += list(page)
        token = page.token
        if not token:
            return found


def configured_store() -> MlflowStore | None:
    """Return the registry of this process, or None where no tracking is configured.

    MLflow is configured by ``MLFLOW_TRACKING_URI``, or by a session with the hooks of kedro-mlflow. Without either,
    MLflow is not imported.
    """
    if os.environ.get("MLFLOW_TRACKING_URI"):
        return MlflowStore()
    if "mlflow" not in sys.modules:
        return None
    from mlflow.tracking import is_tracking_uri_set  # noqa: PLC0415

    return MlflowStore() if is_tracking_uri_set() else None
