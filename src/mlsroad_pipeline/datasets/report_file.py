"""Base of the datasets of scores, figures and reports: one small file, written atomically."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

import fsspec
from fsspec.implementations.local import LocalFileSystem
from kedro.io import AbstractDataset, DatasetError

from mlsroad_pipeline.execution.store_files import sync_folder
from mlsroad_pipeline.formats.files import atomic_file

Saved = TypeVar("Saved")
Loaded = TypeVar("Loaded")


class ReportFileDataset(AbstractDataset[Saved, Loaded], Generic[Saved, Loaded]):
    """File that is read and written as bytes, on any file system of fsspec."""

    def __init__(
        self,
        *,
        filepath: str,
        credentials: Mapping[str, Any] | None = None,
        fs_args: Mapping[str, Any] | None = None,
        metadata: Mapping[str, Any] | None = None,
    ) -> None:
        self._filepath = str(filepath)
        self._options = {**(fs_args or {}), **(credentials or {})}
        self.metadata = metadata

    def read_bytes(self) -> bytes:
        """Return the content of the file; raise `DatasetError` if it does not exist."""
        filesystem, path = fsspec.core.url_to_fs(self._filepath, **self._options)
        try:
            content: bytes = filesystem.cat_file(path)
        except (FileNotFoundError, IsADirectoryError) as error:
            raise DatasetError(f"{self._filepath} does not exist") from error
        return content

    def write_bytes(self, content: bytes) -> None:
        """Replace the file atomically, locally by a rename, elsewhere by a single put; remove parts of killed runs."""
        filesystem, path = fsspec.core.url_to_fs(self._filepath, **self._options)
        if not isinstance(filesystem, LocalFileSystem):
            filesystem.pipe_file(path, content)
            return
        target = Path(path)
        with atomic_file(target) as stream:
            stream.write(content)
        sync_folder(target.parent)

    @property
    def filename(self) -> str:
        """Name of the file without its folder."""
        return self._filepath.rstrip("/").rsplit("/", 1)[-1]

    def _exists(self) -> bool:
        filesystem, path = fsspec.core.url_to_fs(self._filepath, **self._options)
        return bool(filesystem.isfile(path))

    def _describe(self) -> dict[str, Any]:
        return {"filepath": self._filepath}
