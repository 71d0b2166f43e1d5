"""Interface of a point cloud format."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.options import ReadOptions, WriteOptions

__all__ = ["FileInfo", "PointFormat", "ReadOptions", "WriteOptions"]


@dataclass(frozen=True)
class FileInfo:
    """Description of a file from its header, without reading its points."""

    path: Path
    format: str  # name of its format
    n_points: int
    columns: Mapping[str, np.dtype]  # columns of the result of `read`, after renaming, with their types there
    origin: NDArray[np.float64]  # local zero of every range of the file in world coordinates, metres
    crs: str | None = None  # coordinate reference system as WKT
    bounds: NDArray[np.float64] | None = None  # (2, 3): minimum and maximum in metres, where the header has them
    details: Mapping[str, Any] = field(default_factory=dict)  # others of the format, such as the version of a LAS file
    notes: tuple[str, ...] = ()  # one sentence per guess and repair of the reader that a user should know of


class PointFormat(Protocol):
    """A point cloud format; each has a module and an entry in `registry.FORMATS`."""

    name: str  # in messages
    extensions: tuple[str, ...]  # file name endings in lower case, with the dot; ``.txt.gz`` is one, too
    signatures: tuple[bytes, ...]  # first bytes of such files; empty where the format has none

    def recognises(self, path: Path, head: bytes) -> bool:
        """Return whether the first bytes of a file are those of this format.

        Formats without signatures examine the content or the name.
        """
        return head.startswith(self.signatures) if self.signatures else False

    def info(self, path: Path, options: ReadOptions) -> FileInfo:
        """Return the description of the file; raise `ReadError` where it is not of this format or is damaged."""
        ...

    def read(self, path: Path, options: ReadOptions, *, start: int = 0, stop: int | None = None) -> PointCloud:
        """Return rows `start` to `stop` (None: the end; clipped to the file) with their columns, in file order.

        `ReadError` for damaged files, `MissingColumnError` if a mapped column is not in the file, `DataError` if a
        value is outside its domain.
        """
        ...

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write the cloud; the file appears whole or not at all."""
