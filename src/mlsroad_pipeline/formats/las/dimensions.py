"""Dimensions of LAS records as arrays: bit fields apart, extra dimensions in their unit, coordinates in metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from laspy.point.dims import COMPOSED_FIELDS
from numpy.typing import NDArray

from mlsroad_pipeline.formats.las.extra import ExtraDimension
from mlsroad_pipeline.formats.las.header import LasHeader
from mlsroad_pipeline.formats.las.records import record_dtype
from mlsroad_pipeline.formats.standard_columns import check_finite, origin_near


def dimension_names(header: LasHeader) -> list[str]:
    """Return the names of a file's dimensions.

    Parameters
    ----------
    header : LasHeader
        The file's header.

    Returns
    -------
    list of str
        Coordinates as x, y and z, bit fields apart, extra dimensions last.
    """
    names: list[str] = []
    for field in record_dtype(header).names or ():
        parts = COMPOSED_FIELDS[header.point_format].get(field)
        names.extend([field.lower() if field in "XYZ" else field] if parts is None else [part.name for part in parts])
    return names


def extra_dimension(header: LasHeader, name: str) -> ExtraDimension | None:
    """Return the extra dimension of a field of the records.

    Parameters
    ----------
    header : LasHeader
        The file's header.
    name : str
        The field's name.

    Returns
    -------
    ExtraDimension or None
        None for a standard dimension.
    """
    extra = header.extra_dimensions
    fields = (record_dtype(header).names or ())[-len(extra) :] if extra else ()
    return dict(zip(fields, extra, strict=True)).get(name)


def dimension(records: NDArray, header: LasHeader, name: str) -> NDArray:
    """Return one dimension of records, bit fields unpacked and scaled extra dimensions in their unit.

    Parameters
    ----------
    records : structured ndarray of shape (n,)
        Records of the file.
    header : LasHeader
        Its header.
    name : str
        A name of `dimension_names`, coordinates left out.

    Returns
    -------
    ndarray of shape (n,) or (n, width)
        A copy.
    """
    for field, parts in COMPOSED_FIELDS[header.point_format].items():
        for part in parts:
            if part.name == name:
                return (records[field] & part.mask) >> (part.mask & -part.mask).bit_length() - 1
    values = np.ascontiguousarray(records[name])
    extra = extra_dimension(header, name)
    if extra is None or (extra.scale is None and extra.offset is None):
        return values
    scaled: NDArray = values * (1.0 if extra.scale is None else extra.scale)
    return scaled if extra.offset is None else scaled + extra.offset


def file_origin(header: LasHeader, metres: float) -> NDArray[np.float64]:
    """Return the local zero of a file's points.

    Parameters
    ----------
    header : LasHeader
        The file's header.
    metres : float
        Factor from the file's unit to metres.

    Returns
    -------
    ndarray of shape (3,), float64
        A round point near the header's minimum coordinates or, where these are not numbers, near its offset.
    """
    corner = header.bounds[0]
    return origin_near((corner if np.isfinite(corner).all() else header.offset) * metres)


def local_xyz(
    records: NDArray, header: LasHeader, origin: NDArray[np.float64], metres: float, *, path: Path, start: int
) -> NDArray[np.float64]:
    """Return the coordinates of records relative to an origin.

    Parameters
    ----------
    records : structured ndarray of shape (n,)
        Records of the file.
    header : LasHeader
        Its header.
    origin : ndarray of shape (3,)
        World coordinates of the local zero, metres.
    metres : float
        Factor from the file's unit to metres.
    path : Path
        The file, for messages.
    start : int
        Row of the first record.

    Returns
    -------
    ndarray of shape (n, 3), float64
        Metres.

    Raises
    ------
    DataError
        If scale and offset make a coordinate overflow.
    """
    xyz = np.empty((len(records), 3))
    with np.errstate(over="ignore", invalid="ignore"):  # overflows raise below, with their row
        for axis, name in enumerate("XYZ"):
            np.multiply(records[name], header.scale[axis] * metres, out=xyz[:, axis])
            xyz[:, axis] += header.offset[axis] * metres - origin[axis]
    check_finite(xyz, source=path, start=start)
    return xyz
