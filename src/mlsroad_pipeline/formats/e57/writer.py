"""Writer of E57: one scan in one section of packets, its description in XML."""

import struct
import uuid
from collections.abc import Mapping
from typing import BinaryIO
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.formats.e57.pages import CONTENT, HEADER, PAGE, SIGNATURE, pack_pages
from mlsroad_pipeline.formats.e57.scans import COMPRESSED_VECTOR, DATA_PACKET, NAMESPACE, SECTION

# Fields of the standard; others get the prefix of an extension.
STANDARD = (
    *("cartesianX", "cartesianY", "cartesianZ", "intensity", "colorRed", "colorGreen", "colorBlue", "timeStamp"),
    *("rowIndex", "columnIndex", "returnIndex", "returnCount"),
)
PREFIX, EXTENSION = "mls", "https://mlsroad/columns"
LARGEST_PACKET = 1 << 16
TYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "i8", "f4", "f8")


def write_e57(stream: BinaryIO, columns: Mapping[str, NDArray], *, crs: str | None, source: str) -> None:
    """Write columns, ``cartesianX`` to ``cartesianZ`` among them, as the only scan of an E57 file."""
    fields = {name: _stored(name, values, source) for name, values in columns.items()}
    n_points = len(next(iter(fields.values())))
    section = _section(list(fields.values()), n_points)
    xml = _xml(fields, n_points, _physical(HEADER.size), crs)
    content_size = HEADER.size + len(section) + len(xml)
    n_pages = -(-content_size // CONTENT)
    head = HEADER.pack(SIGNATURE, 1, 0, n_pages * PAGE, _physical(HEADER.size + len(section)), len(xml), PAGE)
    stream.write(pack_pages(head + section + xml).data)


def _physical(logical: int) -> int:
    return logical // CONTENT * PAGE + logical % CONTENT


def _stored(name: str, values: NDArray, source: str) -> NDArray:
    values = values.view(np.uint8) if values.dtype == np.bool_ else values
    if values.dtype.str[1:] not in TYPES or not name.isidentifier() or not name.isascii():
        raise DataError(f"{source}: column {name!r} ({values.dtype}) cannot be stored in E57")
    return np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))


def _section(fields: list[NDArray], n_points: int) -> bytes:
    """Return the section of points: packets of as many records as fit into 64 KiB."""
    record = sum(values.dtype.itemsize for values in fields)
    per_packet = max((LARGEST_PACKET - 8 - 2 * len(fields)) // record, 1)
    packets = []
    for start in range(0, n_points, per_packet):
        pieces = [_raw(values[start : start + per_packet]).tobytes() for values in fields]
        lengths = b"".join(struct.pack("<H", len(piece)) for piece in pieces)
        body = lengths + b"".join(pieces)
        size = -(-(6 + len(body)) // 4) * 4
        packets.append(struct.pack("<BBHH", DATA_PACKET, 0, size - 1, len(fields)) + body.ljust(size - 6, b"\0"))
    data = b"".join(packets)
    begin = _physical(HEADER.size + SECTION.size)
    section = SECTION.pack(COMPRESSED_VECTOR, SECTION.size + len(data), begin if n_points else 0, 0) + data
    return section.ljust(-(-len(section) // 4) * 4, b"\0")


def _raw(values: NDArray) -> NDArray:
    """Return integers minus the minimum of their type, as E57 stores them."""
    if values.dtype.kind != "i":
        return values
    unsigned = values.view(values.dtype.str.replace("i", "u"))
    lowest = unsigned.dtype.type(1 << (8 * values.dtype.itemsize - 1))
    return np.asarray(unsigned ^ lowest)


def _xml(fields: Mapping[str, NDArray], n_points: int, section_at: int, crs: str | None) -> bytes:
    prototype = "".join(_element(name, values) for name, values in fields.items())
    # Derived from the content, not random: same points, same bytes.
    guids = [f"{{{uuid.uuid5(uuid.NAMESPACE_URL, f'{EXTENSION}/{part}/{n_points}')}}}" for part in ("file", "scan")]
    text = f"""<?xml version="1.0" encoding="UTF-8"?>
<e57Root type="Structure" xmlns={quoteattr(NAMESPACE[1:-1])} xmlns:{PREFIX}={quoteattr(EXTENSION)}>
<formatName type="String">ASTM E57 3D Imaging Data File</formatName>
<guid type="String">{guids[0]}</guid>
<versionMajor type="Integer">1</versionMajor>
<versionMinor type="Integer">0</versionMinor>
<coordinateMetadata type="String">{escape(crs or "")}</coordinateMetadata>
<data3D type="Vector" allowHeterogeneousChildren="1">
<vectorChild type="Structure">
<guid type="String">{guids[1]}</guid>
<name type="String">points</name>
{_limits(fields)}<points type="CompressedVector" fileOffset="{section_at}" recordCount="{n_points}">
<prototype type="Structure">{prototype}</prototype>
<codecs type="Vector" allowHeterogeneousChildren="1"/>
</points>
</vectorChild>
</data3D>
<images2D type="Vector" allowHeterogeneousChildren="1"/>
</e57Root>
"""
    return text.encode()


def _element(name: str, values: NDArray) -> str:
    tag = name if name in STANDARD else f"{PREFIX}:{name}"
    if values.dtype.kind == "f":
        precision = "single" if values.dtype.itemsize == 4 else "double"
        return f'<{tag} type="Float" precision="{precision}"/>'
    limits = np.iinfo(values.dtype)
    return f'<{tag} type="Integer" minimum="{limits.min}" maximum="{limits.max}"/>'


def _limits(fields: Mapping[str, NDArray]) -> str:
    """Return the XML of the nominal limits of intensity and colours."""
    text = ""
    if "intensity" in fields:
        text += (
            '<intensityLimits type="Structure"><intensityMinimum type="Float">0</intensityMinimum>'
            '<intensityMaximum type="Float">1</intensityMaximum></intensityLimits>\n'
        )
    if "colorRed" in fields:
        children = "".join(
            f'<color{c}Minimum type="Integer">0</color{c}Minimum><color{c}Maximum type="Integer">255</color{c}Maximum>'
            for c in ("Red", "Green", "Blue")
        )
        text += f'<colorLimits type="Structure">{children}</colorLimits>\n'
    return text
