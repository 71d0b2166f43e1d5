"""Scans of an E57 file: descriptions in its XML and byte offsets of their values."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from xml.etree import ElementTree as ET

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.e57.pages import E57Pages

NAMESPACE = "{http://www.astm.org/COMMIT/E57/2010-e57-v1.0}"
SECTION = struct.Struct("<B7xQQQ")
COMPRESSED_VECTOR, DATA_PACKET = 1, 1
LARGEST_XML = 1 << 28
PADDED = 9  # smallest number of uncounted records that is reported
LEAST_NORM = 1e-9  # smallest norm of a quaternion with a direction


@dataclass(frozen=True)
class E57Field:
    """One field of the points of a scan."""

    name: str  # such as ``cartesianX``; with a prefix where it belongs to an extension
    kind: str  # ``Float``, ``Integer``, ``ScaledInteger`` or ``String``
    bits: int  # bits of one value; 0 for a constant field
    minimum: float  # minimum and maximum, unscaled
    maximum: float
    scale: float = 1.0  # scale and offset of a scaled integer
    offset: float = 0.0

    @property
    def dtype(self) -> np.dtype:
        """Return the type of its values."""
        if self.kind == "Float":
            return np.dtype(f"f{self.bits // 8}")
        if self.kind == "ScaledInteger":
            return np.dtype("f8")
        kinds = [np.dtype(k) for k in ("u1", "i1", "u2", "i2", "u4", "i4", "i8", "u8")]
        fits = [k for k in kinds if np.iinfo(k).min <= self.minimum and self.maximum <= np.iinfo(k).max]
        return fits[0] if fits else np.dtype("i8")


@dataclass(frozen=True)
class E57Scan:
    """One scan of an E57 file."""

    name: str
    n_points: int
    fields: tuple[E57Field, ...]
    rotation: NDArray[np.float64]  # rotation from the scanner's frame to the file's
    translation: NDArray[np.float64]  # position of the scanner, metres
    limits: Mapping[str, float]  # stated limits of intensity and colours
    start: float  # time that time stamps count from
    # Per field: offsets of its pieces in the content, and the bytes before each with their sum at the end.
    streams: tuple[tuple[NDArray[np.int64], NDArray[np.int64]], ...] = field(default=(), repr=False)
    notes: tuple[str, ...] = ()  # sentences on repairs


def parse_xml(pages: E57Pages) -> ET.Element:
    """Return the root of the XML of a file; `ReadError` if it is not well-formed or declares entities."""
    if pages.xml_size > LARGEST_XML:
        raise ReadError(f"{pages.path} is damaged: its header states {pages.xml_size} bytes of XML")
    text = pages.read(pages.xml_start, pages.xml_size).tobytes()
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise ReadError(f"{pages.path}: its XML declares entities, which E57 does not allow")
    try:
        return ET.fromstring(text)
    except ET.ParseError as error:
        raise ReadError(f"{pages.path} is damaged: its XML: {error}") from None


def read_scans(pages: E57Pages, root: ET.Element) -> list[E57Scan]:
    """Return the scans of a file; `ReadError` if a description is damaged, or a section holds too few values."""
    scans = []
    for number, node in enumerate(root.findall(f"{NAMESPACE}data3D/*")):
        try:
            scans.append(_scan(pages, node, number))
        except (ValueError, TypeError, OverflowError, struct.error) as error:
            if isinstance(error, ReadError):
                raise
            raise ReadError(f"{pages.path} is damaged: the description of scan {number}: {error}") from None
    return scans


def _number(node: ET.Element, path: str, default: float) -> float:
    element = node.find("/".join(NAMESPACE + step for step in path.split("/")))
    if element is None:
        return default
    value = float(element.text or 0)
    return value * float(element.get("scale", 1)) + float(element.get("offset", 0))


def _scan(pages: E57Pages, node: ET.Element, number: int) -> E57Scan:
    points = node.find(NAMESPACE + "points")
    prototype = None if points is None else points.find(NAMESPACE + "prototype")
    if points is None or prototype is None:
        raise ValueError("it has no points")
    fields = tuple(_field(child) for child in prototype)
    n_points, at = int(points.get("recordCount", 0)), int(points.get("fileOffset", 0))
    if not 0 <= n_points <= 8 * pages.size:  # fields without bits take no space, so that the packets bound no count
        raise ValueError(f"it states {n_points} points in a file of {pages.size} bytes")
    quaternion = [_number(node, f"pose/rotation/{k}", float(k == "w")) for k in "wxyz"]
    translation = [_number(node, f"pose/translation/{k}", 0.0) for k in "xyz"]
    if not np.isfinite([*quaternion, *translation]).all():
        raise ValueError(f"pose {quaternion}, {translation}")
    notes = tuple[str, ...]()
    if np.linalg.norm(quaternion) < LEAST_NORM:
        quaternion = [1.0, 0.0, 0.0, 0.0]
        notes = (f"scan {number} has a rotation without a direction (a zero quaternion): it is not rotated",)
    limits = {}
    for group in ("intensityLimits", "colorLimits"):
        for child in node.iterfind(f"{NAMESPACE}{group}/*"):
            name = child.tag.removeprefix(NAMESPACE)
            limits[name] = _number(node, f"{group}/{name}", 0.0)
    streams = _streams(pages, fields, n_points, at, number) if n_points else ()
    notes += _left_over(fields, streams, n_points, number)
    name = node.findtext(NAMESPACE + "name") or str(number)
    start = _number(node, "acquisitionStart/dateTimeValue", 0.0)
    pose = (_rotation(quaternion), np.array(translation))
    return E57Scan(name, n_points, fields, *pose, limits, start, streams, notes)


def _rotation(quaternion: list[float]) -> NDArray[np.float64]:
    w, x, y, z = np.array(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _field(node: ET.Element) -> E57Field:
    name, kind = node.tag.removeprefix(NAMESPACE).rpartition("}")[2], node.get("type", "")
    if kind == "Float":
        return E57Field(name, kind, 32 if node.get("precision") == "single" else 64, -np.inf, np.inf)
    if kind in ("Integer", "ScaledInteger"):
        low, high = int(node.get("minimum", -(2**63))), int(node.get("maximum", 2**63 - 1))
        scale, offset = float(node.get("scale", 1)), float(node.get("offset", 0))
        if low > high or low < -(2**63) or high >= 2**63 or not np.isfinite([scale, offset]).all():
            raise ValueError(f"field {name} has limits {low} to {high}, scale {scale}, offset {offset}")
        return E57Field(name, kind, (high - low).bit_length(), low, high, scale, offset)
    if kind == "String":
        return E57Field(name, kind, 0, 0, 0)
    raise ValueError(f"field {name} is of type {kind!r}")


def _left_over(
    fields: tuple[E57Field, ...],
    streams: tuple[tuple[NDArray[np.int64], NDArray[np.int64]], ...],
    n_points: int,
    number: int,
) -> tuple[str, ...]:
    """Return a sentence on records behind those that the description states."""
    have = [8 * int(before[-1]) // spec.bits for spec, (_, before) in zip(fields, streams, strict=False) if spec.bits]
    more = min(have, default=0) - n_points
    if more < PADDED:  # values of few bits are filled up to whole bytes
        return ()
    return (f"scan {number} states {n_points} points, its packets hold {more} more: they are not read",)


def _streams(
    pages: E57Pages, fields: tuple[E57Field, ...], n_points: int, at: int, number: int
) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64]], ...]:
    """Find the pieces of every field's values; a packet has one piece of each."""
    section, length, data, _ = SECTION.unpack(pages.read(pages.logical(at), SECTION.size).tobytes())
    begin = pages.logical(data)
    end = min(pages.logical(at) + length, pages.size)
    if section != COMPRESSED_VECTOR:
        raise ReadError(f"{pages.path} is damaged: scan {number} has no section of points at byte {at}")
    starts, sizes = [], []  # of the pieces of each packet
    while begin + 4 <= end:
        kind, _, size, count = struct.unpack("<BBHH", pages.read(begin, 6).tobytes())
        if kind == DATA_PACKET:
            if count != len(fields):
                raise ReadError(f"{pages.path} is damaged: a packet of {count} streams for {len(fields)} fields")
            lengths = pages.read(begin + 6, 2 * count).view("<u2").astype(np.int64)
            if 6 + 2 * count + lengths.sum() > size + 1:
                raise ReadError(
                    f"{pages.path} is damaged: a packet of scan {number} holds more than its {size + 1} bytes"
                )
            starts.append(begin + 6 + 2 * count + np.cumsum(lengths) - lengths)
            sizes.append(lengths)
        begin += size + 1
    streams = []
    places, n_bytes = (np.array(part, np.int64).reshape(-1, len(fields)).T for part in (starts, sizes))
    for spec, where, pieces in zip(fields, places, n_bytes, strict=True):
        before = np.concatenate([[0], np.cumsum(pieces)])
        if spec.kind != "String" and 8 * int(before[-1]) < n_points * spec.bits:
            raise ReadError(
                f"{pages.path} is truncated or damaged: scan {number} states {n_points} points, "
                f"its field {spec.name} holds {8 * int(before[-1]) // spec.bits}"
            )
        streams.append((np.ascontiguousarray(where), before))
    return tuple(streams)


def read_field(pages: E57Pages, scan: E57Scan, name: str, start: int, stop: int) -> NDArray:
    """Return one field of the records ``start`` to ``stop``, scaled."""
    number = next(i for i, f in enumerate(scan.fields) if f.name == name)
    spec, n = scan.fields[number], stop - start
    if n <= 0:
        return np.empty(0, spec.dtype)
    if not spec.bits:
        raw = np.zeros(n, np.int64)
    else:
        first, last = start * spec.bits // 8, -(-stop * spec.bits // 8)
        _hold(pages, scan, number, first, last)
        data = _gather(pages, *scan.streams[number], first, last)
        if spec.kind == "Float":
            return data.view(f"<f{spec.bits // 8}")
        raw = _unpack_bits(data, start * spec.bits - 8 * first, spec.bits, n)
    values = raw + np.int64(spec.minimum)
    return values * spec.scale + spec.offset if spec.kind == "ScaledInteger" else values.astype(spec.dtype)


def _hold(pages: E57Pages, scan: E57Scan, number: int, first: int, last: int) -> None:
    """Read the packets with a part of a field at once: the other fields are in the same packets."""
    before = scan.streams[number][1]
    begin, end = int(np.searchsorted(before, first, "right")) - 1, int(np.searchsorted(before, last))
    pieces = [(starts[begin], starts[end - 1] + sizes[end] - sizes[end - 1]) for starts, sizes in scan.streams]
    pages.hold(int(min(low for low, _ in pieces)), int(max(high for _, high in pieces)))


def _gather(
    pages: E57Pages, starts: NDArray[np.int64], before: NDArray[np.int64], first: int, last: int
) -> NDArray[np.uint8]:
    pieces = []
    begin = int(np.searchsorted(before, first, "right")) - 1
    for i in range(begin, len(starts)):
        low, high = max(first, int(before[i])), min(last, int(before[i + 1]))
        if low >= last:
            break
        pieces.append(pages.read(int(starts[i]) + low - int(before[i]), high - low))
    return np.concatenate(pieces)


@njit(cache=True, nogil=True)
def _unpack_bits(data: NDArray[np.uint8], skip: int, bits: int, n: int) -> NDArray[np.int64]:
    """Return `n` numbers of `bits` bits, least significant bit first, after `skip` bits."""
    out = np.zeros(n, dtype=np.int64)
    for i in range(n):
        at = skip + i * bits
        value = np.uint64(0)
        done = 0
        while done < bits:
            byte, within = (at + done) >> 3, (at + done) & 7
            take = min(8 - within, bits - done)
            part = np.uint64(data[byte] >> within & ((1 << take) - 1))
            value |= part << np.uint64(done)
            done += take
        out[i] = np.int64(value)
    return out
