"""The files of a store on any file system of fsspec: each appears whole or not at all."""

from __future__ import annotations

import io
import json
import os
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import IO, Any, Self

import fsspec
from fsspec.implementations.local import LocalFileSystem

from mlsroad_pipeline.execution.digests import new_digest

SHARED = ".shared"
"""Folder of a store for values that tasks share; it is there only while they run."""


class HashingStream(io.RawIOBase):
    """An append-only stream that counts and hashes what passes through.

    Parameters
    ----------
    target : binary stream
        Where the bytes go.
    """

    def __init__(self, target: IO[bytes]) -> None:
        self._target = target
        self.digest = new_digest()
        self.size = 0

    def writable(self) -> bool:
        """Return True."""
        return True

    def write(self, data: Any) -> int:
        """Pass bytes on and return their number."""
        view = memoryview(data).cast("B")
        self._target.write(view)
        self.digest.update(view)
        self.size += len(view)
        return len(view)

    def tell(self) -> int:
        """Return how many bytes have passed."""
        return self.size


@dataclass(frozen=True)
class StoreFiles:
    """A folder of files; small and picklable, so that workers can be given it.

    Parameters
    ----------
    url : str
        The folder.
    options : mapping, optional
        What the file system is opened with (credentials, endpoints).
    """

    url: str
    options: Mapping[str, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def at(cls, url: str, options: Mapping[str, Any] | None = None) -> Self:
        """Return the storage at a path or URL.

        Raises
        ------
        ValueError
            If fsspec knows no file system of the URL's protocol.
        ImportError
            If the package of that file system is not installed.
        """
        filesystem, root = fsspec.core.url_to_fs(url, **(options or {}))
        absolute = root if isinstance(filesystem, LocalFileSystem) else filesystem.unstrip_protocol(root)
        return cls(absolute.rstrip("/"), dict(options or {}))

    @property
    def name(self) -> str:
        """The last folder's name, which is what messages call the stage."""
        return PurePosixPath(self.url).name

    @property
    def is_private(self) -> bool:
        """Whether the files are in this process's memory, out of the reach of other processes."""
        return self.url.startswith("memory://")

    def opened(self) -> tuple[fsspec.AbstractFileSystem, str]:
        """Return the file system (fsspec keeps one per set of options) and the folder's path in it."""
        filesystem, root = fsspec.core.url_to_fs(self.url, **self.options)
        return filesystem, root.rstrip("/")

    @contextmanager
    def writing(self, relative: str) -> Iterator[IO[bytes]]:
        """Open a file that appears under its name whole or not at all."""
        filesystem, root = self.opened()
        path = f"{root}/{relative}"
        if not isinstance(filesystem, LocalFileSystem):
            buffer = io.BytesIO()
            yield buffer
            filesystem.pipe_file(path, buffer.getvalue())
            return
        folder, name = os.path.split(path)
        os.makedirs(folder, exist_ok=True)
        temporary = os.path.join(folder, f".{name}.{uuid.uuid4().hex}.tmp")
        try:
            with open(temporary, "wb") as stream:
                yield stream
            os.replace(temporary, path)
        except BaseException:
            if os.path.exists(temporary):
                os.remove(temporary)
            raise

    def write_json(self, relative: str, data: Any) -> None:
        """Write plain data as a JSON file.

        Raises
        ------
        TypeError
            If the data are not plain; the file stays as it was.
        """
        with self.writing(relative) as stream:
            stream.write(json.dumps(data, indent=1).encode() + b"\n")

    def read_bytes(self, relative: str) -> bytes:
        """Return a file's content."""
        filesystem, root = self.opened()
        return bytes(filesystem.cat_file(f"{root}/{relative}"))

    def read_json(self, relative: str) -> Any:
        """Return a JSON file's content, or None if there is none or it is not whole."""
        try:
            return json.loads(self.read_bytes(relative))
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError, ValueError):
            return None

    def remove(self, relative: str) -> None:
        """Remove a file, or a folder with all that is in it; nothing to remove is fine."""
        filesystem, root = self.opened()
        if filesystem.exists(f"{root}/{relative}"):
            filesystem.rm(f"{root}/{relative}", recursive=True)
            filesystem.invalidate_cache()

    def listing(self) -> dict[str, int]:
        """Return the size of every file below the folder, by its relative path."""
        filesystem, root = self.opened()
        filesystem.invalidate_cache()
        found = filesystem.find(root, detail=True)
        return {path.removeprefix(f"{root}/"): info["size"] for path, info in found.items()}
