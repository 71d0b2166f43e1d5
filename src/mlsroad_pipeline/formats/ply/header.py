"""Header of a PLY file: its elements and the byte offset of the data."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.files import open_content

TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float32": "f4", "float64": "f8"},
}
NAMES = {kind: name for name, kind in reversed(TYPES.items()) if not name[-1].isdigit()}  # names that are written
ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
HEAD = 1 << 20


@dataclass(frozen=True)
class PlyElement:
    """One element of a PLY file."""

    name: str  # the points are ``vertex``
    count: int
    properties: dict[str, str | None] = field(default_factory=dict)  # name to type, such as ``f4``; None for a list
    lists: dict[str, tuple[str, ...]] = field(default_factory=dict)  # types of the number of items and of an item

    @property
    def has_lists(self) -> bool:
        """Return whether records differ in length."""
        return None in self.properties.values()

    def dtype(self, order: str) -> np.dtype:
        """Return the type of a record without lists."""
        return np.dtype([(name, order + kind) for name, kind in self.properties.items() if kind is not None])


@dataclass(frozen=True)
class PlyHeader:
    """Header of a PLY file."""

    encoding: str  # ``ascii``, ``binary_little_endian`` or ``binary_big_endian``
    elements: tuple[PlyElement, ...]  # the elements in the order of the file
    text: bytes  # text of the header, up to the start of the data
    comments: tuple[str, ...]  # the comments, without the keyword

    @property
    def order(self) -> str:
        """Return the byte order as numpy writes it."""
        return ORDERS[self.encoding]

    @property
    def begin(self) -> int:
        """Return the byte offset of the data."""
        return len(self.text)

    @property
    def vertex(self) -> PlyElement:
        """Return the element that holds the points."""
        return next(element for element in self.elements if element.name == "vertex")

    @property
    def vertex_first(self) -> bool:
        """Return whether the points come first and are all of one length, so that ranges have known byte offsets."""
        return self.elements[0] is self.vertex and not self.vertex.has_lists

    @property
    def crs(self) -> str | None:
        """Return the CRS of the ``comment crs`` line that this project writes, if any."""
        return next((unquote(text[4:]) for text in self.comments if text.startswith("crs ")), None)


def ply_head(count: int, properties: Sequence[tuple[str, str]], comments: Sequence[str]) -> bytes:
    """Return the header of binary vertices; properties have names and types of numpy, such as ``f4``."""
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    lines += [f"element vertex {count}", *(f"property {NAMES[kind]} {name}" for name, kind in properties)]
    return "\n".join([*lines, "end_header", ""]).encode()


def read_ply_header(path: Path) -> PlyHeader:
    """Read the header of a PLY file; `ReadError` if it is another file, ends early, or names no vertices."""
    data = open_content(path).read(HEAD)
    if data[:3] != b"ply":
        raise ReadError(f"{path} is not a PLY file: it begins with {data[:4]!r}")
    line_end = b"\r\n" if data[3:5] == b"\r\n" else data[3:4]
    lines: list[bytes] = []
    at = 0
    while not lines or lines[-1].strip() != b"end_header":
        end = data.find(line_end, at)
        if end < 0:
            ended = data[at:].strip() == b"end_header"
            what = "nothing follows its PLY header" if ended else "its PLY header has no end_header"
            raise ReadError(f"{path} is truncated: {what}")
        lines.append(data[at:end])
        at = end + len(line_end)
    return _parsed(data[:at], [line.decode("utf-8", "replace") for line in lines], path)


def _parsed(text: bytes, lines: Sequence[str], path: Path) -> PlyHeader:
    formats: list[str] = []
    elements: list[PlyElement] = []
    comments: list[str] = []
    for number, line in enumerate(lines, start=1):
        repeated = ""
        try:
            match line.split():
                case ["ply"] if number == 1:
                    pass
                case ["format", kind, *_]:
                    repeated = "a second format" if formats else ""
                    formats.append(kind)
                case ["comment", *_]:
                    comments.append(line.strip()[8:])
                case ["obj_info", *_] | ["end_header"] | []:
                    pass
                case ["element", name, count] if count.isascii() and count.isdigit():
                    repeated = f"element {name!r} is repeated" if any(e.name == name for e in elements) else ""
                    elements.append(PlyElement(name, int(count)))
                case ["property", *kinds, name] if len(kinds) in (1, 3) and (kinds[0] == "list") == (len(kinds) == 3):
                    repeated = f"property {name!r} is repeated" if name in elements[-1].properties else ""
                    first, *item = (TYPES[kind] for kind in kinds[-2:])
                    elements[-1].properties[name] = None if item else first
                    elements[-1].lists.update({name: (first, *item)} if item else {})
                case _:
                    raise ValueError(line)
        except (KeyError, ValueError, IndexError):
            raise ReadError(f"{path}, line {number}: not understood: {line!r}; correct the header") from None
        if repeated:
            raise ReadError(f"{path}, line {number}: {repeated}: {line!r}; rename or remove it")
    encoding = formats[0] if formats else ""
    if encoding not in ORDERS:
        raise ReadError(f"{path} has PLY format {encoding!r}; {', '.join(ORDERS)} can be read")
    if not any(element.name == "vertex" for element in elements):
        raise ReadError(f"{path} has no element 'vertex' (elements: {', '.join(e.name for e in elements) or 'none'})")
    return PlyHeader(encoding, tuple(elements), text, tuple(comments))
