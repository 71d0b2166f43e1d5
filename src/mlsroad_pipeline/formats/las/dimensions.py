"""Dimensions of LAS records as arrays: bit fields apart, extra dimensions in their unit, coordinates in metres."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from laspy.point.dims import COMPOSED_FIELDS
from numpy.typing import NDArray

from mlsroad_pipeline.formats.las.extra import ExtraDimension
from mlsroad_pipeline.formats.las.header import LasHeader
from mlsroad_pipeline.formats.las.records import record_dtype
from mlsroad_pipeline.formats.standard_columns import check_finite

FAR = 1e5  # distance in metres from the first point above which stated bounds are not used


def dimension_names(header: LasHeader) -> list[str]:
    """Return the names of dimensions: coordinates as x, y and z, bit fields apart, extra dimensions last."""
    names: list[str] = []
    for field in record_dtype(header).names or ():
        parts = COMPOSED_FIELDS[header.point_format].get(field)
        names.extend([field.lower() if field in "XYZ" else field] if parts is None else [part.name for part in parts])
    return names


class BitField(NamedTuple):
    """Bits of a field of the records."""

    field: str
    mask: int
    shift: int  # of the lowest bit


def bit_field(header: LasHeader, name: str) -> BitField | None:
    """Return the bits of a dimension; None where it has a field of its own."""
    for field, parts in COMPOSED_FIELDS[header.point_format].items():
        for part in parts:
            if part.name == name:
                return BitField(field, part.mask, (part.mask & -part.mask).bit_length() - 1)
    return None


def extra_dimension(header: LasHeader, name: str) -> ExtraDimension | None:
    """Return the extra dimension of a field of the records; None for a standard one."""
    extra = header.extra_dimensions
    fields = (record_dtype(header).names or ())[-len(extra) :] if extra else ()
    return dict(zip(fields, extra, strict=True)).get(name)


def dimension(records: NDArray, header: LasHeader, name: str) -> NDArray:
    """Return one dimension of records, bit fields unpacked, extra dimensions in their unit."""
    bits = bit_field(header, name)
    if bits is not None:
        return (records[bits.field] & bits.mask) >> bits.shift
    values = np.ascontiguousarray(records[name])
    extra = extra_dimension(header, name)
    return values if extra is None else extra.without_missing(values)


def near_corner(first: NDArray, header: LasHeader, metres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return world coordinates in metres near the points of a file, whose first record is given if there is one.

    It is the stated minimum if that is near the first point (it is often unset or wrong); else that point, or the
    offset. ``metres`` are factors from the file's units.
    """
    steps = np.array([float(first[name][0]) for name in "XYZ"]) if len(first) else np.zeros(3)
    with np.errstate(over="ignore", invalid="ignore"):  # overflows are an error of the coordinates
        point: NDArray[np.float64] = (steps * header.scale + header.offset) * metres
        stated: NDArray[np.float64] = header.bounds[0] * metres
        return stated if (np.abs(stated - point) < FAR).all() else point


def local_xyz(
    records: NDArray,
    header: LasHeader,
    origin: NDArray[np.float64],
    metres: NDArray[np.float64],
    *,
    path: Path,
    start: int,
) -> NDArray[np.float64]:
    """Return the coordinates of records relative to ``origin``, (n, 3) in metres; `DataError` if one overflows.

    ``metres`` are factors from the file's units; ``start`` is the row of the first record, for messages.
    """
    xyz = np.empty((len(records), 3))
    with np.errstate(over="ignore", invalid="ignore"):  # overflows raise below, with their row
        for axis, name in enumerate("XYZ"):
            np.multiply(records[name], header.scale[axis] * metres[axis], out=xyz[:, axis])
            xyz[:, axis] += header.offset[axis] * metres[axis] - origin[axis]
    check_finite(xyz, source=path, start=start)
    return xyz
