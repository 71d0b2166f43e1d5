"""Dimensions of LAS records as arrays: bit fields apart, extra dimensions in their unit, coordinates in metres.

A sample shows how many bits the colours and intensities of a file use.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
from laspy.point.dims import COMPOSED_FIELDS
from numpy.typing import NDArray

from mlsroad_pipeline.formats.files import FileKey, file_key, spread_starts
from mlsroad_pipeline.formats.las.extra import ExtraDimension
from mlsroad_pipeline.formats.las.header import LasHeader, read_header
from mlsroad_pipeline.formats.las.records import RecordReader, record_dtype
from mlsroad_pipeline.formats.standard_columns import COLOURS, check_finite

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
    parts = ((field, part) for field, group in COMPOSED_FIELDS[header.point_format].items() for part in group)
    found = ((field, part.mask) for field, part in parts if part.name == name)
    return next((BitField(field, mask, (mask & -mask).bit_length() - 1) for field, mask in found), None)


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


# Number of runs and points per run, evenly spread over the file, that determine the depth.
SAMPLES, SAMPLE_SIZE = 8, 2000
EIGHT = 255


@lru_cache(maxsize=64)
def sampled_maximum(key: FileKey, names: tuple[str, ...]) -> int:
    """Return the maximum of integer fields of a sample spread over the whole file, 0 without points."""
    path = Path(key[0])
    header = read_header(path)
    greatest = 0
    with RecordReader(path, header) as reader:
        for start in spread_starts(header.n_points, SAMPLES, SAMPLE_SIZE):
            records = reader.read(start, start + SAMPLE_SIZE)
            greatest = max(greatest, *(int(records[name].max(initial=0)) for name in names))
    return greatest


def colour_bits(key: FileKey) -> int:
    """Return 8 where the 16-bit colour fields of a file, by its `file_key`, hold colours of 8 bits, else 16."""
    return 8 if 0 < sampled_maximum(key, COLOURS) <= EIGHT else 16


@dataclass(frozen=True)
class Depths:
    """Full scales of the fields of 16 bits of a file."""

    intensity: int = 65535  # value of an intensity of 1
    colours: int = 16  # bits of the colours

    @classmethod
    def of_file(cls, path: Path) -> Self:
        """Return the full scales that a file uses."""
        key = file_key(path)
        fields = read_header(path).point_format in (2, 3, 5, 7, 8, 10)
        intensity = EIGHT if 0 < sampled_maximum(key, ("intensity",)) <= EIGHT else 65535
        return cls(intensity, colour_bits(key) if fields else 16)
