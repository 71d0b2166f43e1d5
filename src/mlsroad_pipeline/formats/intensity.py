"""Rule that maps the intensities of a file to [0, 1]."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.formats.options import ReadOptions

ORIGINAL = "original_intensity"
"""Column with the intensities of the file, where they are mapped by their range."""

FULL = (1.0, 255.0, 65535.0)
"""Full scales of intensities stored as floats."""


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
