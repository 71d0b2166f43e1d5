"""Extra dimensions of LAS points and their descriptors (ASPRS LAS specification 1.4 R15, table 24)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

NAME_BYTES = 32
DESCRIPTOR = np.dtype(
    [
        *(("reserved", "<u2"), ("type", "u1"), ("options", "u1"), ("name", f"S{NAME_BYTES}"), ("unused", "V4")),
        *(("no_data", "V24"), ("minimum", "V24"), ("maximum", "V24"), ("scale", "<f8", 3), ("offset", "<f8", 3)),
        ("description", f"S{NAME_BYTES}"),
    ]
)
NO_DATA, SCALE, OFFSET = 0x01, 0x08, 0x10  # bits of the options: the values of these fields are set
LAST_TYPE = 30  # last type of a descriptor that is defined
LARGEST_WIDTH = 255  # largest number of undocumented bytes of a descriptor
_NUMBERS = ("label", "instance")  # lower-case names of dimensions that are read as whole numbers, missing ones too
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
        record = np.frombuffer(descriptor, DESCRIPTOR)[0]
        code, options, name = int(record["type"]), int(record["options"]), _text(record["name"])
        if code == 0:
            return cls(name, np.dtype("u1"), max(options, 1), descriptor=descriptor)
        width = 1 + (code - 1) // 10
        scale = _finite(record["scale"][:width]) if options & SCALE else None
        offset = _finite(record["offset"][:width]) if options & OFFSET else None
        scale = None if scale is None or not scale.all() else scale  # writers set the bit and leave the value zero
        dtype = np.dtype("<" + DESCRIPTOR_TYPES[(code - 1) % 10])
        stored = np.frombuffer(record["no_data"].tobytes(), f"<{dtype.kind}8")[:width] if options & NO_DATA else None
        with np.errstate(all="ignore"):  # a value outside of the type equals none
            no_data = None if stored is None else stored.astype(dtype)
        return cls(name, dtype, width, scale, offset, descriptor, no_data)

    @classmethod
    def create(cls, name: str, dtype: np.dtype, width: int = 1, description: str = "") -> ExtraDimension:
        """Create an unscaled dimension; name and description of up to 32 bytes, untyped bytes above three values."""
        dtype = np.dtype(dtype).newbyteorder("<")
        record = np.zeros(1, DESCRIPTOR)
        if width > 3:
            record["options"] = width
        else:
            record["type"] = 1 + DESCRIPTOR_TYPES.index(dtype.str[1:]) + 10 * (width - 1)
        record["name"], record["description"] = _bytes(name), _bytes(description)
        return cls(name, dtype, width, descriptor=record.tobytes())

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
        record = np.frombuffer(bytearray(self.descriptor), DESCRIPTOR)
        record["name"] = _bytes(name)
        return replace(self, name=name, descriptor=record.tobytes())


def parse_descriptors(records: Iterable[bytes], size: int) -> tuple[ExtraDimension, ...]:
    """Return the dimensions that records describe, for ``size`` extra bytes of a point.

    A descriptor of an undefined type, or of more bytes than are left, ends them; the other bytes are undocumented.
    """
    dimensions: list[ExtraDimension] = []
    step = DESCRIPTOR.itemsize
    for descriptor in (data[at : at + step] for data in records for at in range(0, len(data) - step + 1, step)):
        if not size or descriptor[2] > LAST_TYPE:
            break
        dimension = ExtraDimension.parse(descriptor)
        n_bytes = dimension.dtype.itemsize * dimension.width
        if n_bytes > size:
            break
        untyped = descriptor[2] == 0 and n_bytes & (SCALE | OFFSET)  # laspy would take the size for a scale
        dimensions += undocumented(n_bytes, dimension.name) if untyped else [dimension]
        size -= n_bytes
    return (*dimensions, *undocumented(size))


def undocumented(n_bytes: int, base: str = "extra_bytes") -> list[ExtraDimension]:
    """Return dimensions ``extra_bytes``, ``extra_bytes_2``, ... for bytes without a type."""
    dimensions: list[ExtraDimension] = []
    while n_bytes:
        width = next(w for w in range(min(n_bytes, LARGEST_WIDTH), 0, -1) if not w & (SCALE | OFFSET))
        name = f"{cut_text(base, NAME_BYTES - 4)}_{len(dimensions) + 1}" if dimensions else base
        dimensions.append(ExtraDimension(name, np.dtype("u1"), width))
        n_bytes -= width
    return dimensions


def _finite(values: NDArray[np.float64]) -> NDArray[np.float64] | None:
    return np.array(values) if np.isfinite(values).all() else None


def pack_descriptors(dimensions: Sequence[ExtraDimension]) -> bytes:
    """Return the data of the record that describes extra dimensions; one without a descriptor gets one."""
    return b"".join(_valid(d) for d in dimensions)


def _valid(dimension: ExtraDimension) -> bytes:
    """Return a descriptor that other readers accept: text in UTF-8, a size, and no scale or offset that is none."""
    if not dimension.descriptor:
        return ExtraDimension.create(dimension.name, dimension.dtype, dimension.width).descriptor
    record = np.frombuffer(bytearray(dimension.descriptor), DESCRIPTOR)
    for name in ("name", "description"):
        record[name] = _bytes(_text(record[name][0]))
    if record["type"][0] == 0:
        record["options"] = dimension.width
    else:
        for bit, name, values in ((SCALE, "scale", dimension.scale), (OFFSET, "offset", dimension.offset)):
            if record["options"][0] & bit and values is None:
                record["options"] &= ~bit & 0xFF
                record[name] = 0
    return record.tobytes()


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
