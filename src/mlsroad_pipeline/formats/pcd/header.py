"""Header of a PCD file, up to version 0.7: its fields and the byte offset of the data."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.plain_text import shortened
from mlsroad_pipeline.formats.files import open_content

ENCODINGS = ("ascii", "binary", "binary_compressed")
KINDS = {"I": "i", "U": "u", "F": "f"}
SIZES = {"i": (1, 2, 4, 8), "u": (1, 2, 4, 8), "f": (2, 4, 8)}
PADDING = "_"
HEAD = 1 << 16
LARGEST_RECORD = 1 << 20

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class PcdField:
    """One field of a PCD file."""

    name: str  # ``_`` is padding
    dtype: np.dtype  # type of one value, little-endian
    count: int  # values per point; 0 occupies no bytes
    offset: int  # byte offset in a record

    @property
    def size(self) -> int:
        """Return the bytes of the field in a record."""
        return self.dtype.itemsize * self.count

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the shape of its values of one point."""
        return () if self.count == 1 else (self.count,)

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the names of its columns: several values are numbered, padding has none."""
        if self.name == PADDING or not self.count:
            return ()
        return (self.name,) if self.count == 1 else tuple(f"{self.name}_{i}" for i in range(self.count))


@dataclass(frozen=True)
class PcdHeader:
    """Header of a PCD file."""

    fields: tuple[PcdField, ...]
    n_points: int
    encoding: str  # ``ascii``, ``binary`` or ``binary_compressed``
    begin: int  # byte offset of the data
    n_lines: int
    entries: dict[str, str]  # all entries, unchanged

    @cached_property
    def dtype(self) -> np.dtype:
        """Return the type of a record; its names are those of the fields with columns."""
        named = [field for field in self.fields if field.columns]
        return np.dtype(
            {
                "names": [field.name for field in named],
                "formats": [(field.dtype, field.shape) for field in named],
                "offsets": [field.offset for field in named],
                "itemsize": sum(field.size for field in self.fields),
            }
        )


def read_pcd_header(path: Path) -> PcdHeader:
    """Read the header of a PCD file; `ReadError` if it is another file, ends early or contradicts itself."""
    data = open_content(path).read(HEAD)
    entries: dict[str, str] = {}
    at = n_lines = 0
    while "DATA" not in entries:
        end = data.find(b"\n", at) + 1
        if not end:
            raise ReadError(f"{path} is truncated or no PCD file: its header has no line DATA")
        line = data[at:end].decode("utf-8", "replace").strip()
        at, n_lines = end, n_lines + 1
        if line and not line.startswith("#"):
            key, *value = line.split(maxsplit=1)
            if key.upper() in entries:
                shown = shortened(line)
                raise ReadError(f"{path}, line {n_lines}: a second {key.upper()}: {shown!r}; remove one of them")
            entries[key.upper()] = value[0] if value else ""
    encoding = entries["DATA"].lower()
    if encoding not in ENCODINGS:
        raise ReadError(f"{path}, line {n_lines}: DATA {entries['DATA']!r}; {', '.join(ENCODINGS)} can be read")
    return PcdHeader(_fields(entries, path), _n_points(entries, path), encoding, at, n_lines, entries)


def _numbers(entries: dict[str, str], key: str, path: Path, *, length: int) -> list[int]:
    words = entries.get(key, "").split()
    if len(words) != length or not all(word.isascii() and word.isdigit() for word in words):
        raise ReadError(f"{path}: {key} {entries.get(key)!r} in its header is not {length} whole numbers")
    return [int(word) for word in words]


def _fields(entries: dict[str, str], path: Path) -> tuple[PcdField, ...]:
    names = (entries.get("FIELDS") or entries.get("COLUMNS") or "").split()
    if not names:
        raise ReadError(f"{path}: its header has no FIELDS")
    sizes = _numbers(entries, "SIZE", path, length=len(names))
    counts = _numbers(entries, "COUNT", path, length=len(names)) if "COUNT" in entries else [1] * len(names)
    types = entries.get("TYPE", "").upper().split()
    if len(types) != len(names):
        raise ReadError(f"{path}: TYPE {entries.get('TYPE')!r} for the {len(names)} FIELDS {' '.join(names)}")
    fields, offset = [], 0
    for name, kind, size, count in zip(names, types, sizes, counts, strict=True):
        letter = KINDS.get(kind, "")
        if size not in SIZES.get(letter, ()):
            raise ReadError(f"{path}: field {name!r} is of TYPE {kind} and SIZE {size}, which is not supported")
        fields.append(PcdField(name, np.dtype(f"<{letter}{size}"), count, offset))
        offset += size * count
        if offset > LARGEST_RECORD:
            raise ReadError(
                f"{path}: field {name!r} has COUNT {count}, which makes records of over {LARGEST_RECORD} bytes"
            )
    own = [field.name for field in fields if field.columns]
    columns = [column for field in fields for column in field.columns]
    twice = next((name for group in (own, columns) for name in group if group.count(name) > 1), None)
    if twice is not None:
        raise ReadError(f"{path}: field {twice!r} is duplicated in its header")
    return _where_written(tuple(fields), path)


def _where_written(fields: tuple[PcdField, ...], path: Path) -> tuple[PcdField, ...]:
    """Return the fields at the offsets where the library's writer puts them.

    It writes aligned structures, but states the padding before a field as if the field before had that field's size.
    Where the stated offsets are not aligned and those that follow from this are, the latter are used.
    """
    if all(field.name != PADDING for field in fields):
        return fields
    moved: list[PcdField] = []
    end, previous, padding = 0, None, None
    for field in fields:
        if field.name == PADDING:
            padding = field.size
            moved.append(field)
            continue
        begin = end if previous is None or padding is None else previous.offset + previous.count * field.dtype.itemsize
        previous, padding = replace(field, offset=begin + (padding or 0)), None
        if previous.offset < end:
            return fields
        end = previous.offset + previous.size
        moved.append(previous)
    size = sum(field.size for field in fields)
    if end > size or _aligned(fields) or not _aligned(moved):
        return fields
    names = ", ".join(new.name for old, new in zip(fields, moved, strict=True) if old.offset != new.offset)
    logger.info("%s: its header states wrong offsets of %s; aligned offsets are used", path, names)
    return tuple(moved)


def _aligned(fields: Sequence[PcdField]) -> bool:
    return all(field.offset % field.dtype.itemsize == 0 for field in fields if field.name != PADDING)


def _n_points(entries: dict[str, str], path: Path) -> int:
    has_shape = "WIDTH" in entries and "HEIGHT" in entries
    shape = [_numbers(entries, key, path, length=1)[0] for key in ("WIDTH", "HEIGHT")] if has_shape else []
    if "POINTS" not in entries and not has_shape:
        raise ReadError(f"{path}: its header has neither POINTS nor WIDTH and HEIGHT")
    n_points = _numbers(entries, "POINTS", path, length=1)[0] if "POINTS" in entries else shape[0] * shape[1]
    if has_shape and n_points != shape[0] * shape[1]:
        raise ReadError(f"{path}: POINTS {n_points} in its header, but WIDTH x HEIGHT is {shape[0]} x {shape[1]}")
    return n_points
