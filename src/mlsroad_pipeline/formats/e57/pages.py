"""The pages of an E57 file (ASTM E2807): 1,020 bytes of content and a checksum of four (CRC-32C) each."""

import struct
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.files import open_content

PAGE = 1024
CONTENT = PAGE - 4
SIGNATURE = b"ASTM-E57"
HEADER = struct.Struct("<8sIIQQQQ")
LARGEST_BLOCK = 1 << 26  # largest part of the content in bytes that is held for further reads
POLYNOMIAL = 0x82F63B78


def _table() -> NDArray[np.uint32]:
    table = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        table = np.where(table & 1, table >> np.uint32(1) ^ np.uint32(POLYNOMIAL), table >> np.uint32(1))
    tables = [table]
    for _ in range(7):
        last = tables[-1]
        tables.append(table[last & 255] ^ last >> np.uint32(8))
    return np.stack(tables)


_CRC = _table()


@njit(cache=True, nogil=True)
def page_checksums(pages: NDArray[np.uint8], tables: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return the checksum of each page's content, eight bytes at a time."""
    out = np.empty(len(pages), dtype=np.uint32)
    n_bytes = pages.shape[1] - 4
    for page in range(len(pages)):
        crc = np.uint32(0xFFFFFFFF)
        row = pages[page]
        at = 0
        while at + 8 <= n_bytes:
            crc = (
                tables[7, (crc & 255) ^ row[at]]
                ^ tables[6, (crc >> 8 & 255) ^ row[at + 1]]
                ^ tables[5, (crc >> 16 & 255) ^ row[at + 2]]
                ^ tables[4, (crc >> 24) ^ row[at + 3]]
                ^ tables[3, row[at + 4]]
                ^ tables[2, row[at + 5]]
                ^ tables[1, row[at + 6]]
                ^ tables[0, row[at + 7]]
            )
            at += 8
        while at < n_bytes:
            crc = tables[0, (crc & 255) ^ row[at]] ^ crc >> 8
            at += 1
        out[page] = crc ^ np.uint32(0xFFFFFFFF)
    return out


class E57Pages:
    """The content of an E57 file, checked page by page as it is read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        file = open_content(path)
        size, head = file.size, file.read(HEADER.size)
        if len(head) < HEADER.size or not head.startswith(SIGNATURE):
            raise ReadError(f"{path} is not an E57 file: it begins with {head[:8]!r}, not {SIGNATURE!r}")
        _, major, minor, length, xml_at, self.xml_size, page = HEADER.unpack(head)
        if major != 1 or page != PAGE:
            raise ReadError(
                f"{path} is E57 {major}.{minor} with pages of {page} bytes; version 1 with {PAGE} can be read"
            )
        if length > size or size < PAGE:
            raise ReadError(f"{path} is truncated: its header states {length} bytes, it has {size}")
        n_pages = size // PAGE
        self._pages = file.records(np.dtype("u1"), 0, n_pages * PAGE).reshape(n_pages, PAGE)
        self.size = n_pages * CONTENT
        self.xml_start = self.logical(xml_at)
        self._block: tuple[int, NDArray[np.uint8]] = (0, np.empty(0, np.uint8))

    def logical(self, physical: int) -> int:
        """Return the offset in the content of a byte of the file."""
        return physical // PAGE * CONTENT + min(physical % PAGE, CONTENT)

    def hold(self, start: int, stop: int) -> None:
        """Read a part of the content at once, up to `LARGEST_BLOCK`, from which `read` then takes its parts."""
        begin, held = self._block
        inside = begin <= start and stop <= begin + len(held)
        if not inside and 0 <= start < stop <= self.size and stop - start <= LARGEST_BLOCK:
            self._block = (start, self._read(start, stop - start))

    def read(self, start: int, n_bytes: int) -> NDArray[np.uint8]:
        """Return a part of the content; `ReadError` if it leaves the file or a page's checksum is wrong."""
        begin, held = self._block
        if begin <= start and n_bytes > 0 and start + n_bytes <= begin + len(held):
            return held[start - begin : start - begin + n_bytes]
        return self._read(start, n_bytes)

    def _read(self, start: int, n_bytes: int) -> NDArray[np.uint8]:
        if start < 0 or n_bytes < 0 or start + n_bytes > self.size:
            raise ReadError(
                f"{self.path} is damaged: bytes {start} to {start + n_bytes} lie outside its {self.size} bytes"
            )
        if not n_bytes:
            return np.empty(0, np.uint8)
        first, last = start // CONTENT, (start + n_bytes - 1) // CONTENT
        pages = np.ascontiguousarray(self._pages[first : last + 1])
        stated = pages[:, CONTENT:].copy().view(">u4")[:, 0]
        wrong = np.flatnonzero(page_checksums(pages, _CRC) != stated)
        if len(wrong):
            page = first + int(wrong[0])
            raise ReadError(f"{self.path} is damaged: the checksum of the page at byte {page * PAGE} is wrong")
        content = np.ascontiguousarray(pages[:, :CONTENT]).ravel()
        return content[start - first * CONTENT : start - first * CONTENT + n_bytes]


def pack_pages(content: bytes) -> NDArray[np.uint8]:
    """Lay content, header included, out in pages with checksums; the last is filled with zeros."""
    n_pages = -(-len(content) // CONTENT)
    pages = np.zeros((n_pages, PAGE), dtype=np.uint8)
    filled = np.frombuffer(content.ljust(n_pages * CONTENT, b"\0"), np.uint8)
    pages[:, :CONTENT] = filled.reshape(n_pages, CONTENT)
    pages[:, CONTENT:] = page_checksums(pages, _CRC).astype(">u4").view(np.uint8).reshape(n_pages, 4)
    return pages
