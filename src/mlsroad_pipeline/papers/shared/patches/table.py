"""Patches of one or several scenes: descriptors, places and labels as columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_arrays

UNKNOWN = -1
"""Label of patches of unknown class; patch of points outside all patches."""

_COLUMNS: dict[str, tuple[type[np.generic], int]] = {
    "fpfh": (np.float32, 2),
    "rgb": (np.float32, 2),
    "height": (np.float32, 1),
    "centroid": (np.float64, 2),
    "scene": (np.int32, 1),
    "label": (np.int16, 1),
    "station": (np.float64, 1),
}
_OPTIONAL = ("rgb", "station")


@dataclass(frozen=True, eq=False)
class Patches:
    """Patches of one or more scenes, one row per patch."""

    # Histogram of each patch, stored as float32. Histograms of `extract_patches` sum to 1, or to 0 for a patch without
    # neighbouring support points.
    fpfh: NDArray[np.float32]
    rgb: NDArray[np.float32] | None  # Mean colour in [0, 1], stored as float32; None without colour
    height: NDArray[np.float32]  # Mean height of the points above the local ground in metres, stored as float32
    centroid: NDArray[np.float64]  # Mean of the patch's points in metres, stored as float64
    scene: NDArray[np.int32]  # Scene number, stored as int32
    label: NDArray[np.int16]  # Class, stored as int16; `UNKNOWN` (-1) if unknown
    # Station along the road in metres, stored as float64; training scenes are cut by it. None if unknown.
    station: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        n = len(np.asarray(self.fpfh))
        for name, (dtype, n_dimensions) in _COLUMNS.items():
            if name in _OPTIONAL and getattr(self, name) is None:
                continue
            values = np.ascontiguousarray(getattr(self, name), dtype=dtype)
            width = values.shape[1:] if name == "fpfh" else (3,) * (n_dimensions - 1)
            if values.ndim != n_dimensions or values.shape != (n, *width):
                raise DataError(f"{name} of {n} patches must have shape {(n, *width)}, got {values.shape}")
            if values.dtype.kind == "f" and not np.isfinite(values).all():
                row = int(np.flatnonzero(~np.isfinite(values.reshape(n, -1)).all(axis=1))[0])
                raise DataError(f"{name} of patch {row} is not finite: {values[row].tolist()}")
            object.__setattr__(self, name, values)

    def __len__(self) -> int:
        """Return the number of patches."""
        return len(self.height)

    @property
    def positions(self) -> NDArray[np.float64]:
        """x, y and height above ground of the patches, shape (n, 3), metres."""
        return np.column_stack([self.centroid[:, :2], self.height])

    def take(self, rows: NDArray) -> Patches:
        """Return the patches selected by an index array or a boolean mask."""
        return Patches.from_arrays({name: values[rows] for name, values in self.to_arrays().items()})

    def with_columns(self, **columns: Any) -> Patches:
        """Return a copy with some columns replaced."""
        return replace(self, **columns)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the columns as named arrays, without colour and stations if there are none."""
        columns = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: values for name, values in columns.items() if values is not None}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> Patches:
        """Rebuild patches from the arrays of `to_arrays`."""
        check_arrays(arrays, (name for name in _COLUMNS if name not in _OPTIONAL), "patches")
        columns: dict[str, Any] = {name: arrays.get(name) for name in _COLUMNS}
        return cls(**columns)


def join_patches(parts: Sequence[Patches]) -> Patches:
    """Concatenate patches."""
    if not parts:
        raise DataError("no patches to join")
    widths = sorted({part.fpfh.shape[1] for part in parts})
    if len(widths) > 1:
        raise DataError(f"patches with histograms of {' and '.join(map(str, widths))} bins cannot be joined")
    columns = {name: [getattr(part, name) for part in parts] for name in _COLUMNS}
    for name in _OPTIONAL:
        if any(values is None for values in columns[name]):
            del columns[name]
    return Patches.from_arrays({name: np.concatenate(values) for name, values in columns.items()})


def edges_between(edges: NDArray[np.int32], rows: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the edges between the given patches, as indices into these."""
    place = np.where(rows, np.cumsum(rows) - 1, -1).astype(np.int32)[edges]
    return place[(place >= 0).all(axis=1)]
