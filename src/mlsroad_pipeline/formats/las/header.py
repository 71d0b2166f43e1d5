"""LAS headers and variable length records, byte for byte.

Unknown content is kept unchanged: the header holds its original bytes, and only changed fields are patched.
(ASPRS LAS specification 1.4 R15, sections 2.4 to 2.7)
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.files import check_expansion, file_key, open_content
from mlsroad_pipeline.formats.las.counts import compressed_points, stored_points
from mlsroad_pipeline.formats.las.extra import ExtraDimension, parse_descriptors

# Head of a record, and of an extended one: reserved, user id, record id, length of the data, description.
VLR_FORMS = {False: struct.Struct("<H16sHH32s"), True: struct.Struct("<H16sHQ32s")}


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
        size = len(self.data)
        return VLR_FORMS[extended].pack(self.reserved, self.user_id, self.record_id, size, self.description) + self.data


SIGNATURE = b"LASF"
# Fields of the public header block of LAS 1.4; earlier versions have the first of them. Bounds: maximum first.
FIELDS = np.dtype(
    [
        *(("signature", "S4"), ("source_id", "<u2"), ("encoding", "<u2"), ("guid", "V16"), ("major", "u1")),
        *(("minor", "u1"), ("system", "S32"), ("software", "S32"), ("day", "<u2"), ("year", "<u2")),
        *(("header_size", "<u2"), ("point_offset", "<u4"), ("n_vlrs", "<u4"), ("layout", "u1"), ("record_size", "<u2")),
        *(("legacy_count", "<u4"), ("legacy_returns", "<u4", 5), ("scale", "<f8", 3), ("offset", "<f8", 3)),
        *(("bounds", "<f8", (3, 2)), ("waveforms", "<u8"), ("evlr_start", "<u8"), ("n_evlrs", "<u4")),
        *(("count", "<u8"), ("returns", "<u8", 15)),
    ]
)
SMALLEST_HEADER = 227
HEADER_SIZES = {0: SMALLEST_HEADER, 1: SMALLEST_HEADER, 2: SMALLEST_HEADER, 3: 235, 4: 375, 5: 393}
RECORD_SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)  # bytes of a point of formats 0 to 10, extra bytes left out
FORMAT_BITS, COMPRESSED = 0x3F, 0x80
WKT_BIT = 0x10
INTERNAL, EXTERNAL = 0x02, 0x04  # bits of the global encoding: waveform packets in the file, or in another one
WAVEFORMS = (4, 5, 9, 10)
SMALLEST_STEP, LARGEST_STEP = 1e-20, 1e6  # valid range of scales
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

    @cached_property
    def fields(self) -> np.void:
        """Return the record of `FIELDS`; those that the version lacks are bytes appended by the writer, or zero."""
        record: np.void = np.frombuffer(self.block.ljust(FIELDS.itemsize, b"\0"), FIELDS, 1)[0]
        return record

    def integer(self, name: str) -> int:
        """Return an integer field."""
        return int(self.fields[name])

    def patched(self, **values: object) -> LasHeader:
        """Return the header with other values of `FIELDS`, which its version has."""
        block = bytearray(self.block.ljust(FIELDS.itemsize, b"\0"))
        for name, value in values.items():
            np.frombuffer(block, FIELDS, 1)[name] = value
        return replace(self, block=bytes(block[: len(self.block)]))

    @property
    def minor(self) -> int:
        """Return the minor version."""
        return self.integer("minor")

    @property
    def point_format(self) -> int:
        """Return the number of the point format, 0 to 10."""
        return self.integer("layout") & FORMAT_BITS

    @property
    def compressed(self) -> bool:
        """Return whether the points are compressed."""
        return bool(self.integer("layout") & COMPRESSED)

    @property
    def record_size(self) -> int:
        """Return the bytes of one uncompressed point."""
        return self.integer("record_size")

    @property
    def point_offset(self) -> int:
        """Return the byte offset of the points."""
        return self.integer("point_offset")

    @property
    def n_points(self) -> int:
        """Return the number of points."""
        return (self.minor >= 4 and self.integer("count")) or self.integer("legacy_count")

    def with_points(self, n_points: int) -> LasHeader:
        """Return the header with another number of points."""
        if self.minor < 4:
            return self.patched(legacy_count=n_points)
        legacy = n_points if self.integer("legacy_count") and n_points < 2**32 else 0
        return self.patched(legacy_count=legacy, count=n_points)

    @property
    def scale(self) -> NDArray[np.float64]:
        """Return the resolution of x, y and z."""
        return np.array(self.fields["scale"])

    @property
    def offset(self) -> NDArray[np.float64]:
        """Return the offset of x, y and z: the coordinates of the integer zero."""
        return np.array(self.fields["offset"])

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Return minimum and maximum coordinates, shape (2, 3), in the file's unit."""
        return np.array(self.fields["bounds"].T[::-1])

    def find(self, key: tuple[bytes, int]) -> Vlr | None:
        """Return the first record with this user id and record id, extended ones included."""
        return next((vlr for vlr in (*self.vlrs, *self.evlrs) if vlr.key == key), None)

    def without(self, *keys: tuple[bytes, int]) -> LasHeader:
        """Return the header without the records of these keys."""
        vlrs, evlrs = (tuple(vlr for vlr in group if vlr.key not in keys) for group in (self.vlrs, self.evlrs))
        return replace(self, vlrs=vlrs, evlrs=evlrs)

    @cached_property
    def extra_dimensions(self) -> tuple[ExtraDimension, ...]:
        """Return the extra dimensions; bytes without a descriptor are one named ``extra_bytes``."""
        spare = self.record_size - RECORD_SIZES[self.point_format]
        records = [vlr.data for vlr in (*self.vlrs, *self.evlrs) if vlr.key == EXTRA_BYTES]
        return parse_descriptors(records, spare)


def read_header(path: Path) -> LasHeader:
    """Read header and records of a LAS or LAZ file; `ReadError` if it is not LAS, of an unknown version, or cut."""
    file = open_content(path)
    with file.stream() as stream:
        header = LasHeader(stream.read(SMALLEST_HEADER))
        if header.block[:4] != SIGNATURE:
            raise ReadError(f"{path} is not a LAS or LAZ file: it begins with {header.block[:4]!r}, not {SIGNATURE!r}")
        if len(header.block) < SMALLEST_HEADER:
            raise ReadError(f"{path} is truncated: {file.size} bytes, the LAS header alone has {SMALLEST_HEADER}")
        _check_version(header, path)
        size, begin = header.integer("header_size"), header.point_offset
        if begin > file.size:
            raise ReadError(f"{path} is truncated: its points begin at byte {begin} and it has {file.size}")
        if size > begin:
            raise ReadError(f"{path} is damaged: a header of {size} bytes, but points from byte {begin}")
        block = header.block + stream.read(size - SMALLEST_HEADER)
        vlrs = tuple(_read_vlr(stream, path, limit=begin) for _ in range(header.integer("n_vlrs")))
        header = LasHeader(block, vlrs, stream.read(begin - stream.tell()))
        header = _with_evlrs(stream, header, path, file.size)
    steps = np.abs(header.scale)
    if not (((steps > SMALLEST_STEP) & (steps < LARGEST_STEP)).all() and np.isfinite(header.offset).all()):
        raise ReadError(f"{path} is damaged: scale {header.scale.tolist()}, offset {header.offset.tolist()}")
    return _with_count(header, path)


def _with_count(header: LasHeader, path: Path) -> LasHeader:
    """Return the header with the number of points that the file holds, if that is larger than the stated one."""
    file, stated, note = open_content(path), header.n_points, ""
    n_points, begin, size, laz = stated, header.point_offset, header.record_size, header.find(LASZIP)
    if header.compressed:
        if laz is None and stated:
            raise ReadError(f"{path} is damaged: its points are compressed, but it has no LASzip record")
        if laz is not None:
            n_points, note = compressed_points(file_key(path), begin, laz.data, (header.point_format, size), stated)
            check_expansion(path, n_points * size, file.size)
    elif not (header.evlrs or header.notes):
        n_points, note = stored_points(file, (begin, size), stated, file.size)
    elif header.evlrs:  # their offset bounds the points; with notes alone, it is wrong
        end = header.integer("evlr_start" if header.minor >= 4 else "waveforms")
        if (end - begin) % size == 0:
            n_points, note = stored_points(file, (begin, size), stated, end)
    return replace(header.with_points(n_points), notes=(*header.notes, note)) if note else header


def _check_version(header: LasHeader, path: Path) -> None:
    major, minor, point_format = header.integer("major"), header.minor, header.point_format
    if major != 1 or minor not in HEADER_SIZES:
        raise ReadError(f"{path} is LAS {major}.{minor}; versions 1.0 to 1.5 can be read")
    size, least = header.integer("header_size"), HEADER_SIZES[minor]
    if size < least:
        raise ReadError(f"{path} is damaged: a LAS 1.{minor} header of {size} bytes, not {least}")
    if point_format >= len(RECORD_SIZES):
        raise ReadError(f"{path} has points of format {point_format}; formats 0 to 10 can be read")
    size, least = header.record_size, RECORD_SIZES[point_format]
    if size < least:
        raise ReadError(f"{path} is damaged: points of format {point_format} with {size} bytes, not {least}")


def _read_vlr(stream: BinaryIO, path: Path, *, limit: int, extended: bool = False) -> Vlr:
    form = VLR_FORMS[extended]
    at, head = stream.tell(), stream.read(form.size)
    if at + form.size > limit or len(head) < form.size:
        raise ReadError(f"{path} is damaged: the variable length record at byte {at} reaches beyond byte {limit}")
    reserved, user_id, record_id, length, description = form.unpack(head)
    if at + form.size + length > limit:
        raise ReadError(f"{path} is damaged: a variable length record of {length} bytes reaches beyond byte {limit}")
    return Vlr(user_id, record_id, stream.read(length), description, reserved)


def _with_evlrs(stream: BinaryIO, header: LasHeader, path: Path, size: int) -> LasHeader:
    """Read the extended records; in LAS 1.3 the waveform packets are one, with its own byte offset."""
    start, count, note = 0, 0, ""
    if header.minor >= 4:
        start, count = header.integer("evlr_start"), header.integer("n_evlrs")
        if count and start < header.point_offset:
            note = f"its header states {count} extended records at byte {start}, before its points: not read"
    elif header.minor == 3:
        start = header.integer("waveforms")
        count, note = int(start > 0), _wrong_waveforms(header) if start else ""
    if note or not count:
        return replace(header, notes=(*header.notes, note)) if note else header
    if start > size:
        raise ReadError(f"{path} is truncated: its extended records begin at byte {start} and it has {size}")
    stream.seek(start)
    return replace(header, evlrs=tuple(_read_vlr(stream, path, limit=size, extended=True) for _ in range(count)))


def _wrong_waveforms(header: LasHeader) -> str:
    """Return a sentence if the byte offset of the waveform packets of a LAS 1.3 file is not used."""
    start, encoding = header.integer("waveforms"), header.integer("encoding")
    if header.point_format not in WAVEFORMS:
        return f"its header states waveform packets at byte {start}, but its points have none: not read"
    if encoding & EXTERNAL and not encoding & INTERNAL:
        return f"its waveform packets are in another file (.wdp), not at byte {start} as its header states: not read"
    if start < header.point_offset:
        return f"its header states waveform packets at byte {start}, before its points: not read"
    return ""


def pack_header(header: LasHeader) -> bytes:
    """Return the bytes of header and records up to the first point, sizes and counts updated."""
    records = b"".join(vlr.pack() for vlr in header.vlrs)
    size = len(header.block)
    point_offset = size + len(records) + len(header.gap)
    done = header.patched(header_size=size, point_offset=point_offset, n_vlrs=len(header.vlrs))
    return done.block + records + header.gap


# Classification Lookup record (section 2.6): names of the class codes of a file.
LOOKUP = (b"LASF_Spec", 0)
ENTRY = np.dtype([("code", "u1"), ("name", "S15")])
N_CODES = 256


def class_names(header: LasHeader) -> dict[int, str]:
    """Return code to name of the classes that a file names; empty without the record."""
    return {code: name.decode("utf-8", "replace") for code, name in _stored_names(header).items()}


def _stored_names(header: LasHeader) -> dict[int, bytes]:
    record = header.find(LOOKUP)
    if record is None:
        return {}
    entries = np.frombuffer(record.data[: len(record.data) // ENTRY.itemsize * ENTRY.itemsize], dtype=ENTRY)
    return {int(code): name for code, name in entries.tolist() if name}


def with_class_names(header: LasHeader, names: Mapping[int, str]) -> LasHeader:
    """Add names of class codes, 15 ASCII characters of each, to a header; those of other codes are kept."""
    if not names:
        return header
    entries = np.zeros(N_CODES, dtype=ENTRY)
    entries["code"] = np.arange(N_CODES)
    own = {code: name.encode("ascii", "replace") for code, name in names.items()}
    for code, text in {**_stored_names(header), **own}.items():
        entries["name"][code] = text
    record = Vlr(*LOOKUP, entries.tobytes(), b"Classification Lookup")
    others = header.without(LOOKUP)
    return replace(others, vlrs=(*others.vlrs, record))
