"""Extra dimensions of LAS points and their descriptors (ASPRS LAS specification 1.4 R15, table 24)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

DESCRIPTOR_SIZE = 192
DESCRIPTOR_TYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")


@dataclass(frozen=True)
class ExtraDimension:
    """One extra dimension of the points, from its 192-byte descriptor.

    Parameters
    ----------
    name : str
        Its name.
    dtype : dtype
        Type of one stored value, little-endian.
    width : int, default 1
        Values per point.
    scale, offset : ndarray of shape (width,), float64, optional
        A value is its stored number times `scale`, plus `offset`; None where the descriptor has none.
    descriptor : bytes, default empty
        The 192 bytes; empty where `pack_descriptors` creates them.
    """

    name: str
    dtype: np.dtype
    width: int = 1
    scale: NDArray[np.float64] | None = None
    offset: NDArray[np.float64] | None = None
    descriptor: bytes = field(default=b"", repr=False)

    @property
    def field_type(self) -> tuple[str, np.dtype] | tuple[str, np.dtype, tuple[int]]:
        """Return the entry of a structured dtype."""
        return (self.name, self.dtype) if self.width == 1 else (self.name, self.dtype, (self.width,))

    @classmethod
    def parse(cls, descriptor: bytes) -> ExtraDimension:
        """Read a descriptor (specification, table 24).

        Parameters
        ----------
        descriptor : bytes
            Its 192 bytes.

        Returns
        -------
        ExtraDimension
            The dimension.
        """
        code, options = descriptor[2], descriptor[3]
        name = descriptor[4:36].split(b"\0")[0].decode("utf-8", "replace")
        if code == 0:
            return cls(name, np.dtype("u1"), max(options, 1), descriptor=descriptor)
        width = 1 + (code - 1) // 10
        scale = np.frombuffer(descriptor, "<f8", 3, 112)[:width].copy() if options & 0x08 else None
        offset = np.frombuffer(descriptor, "<f8", 3, 136)[:width].copy() if options & 0x10 else None
        return cls(name, np.dtype("<" + DESCRIPTOR_TYPES[(code - 1) % 10]), width, scale, offset, descriptor)

    @classmethod
    def create(cls, name: str, dtype: np.dtype, width: int = 1, description: str = "") -> ExtraDimension:
        """Create an unscaled dimension; undocumented bytes where the width is above three.

        Parameters
        ----------
        name : str
            Its name, up to 32 bytes.
        dtype : dtype
            Type of one value.
        width : int, default 1
            Values per point.
        description : str
            Up to 32 bytes.

        Returns
        -------
        ExtraDimension
            The dimension.
        """
        dtype = np.dtype(dtype).newbyteorder("<")
        if width > 3:
            code, options = 0, width
        else:
            code, options = 1 + DESCRIPTOR_TYPES.index(dtype.str[1:]) + 10 * (width - 1), 0
        text = name.encode()[:32], description.encode()[:32]
        packed = struct.pack("<HBB32s4x120s32s", 0, code, options, text[0], b"", text[1])
        return cls(name, dtype, width, descriptor=packed)

    def renamed(self, name: str) -> ExtraDimension:
        """Return the same dimension under another name.

        Parameters
        ----------
        name : str
            Its new name, up to 32 bytes.

        Returns
        -------
        ExtraDimension
            The dimension.
        """
        descriptor = self.descriptor[:4] + struct.pack("32s", name.encode()[:32]) + self.descriptor[36:]
        return replace(self, name=name, descriptor=descriptor)


def pack_descriptors(dimensions: Sequence[ExtraDimension]) -> bytes:
    """Return the data of the record that describes extra dimensions.

    Parameters
    ----------
    dimensions : sequence of ExtraDimension
        The dimensions in the order of their bytes; one that had no descriptor gets one.

    Returns
    -------
    bytes
        Their descriptors.
    """
    return b"".join(d.descriptor or ExtraDimension.create(d.name, d.dtype, d.width).descriptor for d in dimensions)
