"""Fingerprint of the input data of a run: its files and their digests."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.execution.digests import DIGEST_BYTES, digest_file


class FileDigest(NamedTuple):
    """Digest of one file: path relative to the common folder, size in bytes, and BLAKE2b digest of 128 bits."""

    path: str
    size: int
    digest: str


@dataclass(frozen=True)
class DataFingerprint:
    """Input files of a run, sorted by path."""

    files: tuple[FileDigest, ...]

    @property
    def digest(self) -> str:
        """Digest of all files and their relative paths, 32 hexadecimal digits."""
        text = json.dumps(self.files, ensure_ascii=False)
        return hashlib.blake2b(text.encode("utf-8"), digest_size=DIGEST_BYTES).hexdigest()

    def table(self) -> dict[str, Any]:
        """Return the fingerprint as JSON values: the digest, totals, and one entry per file."""
        entries = [{"path": file.path, "bytes": file.size, "blake2b": file.digest} for file in self.files]
        total = sum(file.size for file in self.files)
        return {"digest": self.digest, "n_files": len(self.files), "bytes": total, "files": entries}


def fingerprint_files(paths: Sequence[str | Path]) -> DataFingerprint:
    """Return the fingerprint of files; raise ReadError if one cannot be read."""
    absolute = sorted({os.path.abspath(path) for path in paths})
    folders = [os.path.dirname(path) for path in absolute]
    root = os.path.commonpath(folders) if folders else ""
    files = []
    for path in absolute:
        try:
            state = os.stat(path)
            digest = digest_file(path)
        except OSError as error:
            raise ReadError(f"{path}: cannot be fingerprinted: {error}") from error
        files.append(FileDigest(Path(path).relative_to(root).as_posix(), state.st_size, digest))
    return DataFingerprint(tuple(files))


def source_files(tasks: Any) -> list[str]:
    """Return the paths of raw files among the inputs of scene tasks; other data have none."""
    paths: set[str] = set()
    if isinstance(tasks, Mapping):
        waiting = [task.inputs for task in tasks.values() if isinstance(getattr(task, "inputs", None), Mapping)]
        while waiting:
            value = waiting.pop()
            if isinstance(value, Mapping):
                waiting.extend(value.values())
            elif isinstance(value, list | tuple):
                waiting.extend(value)
            elif isinstance(getattr(value, "path", None), str):
                paths.add(value.path)
    return sorted(paths)
