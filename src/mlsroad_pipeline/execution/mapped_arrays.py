"""Memory-mapped arrays of an NPZ file: pages are read on access and shared between processes."""

from __future__ import annotations

import functools
import mmap
import os
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_LOCAL_HEADER = struct.Struct("<26xHH")
"""End of the local header of a zip entry: lengths of the name and of the extra field that follow it."""

_BLOCK = 1 << 24


def map_arrays(path: str | Path) -> dict[str, NDArray]:
    """Map the arrays of an NPZ file into memory.

    The first mapping of a file in a process reads it once and compares its checksums.
    """
    with open(path, "rb") as stream, zipfile.ZipFile(stream) as archive:
        state = os.fstat(stream.fileno())
        _check_sums(os.path.abspath(path), state.st_size, state.st_mtime_ns)
        content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_COPY)
        return {entry.filename.removesuffix(".npy"): _map_entry(content, entry) for entry in archive.infolist()}


@functools.lru_cache(maxsize=256)
def _check_sums(path: str, size: int, modified: int) -> None:
    del size, modified
    with (
        open(path, "rb") as stream,
        zipfile.ZipFile(stream) as archive,
        mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content,
        memoryview(content) as data,
    ):
        for entry in archive.infolist():
            begin = _data_offset(content, entry)
            end, found = begin + entry.compress_size, 0
            for at in range(begin, end, _BLOCK):
                found = zlib.crc32(data[at : min(at + _BLOCK, end)], found)
            if entry.compress_type == zipfile.ZIP_STORED and found != entry.CRC:
                raise ValueError(f"{entry.filename} differs from its checksum")


def _data_offset(content: mmap.mmap, entry: zipfile.ZipInfo) -> int:
    lengths = _LOCAL_HEADER.unpack_from(content, entry.header_offset)
    return int(entry.header_offset + _LOCAL_HEADER.size + sum(lengths))


def _map_entry(content: mmap.mmap, entry: zipfile.ZipInfo) -> NDArray:
    if entry.compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"{entry.filename} is compressed")
    start = _data_offset(content, entry)
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
