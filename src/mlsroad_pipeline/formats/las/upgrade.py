"""Lossless conversion of LAS point formats 0 to 5 to formats 6 to 10."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.formats.las import header as las
from mlsroad_pipeline.formats.las.crs import WKT, find_wkt, read_crs, with_wkt
from mlsroad_pipeline.formats.las.records import record_dtype

SUCCESSORS = {0: 6, 1: 6, 2: 7, 3: 7, 4: 9, 5: 10}  # point format to the one of LAS 1.4 that holds all its fields
ANGLE_STEP = 0.006  # degrees of one step of the scan angle in formats 6 to 10; formats 0 to 5 have whole degrees
LAST_DAY = 366  # largest day of a date
# Bits of the global encoding that are defined, and another of LAS 1.5: times are relative to an offset.
ENCODING_BITS, TIME_OFFSET_BIT = 0x1F, 0x40
SINGLE = (WKT, las.LOOKUP)  # records that a file has once; the first is used, of WKT the first that is valid
COPC = b"copc"
RECORD_1_0 = b"\xdd\xcc"  # signature before the points in LAS 1.0


def upgraded_header(header: las.LasHeader) -> las.LasHeader:
    """Return a header of LAS 1.4 or above and point format 6 to 10 for the same points.

    Dates, identifiers, scale, offset, records and bytes of unknown meaning are kept. A CRS in GeoTIFF keys is added as
    WKT, which these formats require, where the keys are supported. COPC records are dropped: they hold for the old file
    only.
    """
    single = [find_wkt(header), header.find(las.LOOKUP)]
    header = replace(header, vlrs=_valid(header.vlrs, single), evlrs=_valid(header.evlrs, single))
    if header.integer("day") > LAST_DAY:
        header = header.patched(day=0, year=0)
    encoding = header.integer("encoding") & (ENCODING_BITS | TIME_OFFSET_BIT * (header.minor >= 5))
    if encoding & (las.INTERNAL | las.EXTERNAL) == las.INTERNAL | las.EXTERNAL:
        inside = header.minor >= 3 and header.integer("waveforms") > 0
        encoding &= ~(las.EXTERNAL if inside else las.INTERNAL)
    header = header.patched(encoding=encoding)
    old = header.point_format
    if old not in SUCCESSORS and header.minor >= 4:
        return _with_system(header, header)
    successor = SUCCESSORS.get(old, old)  # points of a later format than the stated version has
    own, written = las.HEADER_SIZES[header.minor], max(header.minor, 4)
    block = header.block[:own].ljust(las.HEADER_SIZES[written], b"\0") + header.block[own:]
    gap = header.gap.removesuffix(RECORD_1_0) if header.minor == 0 else header.gap
    size = header.record_size + las.RECORD_SIZES[successor] - las.RECORD_SIZES[old]
    new = replace(header, block=block, gap=gap).patched(minor=written, layout=successor, record_size=size)
    return _with_system(new, header)


def _valid(records: Sequence[las.Vlr], single: Sequence[las.Vlr | None]) -> tuple[las.Vlr, ...]:
    """Return records as LAS 1.4 requires them: no second WKT, user ids in ASCII, no mark of LAS 1.0."""
    return tuple(
        replace(vlr, reserved=0, user_id=bytes(byte if byte < 128 else ord("_") for byte in vlr.user_id))
        for vlr in records
        if vlr.key[0] != COPC and (vlr.key not in SINGLE or any(vlr is record for record in single))
    )


def _with_system(new: las.LasHeader, old: las.LasHeader) -> las.LasHeader:
    """Return a header with the system of another as WKT, and the bit that point formats 6 to 10 require in any case."""
    done = new if find_wkt(old) is not None else with_wkt(new, read_crs(old))
    return done.patched(encoding=done.integer("encoding") | las.WKT_BIT)


def upgrade_records(records: NDArray, header: las.LasHeader, target: las.LasHeader) -> NDArray:
    """Convert records to the layout of an upgraded header, possibly with more dimensions, which are zero."""
    out = np.zeros(len(records), dtype=record_dtype(target))
    size = (len(records), -1)
    new, old = out.view(np.uint8).reshape(size), records.view(np.uint8).reshape(size)
    if header.point_format == target.point_format:
        new[:, : old.shape[1]] = old
        return out
    first, start = las.RECORD_SIZES[target.point_format], las.RECORD_SIZES[header.point_format]
    new[:, first : first + old.shape[1] - start] = old[:, start:]
    standard = record_dtype(header).names or ()
    packed = ("bit_fields", "raw_classification", "scan_angle_rank")
    for name in standard[: len(standard) - len(header.extra_dimensions)]:
        if name not in packed:
            out[name] = records[name]
    bits, classes = records["bit_fields"], records["raw_classification"]
    out["bit_fields"] = (bits & 0x07) | (bits & 0x38) << 1
    out["classification_flags"] = classes >> 5 | bits & 0xC0
    out["classification"] = classes & 0x1F
    out["scan_angle"] = np.rint(records["scan_angle_rank"] / ANGLE_STEP)
    return out
