"""Files of a store on any file system of fsspec, written atomically."""

import errno
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
"""Folder of a store for values shared by tasks; it exists only while they run."""


class HashingStream(io.RawIOBase):
    """Append-only stream that counts and hashes the bytes it passes on to a target stream."""

    def __init__(self, target: IO[bytes]) -> None:
        self._target = target
        self.digest = new_digest()
        self.size = 0

    def writable(self) -> bool:
        """Return True."""
        return True

    def write(self, data: Any) -> int:
        """Write bytes to the target and return their number."""
        view = memoryview(data).cast("B")
        self._target.write(view)
        self.digest.update(view)
        self.size += len(view)
        return len(view)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self.size


def sync_file(path: str | os.PathLike[str]) -> None:
    """Write the content of a local file to the disk, whichever library has written it."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(folder: str | os.PathLike[str]) -> None:
    """Write the entries of a local folder to the disk, so that a renamed file survives a power failure."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # file systems that cannot sync a folder
            raise
    finally:
        os.close(descriptor)


@dataclass(frozen=True)
class StoreFiles:
    """Folder of files; small and picklable, so that it can be sent to workers."""

    url: str  # The folder
    # Options of the file system (credentials, endpoints)
    options: Mapping[str, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def at(cls, url: str, options: Mapping[str, Any] | None = None) -> Self:
        """Return the folder at a path or URL."""
        filesystem, root = fsspec.core.url_to_fs(url, **(options or {}))
        absolute = root if isinstance(filesystem, LocalFileSystem) else filesystem.unstrip_protocol(root)
        return cls(absolute.rstrip("/"), dict(options or {}))

    @property
    def name(self) -> str:
        """Name of the last folder: the name of the stage in messages."""
        return PurePosixPath(self.url).name

    @property
    def is_private(self) -> bool:
        """Whether the files lie in the memory of this process, inaccessible to other processes."""
        return self.url.startswith("memory://")

    def opened(self) -> tuple[fsspec.AbstractFileSystem, str]:
        """Return the file system (cached by fsspec per set of options) and the path of the folder in it."""
        filesystem, root = fsspec.core.url_to_fs(self.url, **self.options)
        return filesystem, root.rstrip("/")

    @contextmanager
    def writing(self, relative: str, *, sync_entry: bool = True) -> Iterator[IO[bytes]]:
        """Open a file for atomic writing: it appears under its name only when it is complete and on the disk.

        Without `sync_entry` its name may be lost in a power failure until `sync_entries` of its folder.
        """
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
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(temporary, path)
            if sync_entry:
                sync_folder(folder)
        except BaseException:
            if os.path.exists(temporary):
                os.remove(temporary)
            raise

    def sync_entries(self, relative: str) -> None:
        """Write the names of the files in a local folder to the disk."""
        filesystem, root = self.opened()
        if isinstance(filesystem, LocalFileSystem):
            sync_folder(f"{root}/{relative}")

    def write_json(self, relative: str, data: Any) -> None:
        """Write plain data as a JSON file; a TypeError for other data leaves an existing file unchanged."""
        with self.writing(relative) as stream:
            stream.write(json.dumps(data, indent=1).encode() + b"\n")

    def read_bytes(self, relative: str) -> bytes:
        """Return the content of a file."""
        filesystem, root = self.opened()
        return bytes(filesystem.cat_file(f"{root}/{relative}"))

    def read_json(self, relative: str) -> Any:
        """Return the content of a JSON file, or None if it is missing or incomplete."""
        try:
            return json.loads(self.read_bytes(relative))
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError, ValueError):
            return None

    def exists(self, relative: str) -> bool:
        """Return whether a file or folder exists, whatever it holds."""
        filesystem, root = self.opened()
        filesystem.invalidate_cache()
        return bool(filesystem.exists(f"{root}/{relative}"))

    def remove(self, relative: str) -> None:
        """Remove a file, or a folder with its content, if it exists."""
        filesystem, root = self.opened()
        if filesystem.exists(f"{root}/{relative}"):
            filesystem.rm(f"{root}/{relative}", recursive=True)
            filesystem.invalidate_cache()

    def names(self) -> list[str]:
        """Return the sorted names of the files and folders, empty ones too, in the folder; none if it is missing."""
        filesystem, root = self.opened()
        filesystem.invalidate_cache()
        found = filesystem.ls(root, detail=False) if filesystem.exists(root) else []
        return sorted(PurePosixPath(path).name for path in found)

    def listing(self) -> dict[str, int]:
        """Return the sizes of all files below the folder by relative path, bytes."""
        filesystem, root = self.opened()
        filesystem.invalidate_cache()
        files = filesystem.find(root, detail=True)
        return {path.removeprefix(f"{root}/"): info["size"] for path, info in files.items()}
