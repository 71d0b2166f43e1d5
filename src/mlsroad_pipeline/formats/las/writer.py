"""Sequential writer of LAS and LAZ files."""

import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import BinaryIO

import lazrs
import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.formats.las.header import COMPRESSED, LASZIP, RECORD_SIZES, LasHeader, Vlr, pack_header

WAVEFORM_FORMATS = (9, 10)
CHANNEL_BITS = 0x30


class RecordWriter:
    """Writer of records in order, as LAZ or LAS, then of the header with their count, bounds and returns.

    ``stream`` is writable and seekable, at its start. Above one of ``n_threads``, chunks are compressed in parallel to
    the same bytes.
    """

    def __init__(self, stream: BinaryIO, header: LasHeader, *, compress: bool, n_threads: int = 1) -> None:
        self._stream, self._compressor = stream, None
        self._chunks: list[tuple[int, int]] = []  # of the chunks appended compressed
        records = tuple(vlr for vlr in header.vlrs if vlr.key != LASZIP)
        layout = header.point_format | (COMPRESSED if compress else 0)
        self.header = replace(header, vlrs=records).patched(layout=layout)
        self.count = 0
        self._channel: int | None = None
        self._low = np.full(3, np.iinfo(np.int32).max, dtype=np.int64)
        self._high = np.full(3, np.iinfo(np.int32).min, dtype=np.int64)
        self._returns = np.zeros(16, dtype=np.int64)
        if compress:
            extra = header.record_size - RECORD_SIZES[header.point_format]
            laz = lazrs.LazVlr.new_for_compression(header.point_format, extra)
            data = bytes(laz.record_data())
            self.header = replace(self.header, vlrs=(*records, Vlr(*LASZIP, data, b"http://laszip.org")))
        stream.write(pack_header(self.header))
        if compress:
            self._laszip, self._begin = laz, stream.tell()
            kind = lazrs.ParLasZipCompressor if n_threads > 1 else lazrs.LasZipCompressor
            self._compressor = kind(stream, laz)

    def write(self, records: NDArray) -> None:
        """Append contiguous records of the header's layout."""
        if not len(records):
            return
        self.count_only(records)
        if self._compressor is not None and self.header.point_format in WAVEFORM_FORMATS:
            self._check_channel(records)
        data = np.frombuffer(records, dtype=np.uint8)
        if self._compressor is None:
            self._stream.write(data.data)
        else:
            self._compressor.compress_many(data)

    def write_compressed(self, records: NDArray, chunks: Sequence[tuple[int, bytes]]) -> None:
        """Append chunks (points, bytes) of a LAZ file; ``records`` has the fields for counts and bounds.

        A file is written either this way or by `write`.
        """
        self.count_only(records)
        if not self._chunks:
            self._stream.write(bytes(8))  # placeholder for the byte offset of the chunk table
        for n_points, data in chunks:
            self._stream.write(data)
            self._chunks.append((n_points, len(data)))

    def count_only(self, records: NDArray) -> None:
        """Update counts and bounds with records, at least one, without writing them."""
        for axis, name in enumerate("XYZ"):
            self._low[axis] = min(self._low[axis], int(records[name].min()))
            self._high[axis] = max(self._high[axis], int(records[name].max()))
        mask = 0x07 if self.header.point_format < 6 else 0x0F
        bits = np.bincount(records["bit_fields"], minlength=256)
        self._returns += np.bincount(np.arange(256) & mask, weights=bits, minlength=16).astype(np.int64)
        self.count += len(records)

    def _check_channel(self, records: NDArray) -> None:
        channels = np.unique(records["classification_flags"] & CHANNEL_BITS)
        self._channel = int(channels[0]) if self._channel is None else self._channel
        if (channels != self._channel).any():
            raise DataError(
                f"points of format {self.header.point_format} with waveform packets of several scanner channels "
                "cannot be compressed without loss; write LAS, or one file per channel"
            )

    def close(self) -> None:
        """Write the end of the points, the extended records and the final header."""
        if self._chunks:
            self._write_chunk_table()
        elif self._compressor is not None:
            self._compressor.done()
        self._stream.seek(0, 2)
        end = self._stream.tell()
        for vlr in self.header.evlrs:
            self._stream.write(vlr.pack(extended=True))
        self._stream.seek(0)
        self._stream.write(pack_header(self.finished_header(self.header, end)))
        self._stream.seek(0, 2)

    def _write_chunk_table(self) -> None:
        table_offset = self._stream.tell()
        lazrs.write_chunk_table(self._stream, self._chunks, self._laszip)
        self._stream.seek(self._begin)
        self._stream.write(struct.pack("<q", table_offset))

    def finished_header(self, header: LasHeader, end: int) -> LasHeader:
        """Return a header with the counts, bounds and returns of the records so far.

        ``end`` is the byte offset of the extended records. `DataError` if there are more points than the version can
        hold.
        """
        empty = self.count == 0
        scaled = (np.stack([self._high, self._low], axis=1) * header.scale[:, None]) + header.offset[:, None]
        bounds = np.zeros((3, 2)) if empty else np.sort(scaled, axis=1)[:, ::-1]
        stated = np.array(header.fields["bounds"])
        if (np.abs(stated - bounds) <= np.abs(header.scale)[:, None] / 2).all():
            bounds = stated  # equal up to the rounding of the first writer
        new_only = header.minor >= 4 and not header.integer("legacy_count") and header.integer("count") > 0
        legacy = header.point_format < 6 and self.count < 2**32 and not new_only  # as in the source file
        if header.minor < 4 and not legacy:
            raise DataError(f"LAS 1.{header.minor} cannot hold {self.count} points; write point format 6 or above")
        by_return = self._returns[1:]
        done = header.patched(
            legacy_count=self.count if legacy else 0, legacy_returns=by_return[:5] if legacy else 0, bounds=bounds
        )
        if header.minor >= 3:
            done = done.patched(waveforms=_waveform_start(header, end))
        if header.minor >= 4:
            records = {"evlr_start": end if header.evlrs else 0, "n_evlrs": len(header.evlrs)}
            done = done.patched(**records, count=self.count, returns=by_return)
        return done


def _waveform_start(header: LasHeader, end: int) -> int:
    position = end
    for vlr in header.evlrs:
        if vlr.key == (b"LASF_Spec", 65535):
            return position
        position += 60 + len(vlr.data)
    return 0
