"""Digests of plain data and of files."""

import functools
import hashlib
import json
import os
from typing import Any

import fsspec
from fsspec.implementations.local import LocalFileSystem

from mlsroad_pipeline.algorithms.core.exceptions import ReadError

DIGEST_BYTES = 16


def new_digest(data: bytes = b"") -> hashlib.blake2b:
    """Return a new incremental digest, possibly of some data: BLAKE2b with 128 bits."""
    return hashlib.blake2b(data, digest_size=DIGEST_BYTES)


def digest_json(data: Any) -> str:
    """Return the digest of plain data, hexadecimal."""
    return new_digest(json.dumps(data, ensure_ascii=False, separators=(",", ":")).encode()).hexdigest()


@functools.lru_cache(maxsize=4096)
def _local_digest(path: str, size: int, mtime_ns: int) -> str:
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, new_digest).hexdigest()


@functools.lru_cache(maxsize=4096)
def _remote_digest(url: str, state: str) -> str:
    with fsspec.open(url, "rb") as stream:
        return hashlib.file_digest(stream, new_digest).hexdigest()


def digest_local_file(path: str) -> str:
    """Return the digest of the content of a file of this machine, cached as that of `digest_file`."""
    state = os.stat(path)
    return _local_digest(path, state.st_size, state.st_mtime_ns)


def digest_file(path: str) -> str:
    """Return the digest of the content of a file, or of all files below a folder.

    Digests are cached by path, size and modification time (remote files: by an identifier such as the ETag).
    Raises ReadError if the file does not exist or cannot be read.
    """
    filesystem, root = fsspec.core.url_to_fs(path)
    try:
        if filesystem.isdir(root):
            files = sorted(filesystem.find(root))
            return digest_json([[file.removeprefix(root), _digest_one(filesystem, file)] for file in files])
        return _digest_one(filesystem, root)
    except OSError as error:
        raise ReadError(f"{path}: cannot be read: {error}") from error


def _digest_one(filesystem: fsspec.AbstractFileSystem, path: str) -> str:
    if isinstance(filesystem, LocalFileSystem):
        return digest_local_file(path)
    return _remote_digest(filesystem.unstrip_protocol(path), filesystem.ukey(path))
