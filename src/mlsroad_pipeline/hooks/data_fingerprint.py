"""What identifies the data of a run: the files of the survey and a digest of each."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.execution.digests import DIGEST_BYTES, digest_file


@dataclass(frozen=True)
class DataFingerprint:
    """The files that a run was fed with.

    Parameters
    ----------
    files : tuple of (str, int, str)
        Path relative to the survey's root, size in bytes, and BLAKE2b digest of 128 bits, sorted by path.
    """

    files: tuple[tuple[str, int, str], ...]

    @property
    def digest(self) -> str:
        """One digest for all files and their relative paths, 32 hexadecimal digits."""
        text = json.dumps(self.files, ensure_ascii=False)
        return hashlib.blake2b(text.encode("utf-8"), digest_size=DIGEST_BYTES).hexdigest()

    def table(self) -> dict[str, Any]:
        """Return the fingerprint as JSON values: the digest, totals, and one entry per file."""
        entries = [{"path": path, "bytes": size, "blake2b": digest} for path, size, digest in self.files]
        total = sum(size for _, size, _ in self.files)
        return {"digest": self.digest, "n_files": len(self.files), "bytes": total, "files": entries}


def fingerprint_files(paths: Sequence[str | Path]) -> DataFingerprint:
    """Hash the files of a survey."""
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
        files.append((Path(path).relative_to(root).as_posix(), state.st_size, digest))
    return DataFingerprint(tuple(files))


def source_files(tasks: Any) -> list[str]:
    """Find the raw files among the inputs of tasks."""
    found: set[str] = set()
    if isinstance(tasks, Mapping):
        waiting = [task.inputs for task in tasks.values() if isinstance(getattr(task, "inputs", None), Mapping)]
        while waiting:
            value = waiting.pop()
            if isinstance(value, Mapping):
                waiting.extend(value.values())
            elif isinstance(value, list | tuple):
                waiting.extend(value)
            elif isinstance(getattr(value, "path", None), str):
                found.add(value.path)
    return sorted(found)
