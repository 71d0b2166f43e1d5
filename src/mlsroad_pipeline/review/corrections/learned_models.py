"""Storage of a model that has learned: a version in an MLflow registry, or a folder in an output."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.model_store.bundle_files import save_bundle
from mlsroad_pipeline.model_store.registered_models import PREFIX

MODELS = "models"
"""Folder in an output that holds learned models where no MLflow store is configured."""


def write_learned(model: ModelBundle, output: Path) -> tuple[str, dict[str, str]]:
    """Write a model into an output folder; return its path, and the parameters of `label` that choose it."""
    digest = hashlib.blake2b(digest_size=4)
    for name in sorted(model.arrays):
        digest.update(np.ascontiguousarray(model.arrays[name]).tobytes())
    folder = (output / MODELS / f"{model.slug}-{digest.hexdigest()}").absolute()
    save_bundle(model, folder)
    return str(folder), {"model": str(folder)}


def register_learned(model: ModelBundle, parent: Mapping[str, Any], store: str) -> tuple[str, dict[str, str]]:
    """Register a model with the tag ``parent``; return its name, and the parameters of `label` that choose it."""
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")  # it would draw bars for files of a few kB
    import mlflow  # noqa: PLC0415  few runs are tracked

    from mlsroad_pipeline.model_store.registration import register_bundle  # noqa: PLC0415

    mlflow.set_tracking_uri(store)
    name = f"{PREFIX}{model.slug}"
    version, _ = register_bundle(model, name)
    client = mlflow.MlflowClient()
    tags = {"parent": f"{parent['name']} {parent['version']}".strip(), "trained_on": str(model.metadata["trained_on"])}
    for tag, text in tags.items():
        client.set_model_version_tag(name, str(version), tag, text)
    return f"{name} version {version}", {"method": model.slug, "model": str(version)}
