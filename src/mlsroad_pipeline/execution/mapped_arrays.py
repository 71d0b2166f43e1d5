"""Memory-mapped arrays of an NPZ file: pages are read on access and shared between processes."""

from __future__ import annotations

import mmap
import struct
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_LOCAL_HEADER = struct.Struct("<26xHH")
"""End of the local header of a zip entry: lengths of the name and of the extra field that follow it."""


def map_arrays(path: str | Path) -> dict[str, NDArray]:
    """Map the arrays of an NPZ file into memory.

    Raises ValueError for an entry that is compressed, holds Python objects or is no array, OSError for an unreadable
    file, and zipfile.BadZipFile for a file that is not NPZ.
    """
    with open(path, "rb") as stream, zipfile.ZipFile(stream) as archive:
        content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_COPY)
        return {entry.filename.removesuffix(".npy"): _map_entry(content, entry) for entry in archive.infolist()}


def _map_entry(content: mmap.mmap, entry: zipfile.ZipInfo) -> NDArray:
    if entry.compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"{entry.filename} is compressed")
    start = entry.header_offset + _LOCAL_HEADER.size + sum(_LOCAL_HEADER.unpack_from(content, entry.header_offset))
    content.seek(start)
    version = np.lib.format.read_magic(content)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran_order, dtype = read_header(content)
    if dtype.hasobject:
        raise ValueError(f"{entry.filename} holds Python objects")
    size = int(np.prod(shape)) * dtype.itemsize
    if content.tell() + size > start + entry.file_size:
        raise ValueError(f"{entry.filename} ends early")
    if size == 0:
        return np.empty(shape, dtype)
    return np.ndarray(shape, dtype, buffer=content, offset=content.tell(), order="F" if fortran_order else "C")
