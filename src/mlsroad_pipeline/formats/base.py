"""Interface of a point cloud format."""

from __future__ import annotations

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
    """Description of a file from its header, without reading its points.

    Parameters
    ----------
    path : Path
        The file.
    format : str
        Name of its format.
    n_points : int
        Number of points.
    columns : mapping of str to dtype
        Columns of the result of `read`, after renaming, with their types there.
    origin : ndarray of shape (3,), float64
        World coordinates in metres of the local zero that every range of this file is read relative to.
    crs : str or None
        Coordinate reference system as WKT.
    bounds : ndarray of shape (2, 3) or None
        Minimum and maximum world coordinates in metres, where the header has them.
    details : mapping
        Format-specific details, such as a LAS file's version, point format, scale, offset, creation date, time type.
    notes : tuple of str
        One sentence per guess and repair of the reader that a user should know of.
    """

    path: Path
    format: str
    n_points: int
    columns: Mapping[str, np.dtype]
    origin: NDArray[np.float64]
    crs: str | None = None
    bounds: NDArray[np.float64] | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


class PointFormat(Protocol):
    """A point cloud format; each has a module and an entry in `registry.FORMATS`.

    Attributes
    ----------
    name : str
        Name of the format in messages.
    extensions : tuple of str
        File name endings in lower case, with the dot; compound ones (``.txt.gz``) are allowed.
    signatures : tuple of bytes
        First bytes of such files; empty where the format has none.
    """

    name: str
    extensions: tuple[str, ...]
    signatures: tuple[bytes, ...]

    def recognises(self, path: Path, head: bytes) -> bool:
        """Return whether the content of a file identifies this format.

        Parameters
        ----------
        path : Path
            The file.
        head : bytes
            Its first bytes.

        Returns
        -------
        bool
            Whether it begins with a signature; formats without signatures examine the content or the name.
        """
        del path
        return head.startswith(self.signatures) if self.signatures else False

    def info(self, path: Path, options: ReadOptions) -> FileInfo:
        """Return the description of the file; raise `ReadError` where it is not of this format or is damaged.

        Parameters
        ----------
        path : Path
            The file.
        options : ReadOptions
            Options of reading.

        Returns
        -------
        FileInfo
            Its description.
        """
        ...

    def read(self, path: Path, options: ReadOptions, *, start: int = 0, stop: int | None = None) -> PointCloud:
        """Return rows `start` to `stop` (None: the end; clipped to the file) with their columns, in file order.

        Parameters
        ----------
        path : Path
            The file.
        options : ReadOptions
            Options of reading.
        start, stop : int
            First row and the row after the last.

        Returns
        -------
        PointCloud
            The points.
        """
        ...

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write the cloud; the file appears whole or not at all.

        Parameters
        ----------
        path : Path
            The file to write.
        cloud : PointCloud
            The points.
        options : WriteOptions
            Options of writing.
        """
