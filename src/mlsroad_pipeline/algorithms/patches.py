"""Patches of Luo et al. 2016, section III-A: the leaves of an octree, each described by shape, colour and height."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.exceptions import DataError

UNKNOWN = -1
"""Label of patches whose class is not known."""

_COLUMNS: dict[str, tuple[type[np.generic], int]] = {
    "fpfh": (np.float32, 2),
    "rgb": (np.float32, 2),
    "height": (np.float32, 1),
    "centroid": (np.float64, 2),
    "scene": (np.int32, 1),
    "label": (np.int16, 1),
}


@dataclass(frozen=True, eq=False)
class Patches:
    """Patches of one scene or of several, one row each.

    Parameters
    ----------
    fpfh : array-like of shape (n, d)
        Histogram of each patch; kept as float32. What `extract_patches` makes sums to 1, or to 0 for a patch without
        any neighbouring support point.
    rgb : array-like of shape (n, 3) or None
        Mean colour in [0, 1], kept as float32; None where the survey has no colour.
    height : array-like of shape (n,)
        Height of the centroid above the local ground in metres, kept as float32.
    centroid : array-like of shape (n, 3)
        Mean of the patch's points in metres, kept as float64.
    scene : array-like of int, shape (n,)
        Number of the scene that the patch is from, kept as int32.
    label : array-like of int, shape (n,)
        Class of the patch, kept as int16; `UNKNOWN` (-1) where it is not known.

    Raises
    ------
    DataError
        If a column has another shape or length, or a value is NaN or infinite.
    """

    fpfh: NDArray[np.float32]
    rgb: NDArray[np.float32] | None
    height: NDArray[np.float32]
    centroid: NDArray[np.float64]
    scene: NDArray[np.int32]
    label: NDArray[np.int16]

    def __post_init__(self) -> None:
        n = len(np.asarray(self.fpfh))
        for name, (dtype, n_dimensions) in _COLUMNS.items():
            if name == "rgb" and self.rgb is None:
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

    def take(self, rows: NDArray) -> Patches:
        """Return the patches at an index array or under a boolean mask."""
        columns = {name: getattr(self, name) for name in _COLUMNS}
        return Patches(**{name: None if values is None else values[rows] for name, values in columns.items()})

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the patches as named plain arrays, without `rgb` where there is no colour."""
        found = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: values for name, values in found.items() if values is not None}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Patches:
        """Rebuild patches from what `to_arrays` returned.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            The arrays; further entries are left alone.

        Returns
        -------
        Patches
            The patches.

        Raises
        ------
        DataError
            If an array other than `rgb` is missing, or the arrays do not fit together.
        """
        missing = [name for name in _COLUMNS if name != "rgb" and name not in arrays]
        if missing:
            raise DataError(f"the arrays of patches lack {', '.join(missing)}")
        return cls(**{name: arrays.get(name) for name in _COLUMNS})  # type: ignore[arg-type]


def join_patches(parts: Sequence[Patches]) -> Patches:
    """Join patches of several scenes, one after another.

    Parameters
    ----------
    parts : sequence of Patches
        At least one; their histograms have one length.

    Returns
    -------
    Patches
        All patches. They have colour only where every part has it.

    Raises
    ------
    DataError
        If there is no part, or the histograms differ in length.
    """
    if not parts:
        raise DataError("no patches to join")
    widths = sorted({part.fpfh.shape[1] for part in parts})
    if len(widths) > 1:
        raise DataError(f"patches with histograms of {' and '.join(map(str, widths))} bins cannot be joined")
    coloured = all(part.rgb is not None for part in parts)
    columns = {name: [getattr(part, name) for part in parts] for name in _COLUMNS if coloured or name != "rgb"}
    return Patches.from_arrays({name: np.concatenate(values) for name, values in columns.items()})
