"""Cloud-optimised point clouds (COPC 1.0): LAZ whose chunks are the nodes of an octree."""

import io
import struct
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import lazrs
import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.geometry.octree_sample import SPAN_BITS, OctreeSample, sample_octree
from mlsroad_pipeline.formats.files import atomic_file, check_file
from mlsroad_pipeline.formats.las import header as las
from mlsroad_pipeline.formats.las.records import RecordReader, record_dtype
from mlsroad_pipeline.formats.las.upgrade import upgrade_records, upgraded_header
from mlsroad_pipeline.formats.las.writer import RecordWriter

SUFFIX = ".copc.laz"
POINT_FORMATS = (6, 7, 8)
INFO, HIERARCHY = (b"copc", 1), (b"copc", 1000)
INFO_DATA = struct.Struct("<5d2Q2d88x")
ENTRIES = np.dtype([("key", "<i4", 4), ("offset", "<u8"), ("size", "<i4"), ("count", "<i4")])
CHUNK = 1_000_000
GATHERED = 1 << 19  # points per compressed batch


def is_copc(header: las.LasHeader) -> bool:
    """Return whether a file is cloud-optimised: its first record is that of COPC."""
    return bool(header.vlrs) and header.vlrs[0].key == INFO


def copc_path(path: str) -> str:
    """Return the name of the cloud-optimised copy, ``.copc.laz``, of a path that ends in ``.laz``."""
    return str(Path(path).with_suffix(SUFFIX))


def without_copc(header: las.LasHeader) -> las.LasHeader:
    """Return a header without the COPC records, whose byte offsets hold for one file only."""
    vlrs = tuple(vlr for vlr in header.vlrs if vlr.key[0] != INFO[0])
    return replace(header, vlrs=vlrs, evlrs=tuple(vlr for vlr in header.evlrs if vlr.key[0] != INFO[0]))


def write_copc(source: str | Path, target: str | Path, *, n_threads: int = 1) -> None:
    """Copy a LAS or LAZ file to COPC, ``.copc.laz``: the same points with all dimensions, in the order of an octree.

    Point formats 0 to 5 become 6 to 10; waveforms, which COPC cannot hold, are a `DataError`. The points pass through a
    temporary file beside the target; memory holds about 40 bytes per point. The bytes do not depend on ``n_threads``.
    """
    path, target = check_file(source), Path(target)
    if not target.name.lower().endswith(SUFFIX):
        raise DataError(f"a cloud-optimised file is named {SUFFIX}, got {target}")
    if target.exists() and target.samefile(path):
        raise DataError(f"{target} is the file to copy and would be overwritten")
    old = las.read_header(path)
    header = upgraded_header(old)
    if header.point_format not in POINT_FORMATS:
        raise DataError(f"{path} has points of format {old.point_format} with waveforms, which COPC cannot hold")
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=target.parent) as scratch, atomic_file(target) as stream:
        records = _unpacked(path, old, header, scratch, n_threads)
        counter = RecordWriter(io.BytesIO(), header, compress=False)
        xyz = np.empty((len(records), 3))
        times = [np.inf, -np.inf]
        for start in range(0, len(records), CHUNK):
            part = np.array(records[start : start + CHUNK])
            counter.count_only(part)
            for axis, name in enumerate("XYZ"):
                xyz[start : start + CHUNK, axis] = part[name] * header.scale[axis] + header.offset[axis]
            finite = part["gps_time"][np.isfinite(part["gps_time"])]
            times = [min(times[0], finite.min(initial=np.inf)), max(times[1], finite.max(initial=-np.inf))]
        nodes = sample_octree(xyz)
        span = (times[0], times[1]) if times[0] <= times[1] else (0.0, 0.0)
        _write(stream, counter, records, nodes, span, n_threads)


def _unpacked(path: Path, old: las.LasHeader, header: las.LasHeader, scratch: BinaryIO, n_threads: int) -> NDArray:
    with RecordReader(path, old, n_threads=n_threads) as reader:
        for start in range(0, old.n_points, CHUNK):
            scratch.write(upgrade_records(reader.read(start, start + CHUNK), old, header).tobytes())
    scratch.flush()
    dtype = record_dtype(header)
    return np.memmap(scratch, dtype=dtype, mode="r") if old.n_points else np.empty(0, dtype)


def _write(
    stream: BinaryIO,
    counter: RecordWriter,
    records: NDArray,
    nodes: OctreeSample,
    times: tuple[float, float],
    n_threads: int,
) -> None:
    header = counter.header
    laz = lazrs.LazVlr.new_for_compression(
        header.point_format, header.record_size - las.RECORD_SIZES[header.point_format], True
    )
    others = tuple(vlr for vlr in header.vlrs if vlr.key not in (INFO, las.LASZIP))
    info = las.Vlr(*INFO, bytes(INFO_DATA.size), b"COPC info")
    records_of = (info, *others, las.Vlr(*las.LASZIP, bytes(laz.record_data()), b"http://laszip.org"))
    header = replace(header, vlrs=records_of).patched(layout=header.point_format | las.COMPRESSED)
    stream.write(las.pack_header(header))
    points_at = stream.tell()
    kind = lazrs.ParLasZipCompressor if n_threads > 1 else lazrs.LasZipCompressor
    compressor = kind(stream, laz)
    ends = np.cumsum(nodes.counts)
    first = 0
    while first < len(ends):  # whole nodes, one batch at a time
        begin = int(ends[first] - nodes.counts[first])
        last = max(int(np.searchsorted(ends, begin + GATHERED, "right")), first + 1)
        gathered = records[nodes.order[begin : int(ends[last - 1])]]
        parts = np.split(gathered, (ends[first : last - 1] - begin).tolist())
        _compress(compressor, [part.tobytes() for part in parts], is_last=last == len(ends))
        first = last
    compressor.done()
    stream.seek(points_at)
    chunks = lazrs.read_chunk_table(stream, laz) if len(nodes.counts) else []
    stream.seek(0, 2)
    end = stream.tell()
    hierarchy = _hierarchy(nodes, chunks, points_at + 8)
    evlrs = (*(vlr for vlr in header.evlrs if vlr.key != HIERARCHY), las.Vlr(*HIERARCHY, hierarchy, b"EPT hierarchy"))
    at = end + sum(60 + len(vlr.data) for vlr in evlrs[:-1]) + 60
    half = nodes.size / 2
    data = INFO_DATA.pack(*(nodes.low + half), half, nodes.size / 2**SPAN_BITS, at, len(hierarchy), *times)
    header = replace(header, vlrs=(replace(info, data=data), *records_of[1:]), evlrs=evlrs)
    for vlr in evlrs:
        stream.write(vlr.pack(extended=True))
    stream.seek(0)
    stream.write(las.pack_header(counter.finished_header(header, end)))
    stream.seek(0, 2)


def _compress(
    compressor: lazrs.LasZipCompressor | lazrs.ParLasZipCompressor, parts: list[bytes], *, is_last: bool
) -> None:
    if isinstance(compressor, lazrs.ParLasZipCompressor):
        compressor.compress_chunks(parts)
        return
    for number, part in enumerate(parts, start=1):
        compressor.compress_many(part)
        if not (is_last and number == len(parts)):  # the last chunk ends with the points
            compressor.finish_current_chunk()


def _hierarchy(nodes: OctreeSample, chunks: list[tuple[int, int]], begin: int) -> bytes:
    """Return the only page of the hierarchy: byte offset, size and number of points of each node."""
    entries = np.zeros(len(nodes.counts), dtype=ENTRIES)
    sizes = np.array([n_bytes for _, n_bytes in chunks], dtype=np.int64)
    entries["key"], entries["count"], entries["size"] = nodes.keys, nodes.counts, sizes
    entries["offset"] = begin + np.cumsum(sizes) - sizes
    return entries.tobytes()
