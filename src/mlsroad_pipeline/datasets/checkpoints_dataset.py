"""Folder of the checkpoints of a training."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Never

from kedro.io import AbstractDataset

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.execution.path_parameters import local_path

if TYPE_CHECKING:
    from mlsroad_pipeline.model_store.torch_checkpoints import TorchCheckpoints


class CheckpointsDataset(AbstractDataset[Never, "TorchCheckpoints"]):
    """Folder of training states. Loading returns the store; the training reads, writes and removes its states."""

    def __init__(self, *, filepath: str, metadata: Mapping[str, Any] | None = None) -> None:
        self._folder = local_path(filepath, "filepath")
        self.metadata = metadata

    def load(self) -> TorchCheckpoints:
        """Return the store of the folder."""
        from mlsroad_pipeline.model_store.torch_checkpoints import TorchCheckpoints  # noqa: PLC0415  # imports torch

        return TorchCheckpoints(self._folder)

    def save(self, data: Never) -> None:
        """Refuse: the training writes the states."""
        raise ParameterError(f"{self._folder}: checkpoints are written by the training, not by a node")

    def _exists(self) -> bool:
        return True

    def _describe(self) -> dict[str, Any]:
        return {"filepath": str(self._folder)}
