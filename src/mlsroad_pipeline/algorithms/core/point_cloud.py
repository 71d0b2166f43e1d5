"""Point cloud: coordinates relative to an origin, named columns and a coordinate reference system."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MissingColumnError


@dataclass(frozen=True)
class PointCloud:
    """Points with named columns, relative to an origin.

    Projected coordinates such as UTM reach millions of metres, where the resolution of float32 is half a metre. Points
    are therefore stored relative to a nearby `origin`.

    Parameters
    ----------
    xyz : ndarray of shape (n, 3), float32 or float64
        Coordinates in metres relative to `origin`, z up.
    columns : mapping of str to ndarray
        Per-point attributes, each of first dimension n. Names with a fixed meaning: `rgb` uint8 (n, 3),
        `intensity` float32 in [0, 1], `gps_time` float64 seconds, `scanner` uint8, `label` int16 (a class of the
        scheme in use, -1 for ignored points), `instance` int32 (0 for none).
    origin : ndarray of shape (3,), float64
        World coordinates of the local zero, metres.
    crs : str or None
        Coordinate reference system as WKT.
    source : str
        Name of the points in error messages, usually the path of the file.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3) floating or a column has another length.
    """

    xyz: NDArray[np.floating]
    columns: Mapping[str, NDArray] = field(default_factory=dict)
    origin: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    crs: str | None = None
    source: str = "point cloud"

    def __post_init__(self) -> None:
        if self.xyz.ndim != 2 or self.xyz.shape[1] != 3 or not np.issubdtype(self.xyz.dtype, np.floating):
            got = f"{self.xyz.dtype} {self.xyz.shape}"
            raise DataError(f"{self.source}: xyz must be floating of shape (n, 3), got {got}")
        for name, values in self.columns.items():
            if len(values) != len(self.xyz):
                raise DataError(f"{self.source}: column {name!r} has {len(values)} rows for {len(self.xyz)} points")

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.xyz)

    def __contains__(self, name: str) -> bool:
        """Return whether a column exists."""
        return name in self.columns

    def __getitem__(self, name: str) -> NDArray:
        """Return a column; raise `MissingColumnError` with the source and the existing columns if it is missing."""
        try:
            return self.columns[name]
        except KeyError:
            have = ", ".join(sorted(self.columns)) or "none"
            raise MissingColumnError(f"{self.source} has no column {name!r} (columns: {have})") from None

    def get(self, name: str) -> NDArray | None:
        """Return a column, or None if it is missing."""
        return self.columns.get(name)

    def world_xyz(self) -> NDArray[np.float64]:
        """Return world coordinates, float64 metres."""
        world = np.empty((len(self), 3))
        for axis in range(3):  # a tenth of the time of adding rows of three
            np.add(self.xyz[:, axis], self.origin[axis], out=world[:, axis], dtype=np.float64)
        return world

    def select(self, index: NDArray | slice) -> PointCloud:
        """Return the points selected by an index array, a boolean mask or a slice (views), with all columns."""
        if isinstance(index, slice):
            columns = {name: values[index] for name, values in self.columns.items()}
            return replace(self, xyz=self.xyz[index], columns=columns)
        if index.dtype == np.bool_ and len(index) != len(self):
            raise DataError(f"{self.source}: a mask of {len(index)} rows for {len(self)} points")
        rows = np.flatnonzero(index) if index.dtype == np.bool_ else index
        columns = {name: np.take(values, rows, axis=0) for name, values in self.columns.items()}
        return replace(self, xyz=np.take(self.xyz, rows, axis=0), columns=columns)

    def with_columns(self, **columns: NDArray) -> PointCloud:
        """Return the same points with columns added or replaced."""
        return replace(self, columns={**self.columns, **columns})

    def without_columns(self, names: Iterable[str]) -> PointCloud:
        """Return the same points without the named columns; missing columns are ignored."""
        drop = set(names)
        return replace(self, columns={k: v for k, v in self.columns.items() if k not in drop})

    def moved_to(self, origin: NDArray[np.float64]) -> PointCloud:
        """Return the same points relative to another origin; `xyz` becomes float64."""
        target = np.asarray(origin, dtype=np.float64)
        return replace(self, xyz=self.xyz.astype(np.float64) + (self.origin - target), origin=target)


def concatenate(clouds: Sequence[PointCloud], rows: Sequence[NDArray[np.integer]] | None = None) -> PointCloud:
    """Concatenate clouds of one CRS, relative to the origin of the first.

    Parameters
    ----------
    clouds : sequence of PointCloud
        At least one. Only columns of all clouds are kept.
    rows : sequence of (k,) int arrays, optional
        Rows of each cloud, in the order of the result; all by default. One copy in place of two.

    Returns
    -------
    PointCloud
        The points, cloud by cloud.

    Raises
    ------
    DataError
        If there is no cloud, or two clouds have different coordinate reference systems.
    """
    if not clouds:
        raise DataError("no point clouds to join")
    first = clouds[0]
    for cloud in clouds[1:]:
        if cloud.crs != first.crs:
            raise DataError(f"{cloud.source} and {first.source} have different coordinate reference systems")
    shared = [name for name in first.columns if all(name in cloud for cloud in clouds)]
    moved = [c if np.array_equal(c.origin, first.origin) else c.moved_to(first.origin) for c in clouds]
    return replace(
        first,
        xyz=_concatenated([c.xyz for c in moved], rows),
        columns={name: _concatenated([c[name] for c in clouds], rows) for name in shared},
    )


def _concatenated(arrays: Sequence[NDArray], rows: Sequence[NDArray[np.integer]] | None) -> NDArray:
    if rows is None:
        return np.concatenate(arrays)
    joined = np.empty((sum(map(len, rows)), *arrays[0].shape[1:]), np.result_type(*arrays))
    start = 0
    for values, chosen in zip(arrays, rows, strict=True):
        stop = start + len(chosen)
        if values.dtype == joined.dtype:
            np.take(values, chosen, axis=0, out=joined[start:stop], mode="clip")  # another mode copies twice
        else:
            joined[start:stop] = values[chosen]
        start = stop
    return joined
