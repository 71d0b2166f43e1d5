"""Labelled LAZ files of an output folder, read in blocks of points for the page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import lazrs
import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.base import BY_CRS, ReadOptions
from mlsroad_pipeline.formats.crs import with_units
from mlsroad_pipeline.formats.files import file_key
from mlsroad_pipeline.formats.las.crs import read_crs
from mlsroad_pipeline.formats.las.dimensions import colour_bits, local_xyz, near_corner
from mlsroad_pipeline.formats.las.header import LasHeader, class_names, read_header
from mlsroad_pipeline.formats.las.records import RecordReader

REFERENCE = "original_classification"
"""Dimension with the class of the input, which is compared with the class of the result."""

SELECT = int(
    lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL
    | lazrs.SELECTIVE_DECOMPRESS_Z
    | lazrs.SELECTIVE_DECOMPRESS_CLASSIFICATION
    | lazrs.SELECTIVE_DECOMPRESS_INTENSITY
    | lazrs.SELECTIVE_DECOMPRESS_RGB
    | lazrs.SELECTIVE_DECOMPRESS_ALL_EXTRA_BYTES
)
CLASS_ONLY = int(lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL | lazrs.SELECTIVE_DECOMPRESS_CLASSIFICATION)
LAZ_CHUNK = 50_000
MOST_POINTS = 2**32 - 1


class Block(NamedTuple):
    """Points of a range of rows: local coordinates in metres, and what the page shows of each."""

    xyz: NDArray[np.float64]
    values: NDArray  # of dtype VALUES


VALUES = np.dtype(
    [
        ("intensity", "<u2"),
        ("object", "<u4"),
        ("row", "<u4"),
        ("class", "u1"),
        ("confidence", "u1"),
        ("reference", "u1"),
        ("spare", "u1"),
        ("rgb", "u1", (4,)),
    ]
)
"""Attributes of a point: `row` counts over all files, `confidence` is in steps of 1/255."""


@dataclass(frozen=True)
class CloudFile:
    """A labelled LAZ file."""

    path: Path  # The file
    name: str  # Its path below the output folder
    first: int  # Number of the points of the files before it

    @cached_property
    def header(self) -> LasHeader:
        """Header of the file."""
        return read_header(self.path)

    @cached_property
    def metres(self) -> NDArray[np.float64]:
        """Factors from the file's units to metres."""
        return np.asarray(with_units(ReadOptions(units=BY_CRS), read_crs(self.header), self.path).factors)

    @cached_property
    def colour_shift(self) -> int:
        """Bits to leave out of the 16-bit colours: none where they hold 8-bit colours."""
        return colour_bits(file_key(self.path)) - 8

    def corner(self) -> NDArray[np.float64]:
        """Return a position near the points in metres."""
        with RecordReader(self.path, self.header) as reader:
            return near_corner(reader.read(0, 1), self.header, self.metres)


@dataclass(frozen=True)
class CloudFiles:
    """All labelled files of an output folder as one sequence of points."""

    files: Sequence[CloudFile]  # The files, at least one

    @classmethod
    def at(cls, folder: Path, names: Sequence[str]) -> CloudFiles:
        """Return the files of an output folder; raise ReadError if one is missing or there are too many points."""
        files, first = [], 0
        for name in names:
            path = folder / name
            if not path.is_file():
                raise ReadError(f"{path} is missing: label the survey again")
            file = CloudFile(path, name, first)
            files.append(file)
            first += file.header.n_points
        if first > MOST_POINTS:
            raise ReadError(f"{folder} has {first:,} points, the page shows {MOST_POINTS:,} at most: label it in parts")
        return cls(files)

    @property
    def n_points(self) -> int:
        """Number of points."""
        last = self.files[-1]
        return last.first + last.header.n_points

    @cached_property
    def origin(self) -> NDArray[np.float64]:
        """Zero of the local coordinates: whole metres below the corners of the files."""
        return np.floor(np.min([file.corner() for file in self.files if file.header.n_points] or [np.zeros(3)], axis=0))

    @property
    def dimensions(self) -> set[str]:
        """Names of the dimensions that all files have."""
        names = []
        for file in self.files:
            with RecordReader(file.path, file.header) as reader:
                names.append(set(reader.dtype.names or ()))
        return set.intersection(*names)

    def class_names(self) -> dict[int, str]:
        """Return the names of class codes that the files state."""
        return {code: name for file in self.files for code, name in class_names(file.header).items()}

    def blocks(self, size: int, *, n_threads: int = 2) -> Iterator[Block]:
        """Yield all points, at most `size` at a time."""
        for file in self.files:
            with RecordReader(file.path, file.header, n_threads=n_threads, select=SELECT) as reader:
                for start in range(0, file.header.n_points, size):
                    yield self._block(file, reader.read(start, start + size), start)

    def codes(self, rows: NDArray[np.uint32]) -> NDArray[np.uint8]:
        """Return the class codes of ascending rows; the chunks that hold them are read."""
        parts = [np.empty(0, np.uint8)]
        for file in self.files:
            own = rows[(rows >= file.first) & (rows < file.first + file.header.n_points)].astype(np.int64) - file.first
            with RecordReader(file.path, file.header, select=CLASS_ONLY) as reader:
                for chunk in np.unique(own // LAZ_CHUNK):
                    records = reader.read(chunk * LAZ_CHUNK, (chunk + 1) * LAZ_CHUNK)
                    parts.append(records["classification"][own[own // LAZ_CHUNK == chunk] - chunk * LAZ_CHUNK])
        return np.concatenate(parts).astype(np.uint8)

    def sample(self, n_points: int, *, max_chunks: int = 100) -> Iterator[Block]:
        """Yield about `n_points` points: the first of evenly spaced chunks of the files, which are read alone."""
        n_chunks = sum(-(-file.header.n_points // LAZ_CHUNK) for file in self.files)
        step = max(1, -(-n_chunks // max_chunks))
        per_chunk = max(1, n_points // max(1, n_chunks // step))
        for file in self.files:
            with RecordReader(file.path, file.header, select=SELECT) as reader:
                for start in range(0, file.header.n_points, step * LAZ_CHUNK):
                    yield self._block(file, reader.read(start, start + min(per_chunk, LAZ_CHUNK)), start)

    def _block(self, file: CloudFile, records: NDArray, start: int) -> Block:
        xyz = local_xyz(records, file.header, self.origin, file.metres, path=file.path, start=start)
        names = records.dtype.names or ()
        values = np.zeros(len(records), dtype=VALUES)
        values["row"] = np.arange(file.first + start, file.first + start + len(records))
        values["intensity"], values["class"] = records["intensity"], records["classification"]
        if "confidence" in names:
            confidence = np.nan_to_num(np.asarray(records["confidence"], dtype=np.float32))
            values["confidence"] = np.clip(np.round(confidence * 255), 0, 255)
        if "object_id" in names:
            values["object"] = records["object_id"]
        if REFERENCE in names:
            values["reference"] = records[REFERENCE]
        if "red" in names:
            for i, channel in enumerate(("red", "green", "blue")):
                values["rgb"][:, i] = records[channel] >> file.colour_shift
        return Block(xyz, values)
