"""Checker of rules of LAS 1.4 (ASPRS, R15), written from the specification and laspy alone."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np

SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
TYPE_SIZES = (0, 1, 1, 2, 2, 4, 4, 8, 8, 4, 8)


def _records(data, at, count, extended):
    form, size = ("<H16sHQ32s", 60) if extended else ("<H16sHH32s", 54)
    found = []
    for _ in range(count):
        reserved, user, number, length, description = struct.unpack_from(form, data, at)
        found.append((reserved, user, number, data[at + size : at + size + length], description, at))
        at += size + length
    return found, at


def broken_rules(path: Path) -> list[str]:
    """Return one sentence per rule that a LAS 1.4 file breaks."""
    data = Path(path).read_bytes()
    major, minor, layout = data[24], data[25], data[104]
    point_format, size = layout & 0x3F, struct.unpack_from("<H", data, 105)[0]
    header_size, begin, n_vlrs = struct.unpack_from("<HII", data, 94)
    encoding = struct.unpack_from("<H", data, 6)[0]
    legacy = struct.unpack_from("<6I", data, 107)
    evlr_at, n_evlrs, count, *returns = struct.unpack_from("<QIQ15Q", data, 235)
    vlrs, end = _records(data, header_size, n_vlrs, False)
    evlrs, last = _records(data, evlr_at, n_evlrs, True) if n_evlrs else ([], len(data))
    keys = [(user.split(b"\0")[0], number) for _, user, number, *_ in (*vlrs, *evlrs)]
    waveforms = (encoding & 0x06) >> 1
    rules = {
        "the signature is LASF": data[:4] == b"LASF",
        "the version is 1.4": (major, minor) == (1, 4),
        "the header has 375 bytes": header_size >= 375,
        "reserved bits of the global encoding are zero": not encoding & ~(0x5F if minor >= 5 else 0x1F),
        "waveform packets are internal or external, not both": waveforms != 3,
        "point formats 6 to 10 have the WKT bit": point_format < 6 or bool(encoding & 0x10),
        "a file with the WKT bit and GeoTIFF keys has WKT": (b"LASF_Projection", 34735) not in keys
        or (b"LASF_Projection", 2112) in keys
        or not encoding & 0x10,
        "legacy counts of point formats 6 to 10 are zero": point_format < 6 or not any(legacy),
        "legacy counts of others are those of the file or zero": point_format >= 6 or legacy[0] in (0, count),
        "returns add up to at most the number of points": sum(returns) <= count,
        "records end before the points": end <= begin,
        "extended records begin after the points": not n_evlrs or evlr_at >= begin,
        "the last record ends with the file or before": last <= len(data),
        "no offset without extended records": bool(n_evlrs) or evlr_at == 0,
        "reserved fields of records are zero": not any(record[0] for record in (*vlrs, *evlrs)),
        "user ids are ASCII": all(record[1].isascii() for record in (*vlrs, *evlrs)),
        "one Extra Bytes record": keys.count((b"LASF_Spec", 4)) <= 1,
        "one WKT record": keys.count((b"LASF_Projection", 2112)) <= 1,
        "one Classification Lookup record": keys.count((b"LASF_Spec", 0)) <= 1,
        "scales are not zero": all(struct.unpack_from("<3d", data, 131)),
        "the day is 1 to 366 or unset": struct.unpack_from("<H", data, 90)[0] <= 366,
    }
    broken = [name for name, holds in rules.items() if not holds]
    return broken + _extra_bytes([*vlrs, *evlrs], size - SIZES[point_format]) + _points(path)


def _extra_bytes(records, spare) -> list[str]:
    data = b"".join(r[3] for r in records if (r[1].split(b"\0")[0], r[2]) == (b"LASF_Spec", 4))
    if len(data) % 192:
        return ["descriptors of extra bytes have 192 bytes"]
    names, described, broken = [], 0, []
    for at in range(0, len(data), 192):
        kind, options = data[at + 2], data[at + 3]
        names.append(data[at + 4 : at + 36].rstrip(b"\0"))
        if kind > 30:
            broken.append(f"type {kind} is not defined")
        elif kind == 0:
            described += options
        else:
            described += TYPE_SIZES[(kind - 1) % 10 + 1] * (1 + (kind - 1) // 10)
            broken += ["reserved options are zero"] * bool(options & ~0x1F)
    broken += ["all extra bytes are described"] * (described != spare)
    return broken + ["names of extra bytes are unique and not empty"] * (len(set(names)) < len(names) or b"" in names)


def _points(path) -> list[str]:
    las = laspy.read(path)
    if not len(las):
        return []
    broken = []
    low, high = las.xyz.min(axis=0), las.xyz.max(axis=0)
    step = np.abs(las.header.scales)
    if not (np.abs(low - las.header.mins) <= step).all() or not (np.abs(high - las.header.maxs) <= step).all():
        broken.append("bounds are those of the points")
    counts = np.bincount(np.asarray(las.return_number), minlength=16)[1:]
    if not np.array_equal(counts[: len(las.header.number_of_points_by_return)], las.header.number_of_points_by_return):
        broken.append("numbers of points by return are those of the points")
    return broken
