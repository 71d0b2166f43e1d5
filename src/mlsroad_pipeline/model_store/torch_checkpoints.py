"""Checkpoints of a training as PyTorch files. Importing this module imports torch."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.plain_text import torch_error
from mlsroad_pipeline.execution.store_files import sync_file, sync_folder


@dataclass(frozen=True)
class TorchCheckpoints:
    """Training states in a folder, one file ``<name>.pt`` each."""

    folder: Path  # The folder; it is created when the first state is saved

    def locate(self, name: str) -> str:
        """Return the path of a state."""
        return str(self._file(name))

    def load(self, name: str) -> dict[str, Any] | None:
        """Return a state in main memory, None where there is no file; no code in the file is executed."""
        path = self._file(name)
        if not path.exists():
            return None
        try:
            state: dict[str, Any] = dict(torch.load(path, map_location="cpu", weights_only=True))
        except Exception as error:  # damaged archives raise errors of many kinds
            raise ReadError(
                f"{path}: the checkpoint is damaged ({torch_error(error)}); remove it to train anew"
            ) from error
        return state

    def save(self, name: str, state: dict[str, Any]) -> None:
        """Write a state to a temporary file, sync and rename it: a kill or a power failure leaves no partial one."""
        path = self._file(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.part")
        torch.save(state, partial)
        sync_file(partial)
        partial.replace(path)
        sync_folder(path.parent)

    def remove(self, name: str) -> None:
        """Remove a state, and the folder if it is empty then."""
        self._file(name).unlink(missing_ok=True)
        if self.folder.is_dir() and not any(self.folder.iterdir()):
            self.folder.rmdir()

    def _file(self, name: str) -> Path:
        return self.folder / f"{name}.pt"
