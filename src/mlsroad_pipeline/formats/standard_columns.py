"""Conversion of a file's columns to the standard ones: units, intensity, colour, labels."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.crs import in_metres, parse_crs, reproject, sidecar_crs
from mlsroad_pipeline.formats.files import log_once

ORIGINAL = "original_intensity"  # column with the intensities of the file, where they are mapped by their range
FULL = (1.0, 255.0, 65535.0)  # full scales of intensities stored as floats


class IntensityRule(NamedTuple):
    """A linear map of intensities."""

    low: float  # values that become 0 and 1
    high: float
    clipped: bool = False  # whether values beyond them are clipped; otherwise they are an error
    note: str = ""  # sentence for the user, empty for the usual rules

    @property
    def by_range(self) -> bool:
        """Return whether the file's values do not follow from the result by a factor."""
        return self.low != 0.0


def intensity_rule(dtype: np.dtype, options: ReadOptions, extremes: Callable[[], tuple[float, float]]) -> IntensityRule:
    """Return the rule for the intensities of a file of this type.

    ``extremes`` returns minimum and maximum intensity of the whole file; it is called only where the rule depends on
    them.
    """
    rule = options.intensity_scale
    if options.intensity_range is not None:
        return IntensityRule(options.intensity_range[0], options.intensity_range[1], clipped=True)
    if not isinstance(rule, str):
        return IntensityRule(0.0, float(rule))
    if (dtype == np.uint8 and rule != "max") or (dtype.kind == "u" and rule == "dtype"):
        return IntensityRule(0.0, float(np.iinfo(dtype).max))
    low, high = extremes()
    if low < 0:
        high = high if high > low else low + 1.0
        text = f"intensities from {low:g} to {high:g} are mapped to 0 to 1; intensity_range sets other limits"
        return IntensityRule(low, high, clipped=True, note=text)
    if rule != "max" and dtype.kind in "iu":
        return _by_type(dtype, high) if rule == "auto" else IntensityRule(0.0, float(np.iinfo(dtype).max))
    full = high if rule == "max" else next((limit for limit in FULL if high <= limit), high)
    return IntensityRule(0.0, full if 0 < full < np.inf else 1.0)


def _by_type(dtype: np.dtype, high: float) -> IntensityRule:
    """Return the rule of integers without negative values: the range of the type, or of a narrower one that is used."""
    full = float(np.iinfo(dtype).max)
    narrow = next((limit for limit in FULL[1:] if 0 < high <= limit < full), full)
    if narrow != 255.0:
        return IntensityRule(0.0, narrow)
    bits = 8 * dtype.itemsize
    text = f"intensity has 8 bits in a field of {bits} and is divided by 255; intensity_scale changes that"
    return IntensityRule(0.0, narrow, clipped=True, note=text)


def scaled_intensity(values: NDArray, rule: IntensityRule, *, source: Path) -> NDArray[np.float32]:
    """Map intensities to [0, 1], NaN to NaN; `DataError` if one falls outside and the rule does not clip."""
    with np.errstate(over="ignore", invalid="ignore"):  # overflows raise below
        shifted = values - rule.low if rule.by_range else values
        scaled: NDArray[np.float32] = (shifted / (rule.high - rule.low)).astype(np.float32, copy=False)
    if rule.clipped:
        return np.clip(scaled, 0.0, 1.0)
    low, high = np.fmin.reduce(scaled, initial=np.nan), np.fmax.reduce(scaled, initial=np.nan)  # NaN where all are
    if low < 0 or high > 1:
        raise DataError(
            f"{source}: intensities {low * rule.high:g} to {high * rule.high:g} divided by {rule.high:g} leave [0, 1]; "
            "set intensity_range, such as [-25, 5], or another intensity_scale"
        )
    return scaled


def join_colours(parts: Sequence[NDArray], shift: int, *, source: Path) -> NDArray[np.uint8]:
    """Join red, green and blue, integers, into uint8 of shape (n, 3); ``shift`` is 8 for colours of 16 bits, else 0."""
    rgb = np.empty((len(parts[0]), 3), dtype=np.uint8)
    for axis, part in enumerate(parts):
        values = part >> shift if shift else part
        if values.dtype != np.uint8 and len(values) and not 0 <= values.min() <= values.max() <= 255:
            raise DataError(
                f"{source}: colour value {values.max()} in a file with assumed 8-bit colours; set rgb_bits: 16"
            )
        rgb[:, axis] = values
    return rgb


def float_colours(values: NDArray, greatest: float, *, source: Path) -> NDArray[np.int64]:
    """Turn one colour stored as floats into integers 0 to 255.

    ``greatest`` is the maximum colour of the whole file, which distinguishes ranges to 1, to 255 and to 65535.
    """
    wrong = values[~((values >= 0) & (values <= 65535))]
    if len(wrong):
        raise DataError(f"{source}: colour value {wrong[0]!r} is outside 0 to 65535")
    if greatest <= 1.0:
        return np.rint(values * 255.0).astype(np.int64)
    return np.rint(values).astype(np.int64) >> (0 if greatest <= 255.0 else 8)


def integer_labels(values: NDArray, name: str, *, source: Path) -> NDArray:
    """Return labels as integers (floats become int32); `DataError` if one is not a whole number."""
    if np.issubdtype(values.dtype, np.integer):
        return values
    with np.errstate(invalid="ignore"):  # values out of range differ after the cast and raise below
        whole = values.astype(np.int32)
    if not np.array_equal(whole, values):
        row = int(np.flatnonzero(whole != values)[0])
        raise DataError(f"{source}: column {name!r} holds {values[row]:g}, which is not a whole number")
    return whole


COORDINATES = ("x", "y", "z")
COLOURS = ("red", "green", "blue")
COLOUR_DEPTH = "colours are read as {} bits in fields of 16; rgb_bits changes that"

INTEGER_COLUMNS = ("label", "instance")
# Coordinates below this many metres are local: float32 resolves them to 0.1 mm, and the origin stays zero.
NEAR = 1000.0


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
