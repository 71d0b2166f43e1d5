"""Stored point records of LAS and LAZ files, by ranges."""

import struct
from collections.abc import Iterable, Sequence
from itertools import chain, count
from pathlib import Path
from types import TracebackType
from typing import Self

import lazrs
import numpy as np
from laspy.point.dims import ALL_POINT_FORMATS_DTYPE, COMPOSED_FIELDS
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.files import FileKey, clip_range, file_key, open_content
from mlsroad_pipeline.formats.las.chunks import (
    PointwisePoints,
    VariableChunks,
    check_chunk_table,
    check_layers,
    damaged_rows,
)
from mlsroad_pipeline.formats.las.counts import POINTWISE
from mlsroad_pipeline.formats.las.extra import NAME_BYTES, cut_text
from mlsroad_pipeline.formats.las.header import LASZIP, LasHeader

EXTRA = "_extra"  # suffix of a name that occurs twice
SELECT_ALL = int(lazrs.SELECTIVE_DECOMPRESS_ALL)

# Field of a record in point formats 6 to 8 to the layer that holds it; the scanner channel is in the first one too.
_LAYERS = {
    **dict.fromkeys(("X", "Y", "bit_fields"), int(lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL)),
    "Z": int(lazrs.SELECTIVE_DECOMPRESS_Z),
    "intensity": int(lazrs.SELECTIVE_DECOMPRESS_INTENSITY),
    "classification_flags": int(lazrs.SELECTIVE_DECOMPRESS_FLAGS),
    "classification": int(lazrs.SELECTIVE_DECOMPRESS_CLASSIFICATION),
    "user_data": int(lazrs.SELECTIVE_DECOMPRESS_USER_DATA),
    "scan_angle": int(lazrs.SELECTIVE_DECOMPRESS_SCAN_ANGLE),
    "point_source_id": int(lazrs.SELECTIVE_DECOMPRESS_POINT_SOURCE_ID),
    "gps_time": int(lazrs.SELECTIVE_DECOMPRESS_GPS_TIME),
    **dict.fromkeys(("red", "green", "blue"), int(lazrs.SELECTIVE_DECOMPRESS_RGB)),
    "nir": int(lazrs.SELECTIVE_DECOMPRESS_NIR),
}
# LAZ files of at most so many points are decompressed as a whole once rows inside a chunk are read.
KEPT_POINTS = 1_000_000
# Records of the last small file; a chunk can be decompressed from its first point only, and samples need many.
_kept: dict[tuple[FileKey, np.dtype], NDArray] = {}


def record_dtype(header: LasHeader) -> np.dtype:
    """Return the structured type of a file's records, bit fields packed: names of laspy, then the extra dimensions."""
    fields = list(ALL_POINT_FORMATS_DTYPE[header.point_format].descr)
    extra = header.extra_dimensions
    names = unique_names(header.point_format, [dimension.name for dimension in extra])
    return np.dtype([*fields, *((name, *d.field_type[1:]) for name, d in zip(names, extra, strict=True))])


def layers_of(header: LasHeader, names: Iterable[str]) -> int:
    """Return the layers (`select` of a `RecordReader`) that hold coordinates and some dimensions.

    All for files that a reader keeps in memory. ``names`` are those of `dimension_names` without coordinates.
    """
    if header.n_points <= KEPT_POINTS or header.point_format not in (6, 7, 8):
        return SELECT_ALL
    parts = COMPOSED_FIELDS[header.point_format]
    field_of = {part.name: field for field, group in parts.items() for part in group}
    extra = int(lazrs.SELECTIVE_DECOMPRESS_ALL_EXTRA_BYTES)
    select = _LAYERS["X"] | _LAYERS["Z"]
    for name in names:
        select |= _LAYERS.get(field_of.get(name, name), extra)
    return select


def unique_names(point_format: int, names: Sequence[str]) -> list[str]:
    """Return names of extra dimensions that differ from each other and from those of the standard.

    One that is taken gets ``_extra`` appended, shortened where it has more than 32 bytes; an empty one is ``unnamed``.
    """
    parts = COMPOSED_FIELDS[point_format].values()
    taken = {*ALL_POINT_FORMATS_DTYPE[point_format].names, *(part.name for group in parts for part in group), *"xyz"}
    unique: list[str] = []
    for given in names:
        name = own = given.strip() or "unnamed"
        suffixes = chain((EXTRA, EXTRA + EXTRA), (f"_{number}" for number in count(len(unique))))
        while name in taken:
            suffix = next(suffixes)
            name = cut_text(own, NAME_BYTES - len(suffix)) + suffix
        taken.add(name)
        unique.append(name)
    return unique


class RecordReader:
    """Reader of ranges of records of one file; a context manager.

    ``select``: for point formats 6 to 10 in LAZ, the fields that are decompressed (lazrs flags); others are zero. Above
    one of ``n_threads``, chunks are decompressed in parallel. `ReadError` if the file holds fewer points than its
    header states, or its chunk table is damaged.
    """

    def __init__(self, path: Path, header: LasHeader, *, n_threads: int = 1, select: int = SELECT_ALL) -> None:
        self.path, self.header, self.dtype = path, header, record_dtype(header)
        self._file = open_content(path)
        self._stream = self._file.stream()
        self._position = 0
        self._select = select
        self._decompressor = None
        self._other: VariableChunks | PointwisePoints | None = None
        try:
            if header.compressed and header.n_points:
                laszip = header.find(LASZIP)
                if laszip is not None and laszip.data[:1] == bytes([POINTWISE]):
                    self._other = self._open_pointwise(laszip.data)
                else:
                    self._decompressor = self._open_laz(n_threads, select)
            else:
                self._check_size()
        except BaseException:
            self._stream.close()
            raise

    def __enter__(self) -> Self:
        """Return the reader."""
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close the file."""
        self._stream.close()

    def read(self, start: int, stop: int | None = None) -> NDArray:
        """Return the records ``start`` to ``stop``, clipped to the end (None); `ReadError` for damaged data."""
        start, stop = clip_range(start, stop, self.header.n_points)
        if start == stop:
            return np.empty(0, dtype=self.dtype)
        kept = self._from_memory(start, stop)
        if kept is not None:
            return kept
        buffer = bytearray((stop - start) * self.header.record_size)
        if self._other is not None:
            return self._other.read(start, stop).view(self.dtype)
        if self._decompressor is None:
            self._stream.seek(self.header.point_offset + start * self.header.record_size)
            if self._stream.readinto(buffer) != len(buffer):
                raise ReadError(f"{self.path} is truncated within rows {start} to {stop - 1}")
        else:
            self._decompress(buffer, start, stop)
        return np.frombuffer(buffer, dtype=self.dtype)

    def compressed(self, number: int) -> bytes:
        """Return a chunk, by its number, of a LAZ file with chunks of one size, as it is stored."""
        here = self._stream.tell()
        self._stream.seek(int(self._begins[number]))
        data = self._stream.read(int(self._begins[number + 1] - self._begins[number]))
        self._stream.seek(here)
        return data

    def _from_memory(self, start: int, stop: int) -> NDArray | None:
        """Return records of a small LAZ file from memory, or None; who reads all of them takes them out of it."""
        n_points = self.header.n_points
        if self._decompressor is None or self._select != SELECT_ALL or n_points > KEPT_POINTS:
            return None
        key = file_key(self.path), self.dtype
        if key not in _kept:
            if start == self._position or start % self._chunk_size == 0:
                return None
            buffer = bytearray(n_points * self.header.record_size)
            try:
                self._decompress(buffer, 0, n_points)
            except ReadError:  # elsewhere than in these rows, perhaps
                return None
            _kept.clear()
            _kept[key] = np.frombuffer(buffer, dtype=self.dtype)
        if (start, stop) == (0, n_points):
            return _kept.pop(key)
        return _kept[key][start:stop].copy()

    def _decompress(self, buffer: bytearray, start: int, stop: int) -> None:
        assert self._decompressor is not None
        self._check_layers(start, stop)
        try:
            if start != self._position:
                self._decompressor.seek(start)
            self._decompressor.decompress_many(buffer)
        except lazrs.LazrsError as error:
            self._position = -1
            raise damaged_rows(self.path, start, stop, error) from error
        self._position = stop

    def _check_layers(self, start: int, stop: int) -> None:
        """Check the chunks of a range before decompression, each until it is found sound."""
        here = self._stream.tell()
        try:
            for number in range(start // self._chunk_size, -(-stop // self._chunk_size)):
                if number in self._unchecked:
                    _, n_bytes = self._unchecked[number]
                    n_points = min(self._chunk_size, self.header.n_points - number * self._chunk_size)
                    check_layers(self._stream, self.header, (int(self._begins[number]), n_bytes, n_points), self.path)
                    del self._unchecked[number]
        finally:
            self._stream.seek(here)

    def _check_size(self) -> None:
        header, size = self.header, self._file.size
        needed = header.point_offset + header.n_points * header.record_size
        if needed > size:
            have = (size - header.point_offset) // header.record_size
            raise ReadError(f"{self.path} is truncated: its header states {header.n_points} points, it holds {have}")

    def _open_pointwise(self, record: bytes) -> PointwisePoints:
        try:
            return PointwisePoints(self._stream, self.header, self.path, record)
        except (lazrs.LazrsError, struct.error) as error:
            raise ReadError(f"{self.path} is damaged: {error}") from error

    def _open_laz(self, n_threads: int, select: int) -> lazrs.LasZipDecompressor | lazrs.ParLasZipDecompressor:
        vlr = self.header.find(LASZIP)
        assert vlr is not None
        try:
            laz = lazrs.LazVlr(vlr.data)
            if laz.item_size() != self.header.record_size:
                expected = self.header.record_size
                raise ReadError(
                    f"{self.path} is damaged: its LASzip record describes points of {laz.item_size()} bytes, "
                    f"its header of {expected}"
                )
            chunks = check_chunk_table(self._stream, self.header, laz, self.path)
            if laz.uses_variable_size_chunks():
                self._other = VariableChunks(self._stream, self.header, self.path, vlr.data, chunks, select)
            self._chunk_size, self._unchecked = laz.chunk_size(), dict(enumerate(chunks))
            self._begins = self.header.point_offset + 8 + np.cumsum([0, *(n_bytes for _, n_bytes in chunks)])
            self._stream.seek(self.header.point_offset)
            kind = lazrs.ParLasZipDecompressor if n_threads > 1 else lazrs.LasZipDecompressor
            return kind(self._stream, vlr.data, lazrs.DecompressionSelection(select))
        except lazrs.LazrsError as error:
            raise ReadError(f"{self.path} is damaged: {error}") from error
