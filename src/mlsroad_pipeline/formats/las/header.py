"""LAS headers and variable length records, byte for byte.

Unknown content is kept unchanged: the header holds its original bytes, and only changed fields are patched.
(ASPRS LAS specification 1.4 R15, sections 2.4 to 2.7; offsets below are from the start of the file.)
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.content import open_content
from mlsroad_pipeline.formats.files import check_expansion, file_key
from mlsroad_pipeline.formats.las.counts import compressed_points, stored_points, waveform_start
from mlsroad_pipeline.formats.las.extra import DESCRIPTOR_SIZE, LAST_TYPE, SCALE_BITS, ExtraDimension, undocumented


@dataclass(frozen=True)
class Vlr:
    """A variable length record, or an extended one (EVLR)."""

    user_id: bytes  # identifier of the record's owner, up to 16 bytes; a record read from a file keeps its padding
    record_id: int  # number of the record among those of the user, 0 to 65535
    data: bytes  # payload, without the record header
    description: bytes = b""  # free text, up to 32 bytes
    reserved: int = 0  # first two bytes of the record header, as read

    @property
    def key(self) -> tuple[bytes, int]:
        """Return user id (without padding) and record id, which together identify the type of the record."""
        return self.user_id.split(b"\0")[0], self.record_id

    def pack(self, *, extended: bool = False) -> bytes:
        """Return the bytes of the record in a file."""
        form = "<H16sHQ32s" if extended else "<H16sHH32s"
        head = struct.pack(form, self.reserved, self.user_id, self.record_id, len(self.data), self.description)
        return head + self.data


SIGNATURE = b"LASF"
HEADER_SIZES = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375, 5: 393}
RECORD_SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""Bytes of a point of formats 0 to 10, extra bytes left out."""

COMPRESSED = 0x80
WKT_BIT = 0x10
SMALLEST_STEP, LARGEST_STEP = 1e-20, 1e6
"""Valid range of scales."""

EXTRA_BYTES = (b"LASF_Spec", 4)
LASZIP = (b"laszip encoded", 22204)


@dataclass(frozen=True)
class LasHeader:
    """Header and variable length records of a LAS or LAZ file."""

    block: bytes  # the public header block with bytes appended by its writer
    vlrs: tuple[Vlr, ...] = ()  # the records before the points, the LASzip one included
    gap: bytes = b""  # bytes between the last of these records and the points
    evlrs: tuple[Vlr, ...] = ()  # the extended records behind the points
    notes: tuple[str, ...] = ()  # one sentence per statement of the header that the file contradicts

    def get(self, form: str, offset: int) -> int | float:
        """Return one field of the header."""
        value: int | float = struct.unpack_from("<" + form, self.block, offset)[0]
        return value

    def integer(self, form: str, offset: int) -> int:
        """Return one integer field of the header."""
        return int(self.get(form, offset))

    def patched(self, *changes: tuple[str, int, object]) -> LasHeader:
        """Return the header with fields (form, offset, value or sequence of values) replaced."""
        block = bytearray(self.block)
        for form, offset, value in changes:
            values = value if isinstance(value, (tuple, list, np.ndarray)) else (value,)
            struct.pack_into("<" + form, block, offset, *values)
        return replace(self, block=bytes(block))

    @property
    def minor(self) -> int:
        """Return the minor version."""
        return self.block[25]

    @property
    def point_format(self) -> int:
        """Return the number of the point format, 0 to 10."""
        return self.block[104] & 0x3F

    @property
    def compressed(self) -> bool:
        """Return whether the points are compressed."""
        return bool(self.block[104] & COMPRESSED)

    @property
    def record_size(self) -> int:
        """Return the bytes of one uncompressed point."""
        return self.integer("H", 105)

    @property
    def point_offset(self) -> int:
        """Return the byte offset of the points."""
        return self.integer("I", 96)

    @property
    def n_points(self) -> int:
        """Return the number of points."""
        legacy = self.integer("I", 107)
        return self.integer("Q", 247) or legacy if self.minor >= 4 else legacy

    def with_points(self, n_points: int) -> LasHeader:
        """Return the header with another number of points."""
        legacy = n_points if self.minor < 4 or (self.integer("I", 107) and n_points < 2**32) else 0
        changes: list[tuple[str, int, object]] = [("I", 107, legacy)]
        return self.patched(*changes, *([("Q", 247, n_points)] if self.minor >= 4 else []))

    @property
    def scale(self) -> NDArray[np.float64]:
        """Return the resolution of x, y and z."""
        return np.frombuffer(self.block, "<f8", 3, 131).copy()

    @property
    def offset(self) -> NDArray[np.float64]:
        """Return the offset of x, y and z: the coordinates of the integer zero."""
        return np.frombuffer(self.block, "<f8", 3, 155).copy()

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Return minimum and maximum coordinates, shape (2, 3), in the file's unit."""
        high_low = np.frombuffer(self.block, "<f8", 6, 179).reshape(3, 2)
        return np.array([high_low[:, 1], high_low[:, 0]])

    def find(self, key: tuple[bytes, int]) -> Vlr | None:
        """Return the first record with this user id and record id, extended ones included."""
        return next((vlr for vlr in (*self.vlrs, *self.evlrs) if vlr.key == key), None)

    @property
    def extra_dimensions(self) -> tuple[ExtraDimension, ...]:
        """Return the extra dimensions; bytes without a descriptor are one named ``extra_bytes``."""
        spare = self.record_size - RECORD_SIZES[self.point_format]
        dimensions: list[ExtraDimension] = []
        records = [vlr.data for vlr in (*self.vlrs, *self.evlrs) if vlr.key == EXTRA_BYTES]
        data = b"".join(part[: len(part) // DESCRIPTOR_SIZE * DESCRIPTOR_SIZE] for part in records) if spare else b""
        for at in range(0, len(data) - DESCRIPTOR_SIZE + 1, DESCRIPTOR_SIZE):
            if data[at + 2] > LAST_TYPE:
                break  # a type that is not defined has no size
            dimension = ExtraDimension.parse(data[at : at + DESCRIPTOR_SIZE])
            size = dimension.dtype.itemsize * dimension.width
            if size > spare:
                break
            untyped = data[at + 2] == 0 and size & SCALE_BITS  # laspy would take the size for a scale
            dimensions += undocumented(size, dimension.name) if untyped else [dimension]
            spare -= size
        return (*dimensions, *undocumented(spare))


def read_header(path: Path) -> LasHeader:
    """Read header and records of a LAS or LAZ file; `ReadError` if it is not LAS, of an unknown version, or cut."""
    file = open_content(path)
    with file.stream() as stream:
        size = file.size
        block = stream.read(227)
        if block[:4] != SIGNATURE:
            raise ReadError(f"{path} is not a LAS or LAZ file: it begins with {block[:4]!r}, not {SIGNATURE!r}")
        if len(block) < 227:
            raise ReadError(f"{path} is truncated: {size} bytes, the LAS header alone has 227")
        header_size, point_offset = struct.unpack_from("<HI", block, 94)
        _check_version(block, header_size, path)
        if point_offset > size:
            raise ReadError(f"{path} is truncated: its points begin at byte {point_offset} and it has {size}")
        if header_size > point_offset:
            raise ReadError(f"{path} is damaged: a header of {header_size} bytes, but points from byte {point_offset}")
        block += stream.read(header_size - len(block))
        count = struct.unpack_from("<I", block, 100)[0]
        vlrs = [_read_vlr(stream, path, limit=point_offset, extended=False) for _ in range(count)]
        header = LasHeader(block, tuple(vlrs), stream.read(point_offset - stream.tell()))
        header = _with_evlrs(stream, header, path, size)
    _check_records(header, path)
    return _with_count(header, path)


def _with_count(header: LasHeader, path: Path) -> LasHeader:
    """Return the header with the number of points that the file holds, if that is larger than the stated one."""
    stated, note, laz = header.n_points, "", header.find(LASZIP)
    if header.compressed and laz is not None:
        layout = (header.point_format, header.record_size)
        n_points, note = compressed_points(file_key(path), header.point_offset, laz.data, layout, stated)
        check_expansion(path, n_points * header.record_size, open_content(path).size)
    elif header.compressed:
        return header
    elif header.evlrs or header.notes:  # the offset of the extended records bounds the points, or is wrong
        start = header.integer("Q", 235 if header.minor >= 4 else 227) if header.evlrs else 0
        whole = (start - header.point_offset) % header.record_size == 0
        n_points, note = stated, ""
        if start and whole:
            n_points, note = stored_points(open_content(path), header.block, stated, start)
    else:
        file = open_content(path)
        n_points, note = stored_points(file, header.block, stated, file.size)
    return replace(header.with_points(n_points), notes=(*header.notes, note)) if note else header


def _check_version(block: bytes, header_size: int, path: Path) -> None:
    major, minor, point_format = block[24], block[25], block[104] & 0x3F
    if major != 1 or minor not in HEADER_SIZES:
        raise ReadError(f"{path} is LAS {major}.{minor}; versions 1.0 to 1.5 can be read")
    if header_size < HEADER_SIZES[minor]:
        raise ReadError(f"{path} is damaged: a LAS 1.{minor} header of {header_size} bytes, not {HEADER_SIZES[minor]}")
    if point_format >= len(RECORD_SIZES):
        raise ReadError(f"{path} has points of format {point_format}; formats 0 to 10 can be read")
    record_size = struct.unpack_from("<H", block, 105)[0]
    if record_size < RECORD_SIZES[point_format]:
        expected = RECORD_SIZES[point_format]
        raise ReadError(f"{path} is damaged: points of format {point_format} with {record_size} bytes, not {expected}")


def _check_records(header: LasHeader, path: Path) -> None:
    steps = np.abs(header.scale)
    if not (((steps > SMALLEST_STEP) & (steps < LARGEST_STEP)).all() and np.isfinite(header.offset).all()):
        raise ReadError(f"{path} is damaged: scale {header.scale.tolist()}, offset {header.offset.tolist()}")
    if header.compressed and header.n_points and header.find(LASZIP) is None:
        raise ReadError(f"{path} is damaged: its points are compressed, but it has no LASzip record")


def _read_vlr(stream: BinaryIO, path: Path, *, limit: int, extended: bool) -> Vlr:
    size = 60 if extended else 54
    at = stream.tell()
    head = stream.read(size)
    if at + size > limit or len(head) < size:
        raise ReadError(f"{path} is damaged: the variable length record at byte {at} reaches beyond byte {limit}")
    form = "<H16sHQ32s" if extended else "<H16sHH32s"
    reserved, user_id, record_id, length, description = struct.unpack(form, head)
    if at + size + length > limit:
        raise ReadError(f"{path} is damaged: a variable length record of {length} bytes reaches beyond byte {limit}")
    return Vlr(user_id, record_id, stream.read(length), description, reserved)


def _with_evlrs(stream: BinaryIO, header: LasHeader, path: Path, size: int) -> LasHeader:
    """Read the extended records; in LAS 1.3 the waveform packets are one, with its own byte offset."""
    note = ""
    if header.minor >= 4:
        start, count = header.integer("Q", 235), header.integer("I", 243)
        if count and start < header.point_offset:
            note = f"its header states {count} extended records at byte {start}, before its points: not read"
            count = 0
    else:
        start, note = waveform_start(header.block) if header.minor == 3 else (0, "")
        count = int(start > 0)
    if not count:
        return replace(header, notes=(*header.notes, note)) if note else header
    if start > size:
        raise ReadError(f"{path} is truncated: its extended records begin at byte {start} and it has {size}")
    stream.seek(start)
    return replace(header, evlrs=tuple(_read_vlr(stream, path, limit=size, extended=True) for _ in range(count)))


def pack_header(header: LasHeader) -> bytes:
    """Return the bytes of header and records up to the first point, sizes and counts updated."""
    records = b"".join(vlr.pack() for vlr in header.vlrs)
    point_offset = len(header.block) + len(records) + len(header.gap)
    done = header.patched(("H", 94, len(header.block)), ("I", 96, point_offset), ("I", 100, len(header.vlrs)))
    return done.block + records + header.gap
