"""Kedro datasets of trained models: folders of plain files, those of the package, checkpoints."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Generic, Never, TypeVar

import numpy as np
from kedro.io import AbstractDataset

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.execution.parameter_checks import local_path
from mlsroad_pipeline.model_store.bundle_files import ModelFile, save_bundle
from mlsroad_pipeline.model_store.shipped_models import REGISTRY, ShippedModel, save_shipped, shipped_models

if TYPE_CHECKING:
    from mlsroad_pipeline.model_store.torch_checkpoints import TorchCheckpoints

Saved = TypeVar("Saved")
Loaded = TypeVar("Loaded")


class _FolderDataset(AbstractDataset[Saved, Loaded], Generic[Saved, Loaded]):
    """Data set in a folder of this machine."""

    def __init__(self, *, filepath: str, metadata: Mapping[str, Any] | None = None) -> None:
        self._folder = local_path(filepath, "filepath")
        self.metadata = metadata

    def _exists(self) -> bool:
        return True

    def _describe(self) -> dict[str, Any]:
        return {"filepath": str(self._folder)}


class ModelBundleDataset(_FolderDataset[ModelBundle, ModelFile]):
    """Folder of a trained model. Loading returns a handle: tasks take it as an input, and workers open the model."""

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


class ShippedModelDataset(_FolderDataset[tuple[ModelBundle, ShippedModel], dict[str, ShippedModel]]):
    """Folder of the models in the package. Saving replaces one model; loading returns the registry."""

    def load(self) -> dict[str, ShippedModel]:
        """Return the registry entries by name."""
        return shipped_models(self._folder)

    def save(self, data: tuple[ModelBundle, ShippedModel]) -> None:
        """Write the files, the registry entry and the card of a model."""
        save_shipped(*data, self._folder)

    def _exists(self) -> bool:
        return (self._folder / REGISTRY).is_file()


class ShippedFilesDataset(_FolderDataset[Mapping[str, Mapping[str, Any] | str], dict[str, str]]):
    """Files in a folder of the package: compressed arrays (`.npz`) and texts. Saving replaces those that it gets."""

    def load(self) -> dict[str, str]:
        """Return the paths of the files by name."""
        return {path.name: str(path) for path in sorted(self._folder.iterdir())}

    def save(self, data: Mapping[str, Mapping[str, Any] | str]) -> None:
        """Write texts as they are, and mappings of arrays as compressed NPZ."""
        self._folder.mkdir(parents=True, exist_ok=True)
        for name, content in data.items():
            if isinstance(content, str):
                (self._folder / name).write_text(content, encoding="utf-8")
            else:
                np.savez_compressed(self._folder / name, **content)

    def _exists(self) -> bool:
        return self._folder.is_dir() and any(self._folder.iterdir())


class CheckpointsDataset(_FolderDataset[Never, "TorchCheckpoints"]):
    """Folder of training states. Loading returns the store; the training reads, writes and removes its states."""

    def load(self) -> TorchCheckpoints:
        """Return the store of the folder."""
        from mlsroad_pipeline.model_store.torch_checkpoints import TorchCheckpoints  # noqa: PLC0415  # imports torch

        return TorchCheckpoints(self._folder)

    def save(self, data: Never) -> None:
        """Refuse: the training writes the states."""
        raise ParameterError(f"{self._folder}: checkpoints are written by the training, not by a node")
