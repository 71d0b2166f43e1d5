"""Files that GDAL writes. It does not report every write that fails, so they are written twice and compared."""

from __future__ import annotations

import errno
import filecmp
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from mlsroad_pipeline.execution.scratch import scratch_folder
from mlsroad_pipeline.formats.files import atomic_file


def write_whole(folder: Path, write: Callable[[Path], None]) -> list[Path]:
    """Write files by a function of a folder, each whole or not at all.

    The function writes into two folders for temporary files. If the files are equal, they are copied to their place.
    """
    with tempfile.TemporaryDirectory(dir=scratch_folder()) as place:
        first, second = Path(place, "first"), Path(place, "second")
        for twin in (first, second):
            twin.mkdir()
            write(twin)
        names = sorted(path.name for path in first.iterdir())
        if names != sorted(path.name for path in second.iterdir()) or not _equal(first, second, names):
            raise OSError(errno.EIO, f"GDAL did not write all of {', '.join(names)} below {place}", str(folder))
        for name in names:
            with (first / name).open("rb") as source, atomic_file(folder / name) as stream:
                shutil.copyfileobj(source, stream)
    return [folder / name for name in names]


def _equal(first: Path, second: Path, names: list[str]) -> bool:
    return all(filecmp.cmp(first / name, second / name, shallow=False) for name in names)
