"""Replacement of the classes and addition of dimensions in a LAZ file; other layers stay compressed.

In point formats 6 and above the fields of a chunk are compressed apart from each other, in layers (LASzip 3, "native
LAS 1.4 compression"). The layer of the classification depends on returns and scanner channel besides itself, that of
an extra byte on the scanner channel alone. These layers are compressed from records with only the fields needed;
the other layers are copied. The file is identical, byte for byte, to one that is compressed as a whole, at about a
third of the work.
"""

import io
import struct
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

import lazrs
import numpy as np
from laspy.point.dims import ALL_POINT_FORMATS_DTYPE
from numpy.typing import NDArray

from mlsroad_pipeline.formats.files import LAZ_CHUNK
from mlsroad_pipeline.formats.las.chunks import LAYERS
from mlsroad_pipeline.formats.las.extra import ExtraDimension
from mlsroad_pipeline.formats.las.header import LASZIP, RECORD_SIZES, LasHeader
from mlsroad_pipeline.formats.las.records import RecordReader
from mlsroad_pipeline.formats.las.writer import CHANNEL_BITS

CLASS = "classification"

_FORMATS = (6, 7, 8)
_CLASS_BYTE, _CLASS_LAYER = 16, 2
_NEEDED = int(lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL | lazrs.SELECTIVE_DECOMPRESS_Z)


def has_layers(header: LasHeader) -> bool:
    """Return whether the layers of a file can be copied.

    That is so for LAZ of point formats 6 to 8 in chunks of `LAZ_CHUNK` points, compressed as lazrs compresses.
    """
    record = header.find(LASZIP)
    if not header.compressed or not header.n_points or header.point_format not in _FORMATS or record is None:
        return False
    own = bytes(_laszip(header.point_format, header.record_size).record_data())
    # compressor and coder, points of a chunk, items with their versions; the rest identifies the writer
    return all(record.data[part] == own[part] for part in (slice(4), slice(12, 16), slice(32, None)))


def _laszip(point_format: int, record_size: int) -> lazrs.LazVlr:
    return lazrs.LazVlr.new_for_compression(point_format, record_size - RECORD_SIZES[point_format])


class LayerCopier:
    """Copier of chunks of a LAZ file that `has_layers`, with replaced classes and added dimensions; a context manager.

    ``classes``: `read` decompresses the file's classes, too. The bytes do not depend on ``n_threads``.
    """

    def __init__(
        self,
        path: Path,
        header: LasHeader,
        added: Mapping[str, ExtraDimension],
        *,
        classes: bool = False,
        n_threads: int = 1,
    ) -> None:
        self.added = tuple(added)
        self._header, self._n_threads = header, n_threads
        select = _NEEDED | (int(lazrs.SELECTIVE_DECOMPRESS_CLASSIFICATION) if classes else 0)
        self._reader = RecordReader(path, header, n_threads=n_threads, select=select)
        fields = [(name, *dimension.field_type[1:]) for name, dimension in added.items()]
        self._dtype = np.dtype([*ALL_POINT_FORMATS_DTYPE[6].descr, *fields])

    def __enter__(self) -> Self:
        """Return the copier."""
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close the file."""
        self._reader.__exit__(kind, error, trace)

    def read(self, start: int, stop: int) -> NDArray:
        """Return records with coordinates, returns, channel and, with `classes`, classes; other fields are zero."""
        return self._reader.read(start, stop)

    def chunks(self, start: int, records: NDArray, values: Mapping[str, NDArray]) -> list[tuple[int, bytes]]:
        """Return points and bytes of compressed chunks with replaced values.

        ``start`` is a multiple of `LAZ_CHUNK`, ``records`` the result of `read` for whole chunks, or up to the file's
        end; ``values`` are ``classification`` and the added dimensions.
        """
        changed = np.zeros(len(records), dtype=self._dtype)
        changed["bit_fields"] = records["bit_fields"]
        changed["classification_flags"] = records["classification_flags"] & CHANNEL_BITS
        for name, column in values.items():
            changed[name] = column
        first = start // LAZ_CHUNK
        return [
            (min(LAZ_CHUNK, len(records) - i * LAZ_CHUNK), self._spliced(self._reader.compressed(first + i), new))
            for i, new in enumerate(self._compressed(changed))
        ]

    def _compressed(self, records: NDArray) -> list[bytes]:
        laz = _laszip(6, records.dtype.itemsize)
        stream = io.BytesIO()
        kind = lazrs.ParLasZipCompressor if self._n_threads > 1 else lazrs.LasZipCompressor
        compressor = kind(stream, laz)
        compressor.compress_many(np.frombuffer(records, dtype=np.uint8))
        compressor.done()
        stream.seek(0)
        sizes = [n_bytes for _, n_bytes in lazrs.read_chunk_table(stream, laz)]
        return [stream.read(n_bytes) for n_bytes in sizes]

    def _spliced(self, old: bytes, new: bytes) -> bytes:
        """Insert the layers of classes and added dimensions into the chunk with the other layers."""
        old_first, count, old_layers = _parts(old, self._header.point_format, self._header.record_size)
        new_first, _, new_layers = _parts(new, 6, self._dtype.itemsize)
        first = [
            old_first[:_CLASS_BYTE],
            new_first[_CLASS_BYTE : _CLASS_BYTE + 1],
            old_first[_CLASS_BYTE + 1 :],
            new_first[RECORD_SIZES[6] :],
        ]
        layers = [*old_layers, *new_layers[LAYERS[6] :]]
        layers[_CLASS_LAYER] = new_layers[_CLASS_LAYER]
        sizes = struct.pack(f"<{len(layers)}I", *map(len, layers))
        return b"".join([*first, count, sizes, *layers])


def _parts(chunk: bytes, point_format: int, record_size: int) -> tuple[bytes, bytes, list[bytes]]:
    """Return the first point of a chunk, which is not compressed, the count of its points, and its layers."""
    n_layers = LAYERS[point_format] + record_size - RECORD_SIZES[point_format]
    at = record_size + 4 + 4 * n_layers
    layers = []
    for size in struct.unpack_from(f"<{n_layers}I", chunk, record_size + 4):
        layers.append(chunk[at : at + size])
        at += size
    return chunk[:record_size], chunk[record_size : record_size + 4], layers
