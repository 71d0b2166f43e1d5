"""Flat tables of scalar columns, shared by text, PLY and KITTI."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.standard_columns import (
    COLOURS,
    COORDINATES,
    check_finite,
    origin_near,
    standard_cloud,
)

CHUNK = 1_000_000
"""Points per written part."""


def flat_cloud(
    raw: Mapping[str, NDArray],
    *,
    first: Mapping[str, NDArray],
    options: ReadOptions,
    source: Path,
    start: int,
    extremes: Callable[[Sequence[str]], tuple[float, float]],
    crs: str | None = None,
    notes: list[str] | None = None,
) -> PointCloud:
    """Build a point cloud from scalar columns of a range of a file, relative to a round point near its first.

    ``raw`` has columns by standard name, ``first`` those of the file's first row, ``start`` is the row of the first
    point. `DataError` for a coordinate that is NaN or infinite, or a value outside its domain.
    """
    with np.errstate(invalid="ignore", over="ignore"):  # NaN and overflows raise below
        corner = [float(first[name][0]) if len(first[name]) else 0.0 for name in COORDINATES]
        origin = origin_near(np.array(corner) * options.factors)
        xyz = np.empty((len(raw["x"]), 3))
        for axis, name in enumerate(COORDINATES):
            if options.factors[axis] == 1.0:
                xyz[:, axis] = raw[name]
            else:
                np.multiply(raw[name], options.factors[axis], out=xyz[:, axis], dtype=np.float64)
        check_finite(xyz, source=source, start=start)
        if origin.any():
            xyz -= origin
        columns = {name: values for name, values in raw.items() if name not in COORDINATES}
        return standard_cloud(
            *(columns, xyz),
            options=options,
            source=source,
            origin=origin,
            crs=crs,
            anchor=np.array(corner) * options.factors,
            extremes=extremes,
            notes=notes,
        )


def scalar_columns(cloud: PointCloud, metres: float) -> dict[str, NDArray]:
    """Return a cloud as scalar columns in a file's unit, world coordinates (float64) first.

    Colours are split into red, green and blue; other columns of several values are numbered.
    """
    world = cloud.world_xyz() / metres
    columns: dict[str, NDArray] = {name: world[:, axis] for axis, name in enumerate(COORDINATES)}
    for name, values in cloud.columns.items():
        if values.ndim == 1:
            columns[name] = values
            continue
        parts = COLOURS if name == "rgb" else [f"{name}_{i}" for i in range(values.shape[1])]
        columns.update({part: values[:, i] for i, part in enumerate(parts)})
    return columns


def parts_of(cloud: PointCloud) -> Iterator[PointCloud]:
    """Yield consecutive parts of a cloud of up to `CHUNK` points."""
    for begin in range(0, len(cloud), CHUNK):
        yield cloud.select(np.arange(begin, min(begin + CHUNK, len(cloud))))


def column_names(cloud: PointCloud, options: WriteOptions) -> bytes:
    """Return the row of names above the points."""
    names = scalar_columns(cloud.select(np.arange(0)), options.metres)
    return (options.delimiter.join(names) + "\n").encode()


def write_columns(cloud: PointCloud, options: WriteOptions) -> bytes:
    """Return points as rows of text."""
    columns = scalar_columns(cloud, options.metres)
    texts = [
        fixed_text(values, options.decimals) if name in COORDINATES else number_text(values)
        for name, values in columns.items()
    ]
    return join_rows(texts, options.delimiter)


def fixed_text(values: NDArray[np.float64], decimals: int) -> pa.Array:
    """Return numbers as text with a fixed number of digits after the point."""
    return pa.array([f"{value:.{decimals}f}" for value in values.tolist()], pa.string())


def number_text(values: NDArray) -> pa.Array:
    """Return numbers as the shortest text that reads back unchanged; "nan" for NaN."""
    native = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("="))
    return pc.cast(pa.array(native.astype(np.uint8) if native.dtype == np.bool_ else native), pa.string())


def join_rows(texts: Sequence[pa.Array], delimiter: str) -> bytes:
    """Join columns of text into rows with line ends."""
    if not len(texts[0]):
        return b""
    rows = pc.binary_join_element_wise(*texts, delimiter)
    joined = pc.binary_join(pa.ListArray.from_arrays(pa.array([0, len(rows)], pa.int32()), rows), "\n")
    return bytes(joined[0].as_buffer()) + b"\n"
