"""Extra dimensions of LAS points and their descriptors (ASPRS LAS specification 1.4 R15, table 24)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

DESCRIPTOR_SIZE = 192
NAME_BYTES = 32
LAST_TYPE = 30
"""Last type of a descriptor that is defined."""

LARGEST_WIDTH, SCALE_BITS = 255, 0x18
"""Largest number of undocumented bytes of a descriptor, and bits of it that laspy takes for a scale and an offset."""

_NUMBERS = ("label", "instance")
"""Lower-case names of dimensions that are read as whole numbers, missing ones too."""

DESCRIPTOR_TYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")


@dataclass(frozen=True)
class ExtraDimension:
    """One extra dimension of the points, from its 192-byte descriptor."""

    name: str
    dtype: np.dtype  # type of one stored value, little-endian
    width: int = 1  # values per point
    scale: NDArray[np.float64] | None = None  # a value is its stored number times this plus `offset`
    offset: NDArray[np.float64] | None = None
    descriptor: bytes = field(default=b"", repr=False)  # the 192 bytes; empty where `pack_descriptors` creates them
    no_data: NDArray | None = None  # stored number that stands for a missing value; None where the descriptor has none

    @property
    def field_type(self) -> tuple[str, np.dtype] | tuple[str, np.dtype, tuple[int]]:
        """Return the entry of a structured dtype."""
        return (self.name, self.dtype) if self.width == 1 else (self.name, self.dtype, (self.width,))

    @classmethod
    def parse(cls, descriptor: bytes) -> ExtraDimension:
        """Read a descriptor (specification, table 24)."""
        code, options = descriptor[2], descriptor[3]
        name = _text(descriptor[4:36])
        if code == 0:
            return cls(name, np.dtype("u1"), max(options, 1), descriptor=descriptor)
        width = 1 + (code - 1) // 10
        scale = _finite(descriptor, 112, width) if options & 0x08 else None
        offset = _finite(descriptor, 136, width) if options & 0x10 else None
        scale = None if scale is None or not scale.all() else scale  # writers set the bit and leave the value zero
        dtype = np.dtype("<" + DESCRIPTOR_TYPES[(code - 1) % 10])
        stored = np.frombuffer(descriptor, f"<{dtype.kind}8", 3, 40)[:width] if options & 0x01 else None
        with np.errstate(all="ignore"):  # a value outside of the type equals none
            no_data = None if stored is None else stored.astype(dtype)
        return cls(name, dtype, width, scale, offset, descriptor, no_data)

    @classmethod
    def create(cls, name: str, dtype: np.dtype, width: int = 1, description: str = "") -> ExtraDimension:
        """Create an unscaled dimension; name and description of up to 32 bytes, untyped bytes above three values."""
        dtype = np.dtype(dtype).newbyteorder("<")
        if width > 3:
            code, options = 0, width
        else:
            code, options = 1 + DESCRIPTOR_TYPES.index(dtype.str[1:]) + 10 * (width - 1), 0
        packed = struct.pack("<HBB32s4x120s32s", 0, code, options, _bytes(name), b"", _bytes(description))
        return cls(name, dtype, width, descriptor=packed)

    def without_missing(self, values: NDArray) -> NDArray:
        """Return stored numbers in their unit, NaN where they are missing.

        They are float64 where the dimension is scaled or is an integer with a number for missing values.
        """
        scaled = values
        if self.scale is not None or self.offset is not None:
            scaled = values * (1.0 if self.scale is None else self.scale)
            scaled = scaled if self.offset is None else scaled + self.offset
        whole = scaled.dtype.kind in "iu"
        if self.no_data is None or (whole and (scaled.dtype.itemsize == 8 or self.name.lower() in _NUMBERS)):
            return scaled  # float64 would lose digits of long numbers
        scaled = scaled.astype(np.float64) if scaled.dtype.kind in "iu" else scaled
        missing: NDArray = np.where(values == self.no_data, scaled.dtype.type(np.nan), scaled)
        return missing

    def stored(self, values: NDArray) -> NDArray:
        """Return the numbers to store for values in their unit (NaN: missing); integers are rounded."""
        numbers = values
        if self.scale is not None or self.offset is not None:
            offset, scale = (0.0 if self.offset is None else self.offset), (1.0 if self.scale is None else self.scale)
            numbers = (values - offset) / scale
            numbers = numbers if self.dtype.kind == "f" else np.rint(numbers)
        if self.no_data is not None and numbers.dtype.kind == "f":
            numbers = np.where(np.isnan(numbers), self.no_data.astype(numbers.dtype), numbers)
        return numbers

    def renamed(self, name: str) -> ExtraDimension:
        """Return the same dimension under another name."""
        descriptor = self.descriptor[:4] + struct.pack("32s", _bytes(name)) + self.descriptor[36:]
        return replace(self, name=name, descriptor=descriptor)


def undocumented(n_bytes: int, base: str = "extra_bytes") -> list[ExtraDimension]:
    """Return dimensions ``extra_bytes``, ``extra_bytes_2``, ... for bytes without a type."""
    dimensions: list[ExtraDimension] = []
    while n_bytes:
        width = next(w for w in range(min(n_bytes, LARGEST_WIDTH), 0, -1) if not w & SCALE_BITS)
        name = f"{cut_text(base, NAME_BYTES - 4)}_{len(dimensions) + 1}" if dimensions else base
        dimensions.append(ExtraDimension(name, np.dtype("u1"), width))
        n_bytes -= width
    return dimensions


def _finite(descriptor: bytes, at: int, width: int) -> NDArray[np.float64] | None:
    values = np.frombuffer(descriptor, "<f8", 3, at)[:width].copy()
    return values if np.isfinite(values).all() else None


def pack_descriptors(dimensions: Sequence[ExtraDimension]) -> bytes:
    """Return the data of the record that describes extra dimensions; one without a descriptor gets one."""
    return b"".join(_valid(d) for d in dimensions)


def _valid(dimension: ExtraDimension) -> bytes:
    """Return a descriptor that other readers accept: text in UTF-8, a size, and no scale or offset that is none."""
    if not dimension.descriptor:
        return ExtraDimension.create(dimension.name, dimension.dtype, dimension.width).descriptor
    packed = bytearray(dimension.descriptor)
    for start in (4, 160):
        packed[start : start + 32] = struct.pack("32s", _bytes(_text(bytes(packed[start : start + 32]))))
    if packed[2] == 0:
        packed[3] = dimension.width
        return bytes(packed)
    for bit, start, values in ((0x08, 112, dimension.scale), (0x10, 136, dimension.offset)):
        if packed[3] & bit and values is None:
            packed[3] &= ~bit
            packed[start : start + 24] = bytes(24)
    return bytes(packed)


def _text(data: bytes) -> str:
    """Return text up to the first zero byte: UTF-8, or Latin-1 where it is none."""
    data = data.split(b"\0")[0]
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _bytes(text: str) -> bytes:
    return cut_text(text, NAME_BYTES).encode()


def cut_text(text: str, n_bytes: int) -> str:
    """Return the start of a text that has at most `n_bytes` in UTF-8, whole characters."""
    return text.encode()[:n_bytes].decode("utf-8", "ignore")
