"""Conversion of a file's columns to the standard ones: units, intensity, colour, labels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.column_values import (
    float_colours,
    integer_labels,
    join_colours,
)
from mlsroad_pipeline.formats.crs import parse_crs, reproject, sidecar_crs
from mlsroad_pipeline.formats.crs_units import in_metres
from mlsroad_pipeline.formats.files import log_once
from mlsroad_pipeline.formats.intensity import ORIGINAL, intensity_rule, scaled_intensity

COORDINATES = ("x", "y", "z")
COLOURS = ("red", "green", "blue")
COLOUR_DEPTH = "colours are read as {} bits in fields of 16; rgb_bits changes that"

INTEGER_COLUMNS = ("label", "instance")
NEAR = 1000.0
"""Coordinates below this many metres are local: float32 resolves them to 0.1 mm, and the origin stays zero."""


def origin_near(corner: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a round point near a point of a file (metres): easting and northing rounded down to 100 m, height zero.

    All zero where the coordinates are local already.
    """
    if not np.isfinite(corner).all() or (np.abs(corner[:2]) < NEAR).all():
        return np.zeros(3)
    return np.array([*np.floor(corner[:2] / 100.0) * 100.0, 0.0])


def check_finite(xyz: NDArray[np.float64], *, source: Path, start: int) -> None:
    """Raise `DataError` for NaN or infinite coordinates; ``start`` is the row of the first point in the file."""
    with np.errstate(invalid="ignore", over="ignore"):
        suspicious = not np.isfinite(xyz.sum())  # one pass without a mask; an overflowing sum is only checked again
    if suspicious:
        bad = np.flatnonzero(~np.isfinite(xyz).all(axis=1))
        if len(bad):
            first = int(bad[0])
            raise DataError(
                f"{source}: {len(bad)} points with NaN or infinite coordinates in rows {start} to "
                f"{start + len(xyz) - 1}, the first at row {start + first}: {xyz[first].tolist()}"
            )


def standard_cloud(
    raw: Mapping[str, NDArray],
    xyz: NDArray[np.float64],
    *,
    options: ReadOptions,
    source: Path,
    origin: NDArray[np.float64],
    crs: str | None,
    anchor: NDArray[np.float64],
    extremes: Callable[[Sequence[str]], tuple[float, float]],
    notes: list[str] | None = None,
) -> PointCloud:
    """Build a point cloud from columns of a range of a file.

    ``raw`` has columns by standard name without coordinates, ``xyz`` is in metres relative to ``origin``. The CRS of
    the options takes precedence over that of the file, and this over a sidecar. ``anchor`` is any point of the file in
    world coordinates, the same for all ranges: a reprojected cloud's origin is near it. ``extremes`` maps standard
    names to minimum and maximum of these columns over the whole file; ``notes`` gets one sentence per guess.
    """
    columns = dict(raw)
    if "intensity" in columns:
        _scale_intensity(columns, options, source, lambda: extremes(["intensity"]), notes)
    if set(COLOURS) <= columns.keys():
        parts = [columns.pop(name) for name in COLOURS]
        if np.issubdtype(parts[0].dtype, np.floating):
            greatest = extremes(COLOURS)[1]
            log_once(str(source), f"colours are fractional numbers up to {greatest:g}")
            columns["rgb"] = join_colours([float_colours(p, greatest, source=source) for p in parts], 0, source=source)
        else:
            shift = 8 if parts[0].dtype.itemsize == 2 and options.rgb_bits != 8 else 0
            if parts[0].dtype.itemsize == 2 and options.rgb_bits is None:
                log_once(str(source), COLOUR_DEPTH.format(8 + shift))
            columns["rgb"] = join_colours(parts, shift, source=source)
    if "gps_time" in columns and (options.time_scale != 1.0 or options.time_offset):
        columns["gps_time"] = columns["gps_time"].astype(np.float64) * options.time_scale + options.time_offset
    for name in INTEGER_COLUMNS:
        if name in columns:
            columns[name] = integer_labels(columns[name], name, source=source)
    if options.coding is not None and "label" in columns:
        columns["label"] = options.coding.encode(columns["label"], source=str(source))
    system = parse_crs(options.crs) if options.crs else crs or sidecar_crs(source)
    system = None if system is None else in_metres(system, *options.factors[1:].tolist())
    if options.reproject is None:
        return PointCloud(xyz, columns, origin, system, str(source))
    near = origin_near(reproject(anchor[None], system, options.reproject, name=source)[0][0])
    moved, system = reproject(xyz + origin, system, options.reproject, name=source)
    return PointCloud(moved - near, columns, near, system, str(source))


def _scale_intensity(
    columns: dict[str, NDArray],
    options: ReadOptions,
    source: Path,
    extremes: Callable[[], tuple[float, float]],
    notes: list[str] | None,
) -> None:
    """Map the intensities to [0, 1]; those that were mapped by their range are kept in another column."""
    values = columns["intensity"]
    rule = intensity_rule(values.dtype, options, extremes)
    columns["intensity"] = scaled_intensity(values, rule, source=source)
    if rule.by_range and options.only is None:
        columns.setdefault(ORIGINAL, values)
    if rule.note and options.intensity_scale != "auto":  # `inspect` and `label` read so, and warn of their notes
        log_once(str(source), rule.note)
    if rule.note and notes is not None:
        notes.append(rule.note)
    if (
        not rule.note
        and isinstance(options.intensity_scale, str)
        and options.intensity_range is None
        and rule.high != 1
    ):
        log_once(str(source), f"intensity ({values.dtype}) is divided by {rule.high:g}; intensity_scale changes that")
