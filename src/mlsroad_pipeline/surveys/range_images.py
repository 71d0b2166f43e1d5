"""Scans thinned to range images: one point per row of elevation and column of azimuth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least


@dataclass(frozen=True)
class RangeImage:
    """Size and field of view of a range image."""

    rows: int  # Numbers of its rows and columns
    columns: int  # Numbers of its rows and columns
    top: float = 3.0  # Elevations of its upper and lower edge, degrees
    bottom: float = -25.0  # Elevations of its upper and lower edge, degrees

    def __post_init__(self) -> None:
        check_at_least(self.rows, 1, "rows")
        check_at_least(self.columns, 1, "columns")
        if not self.top > self.bottom:
            raise ParameterError(f"range_image: top must be above bottom, got {self.top!r} and {self.bottom!r}")

    def kept(self, xyz: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the rows of the last point in each pixel, in order; points are in the scanner's axes, in metres.

        Points above and below the image fall into its first and last row.
        """
        distance = np.linalg.norm(xyz, axis=1)
        elevation = np.degrees(np.arcsin(xyz[:, 2] / np.maximum(distance, 1e-9)))
        turn = 0.5 * (1.0 - np.arctan2(xyz[:, 1], xyz[:, 0]) / np.pi)
        row = np.floor((self.top - elevation) / (self.top - self.bottom) * self.rows)
        column = np.floor(turn * self.columns)
        pixel = np.clip(row, 0, self.rows - 1) * self.columns + np.clip(column, 0, self.columns - 1)
        _, last = np.unique(pixel[::-1], return_index=True)
        return np.sort(len(xyz) - 1 - last).astype(np.int64)


def range_image(config: Mapping[str, Any]) -> RangeImage:
    """Return the range image that a configuration describes."""
    known = [field.name for field in fields(RangeImage)]
    wrong = [*(name for name in config if name not in known), *(n for n in ("rows", "columns") if n not in config)]
    if wrong:
        raise ParameterError(f"range_image has the keys {', '.join(known)}; unknown or missing: {', '.join(wrong)}")
    return RangeImage(**config)
