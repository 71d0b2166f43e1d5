"""Objects of the inventory of an output folder, and the search for those that a decision was about."""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Collection, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.review.corrections.decisions import Anchor

INVENTORIES = ("inventory.parquet", "inventory.gpkg")
"""Files that hold the inventory of an output folder, the first that exists is read."""

FARTHEST = {"tree": 2.0, "vehicle": 1.5}
NEAR = 1.0
"""Largest distance in plan of an object from the place of a decision about it, metres; `FARTHEST` by kind."""

_SAME = 0.01  # metres

_NEEDED = ("object_id", "class", "kind", "x", "y", "z", "point_count")
_NOT_READ = ("geometry", "geom", "footprint", "bbox")


@dataclass(frozen=True)
class ListedObjects:
    """Objects of an inventory."""

    # One row per object with at least `object_id`, `class`, `kind`, `x`, `y`, `z` and `point_count`
    table: pd.DataFrame
    digest: str  # Digest of numbers, kinds and places: equal for equal inventories

    @classmethod
    def of(cls, table: pd.DataFrame) -> ListedObjects:
        """Return the objects of a table with the columns of an inventory."""
        places = table[["x", "y", "z"]].to_numpy(dtype=np.float64).round(3)
        digest = hashlib.blake2b(digest_size=16)
        digest.update(np.ascontiguousarray(table["object_id"].to_numpy(dtype=np.int64)).tobytes())
        digest.update(np.ascontiguousarray(places).tobytes())
        digest.update("\n".join(table["kind"].astype(str)).encode())
        return cls(table, digest.hexdigest())

    @classmethod
    def none(cls) -> ListedObjects:
        """Return an inventory without objects."""
        return cls.of(pd.DataFrame({name: pd.Series(dtype="object") for name in _NEEDED}))

    def anchor(self, number: int) -> Anchor | None:
        """Return an object as a decision records it; None if there is no object of that number."""
        if number not in self._rows:
            return None
        row = self.table.iloc[self._rows[number]]
        x, y, z = (float(row[axis]) for axis in "xyz")
        apart, _ = self._trees[str(row["kind"])].query((x, y), k=2)  # the first one is the object itself
        nearest = round(float(apart[1]), 3) if np.isfinite(apart[1]) else None
        return Anchor(self.digest, str(row["kind"]), str(row["class"]), x, y, z, int(row["point_count"]), nearest)

    @cached_property
    def _rows(self) -> dict[int, int]:
        """Number of each object to its row."""
        return {int(number): row for row, number in reversed([*enumerate(self.table["object_id"])])}

    @cached_property
    def _trees(self) -> dict[str, cKDTree]:
        """Places in plan of the objects of each kind."""
        return {
            str(kind): cKDTree(own[["x", "y"]].to_numpy(np.float64))
            for kind, own in self.table.groupby(self.table["kind"].astype(str))
        }

    def find(
        self, anchors: Mapping[int, Sequence[tuple[int, Anchor, str]]], *, of_any_kind: Collection[int] = ()
    ) -> dict[int, int | None]:
        """Find the objects of decisions again.

        `anchors` has, per group of decisions about one object (any key), the number then, the object then, and the kind
        that the user gave ("" for the same). Each group gets the number of the object now, None where there is none.
        Groups `of_any_kind` get an object of another kind, one that no other group has, where there is none of theirs.
        """
        found: dict[int, int | None] = {}
        of_others: dict[str, list[int]] = {}
        for key, group in anchors.items():
            number, anchor, _ = group[-1]
            if anchor.inventory == self.digest:
                found[key] = number
            else:
                found[key] = None
                of_others.setdefault(anchor.inventory, []).append(key)
        if len(self.table):
            for keys in of_others.values():  # objects of one inventory are different objects
                found |= self._nearest(keys, anchors)
                left = [key for key in keys if found[key] is None and key in of_any_kind]
                taken = [number for number in found.values() if number is not None]
                found |= self._nearest(left, anchors, without=taken) if left else {}
        return found

    def _nearest(
        self,
        keys: Sequence[int],
        anchors: Mapping[int, Sequence[tuple[int, Anchor, str]]],
        *,
        without: Collection[int] | None = None,
    ) -> dict[int, int]:
        """Return the nearest objects of the kind of each group; `without` some, those of all kinds."""
        numbers, kinds = self.table["object_id"].to_numpy(dtype=np.int64), self.table["kind"].astype(str).to_numpy()
        places = self.table[["x", "y"]].to_numpy(dtype=np.float64)
        far = 1e6
        cost = np.full((len(keys), len(self.table)), far)
        for row, key in enumerate(keys):
            _, anchor, given = anchors[key][-1]
            alike = np.isin(kinds, [kind for kind in (anchor.kind, given) if kind])
            if without is not None:
                alike = ~np.isin(numbers, list(without))
            distance = np.hypot(*(places - (anchor.x, anchor.y)).T)
            near = alike & (distance <= FARTHEST.get(anchor.kind, NEAR))
            if anchor.nearest is not None:
                near &= (distance < anchor.nearest / 2) | (distance <= _SAME)
            cost[row, near] = distance[near]
        pairs = zip(*linear_sum_assignment(cost), strict=True)
        return {keys[row]: int(numbers[column]) for row, column in pairs if cost[row, column] < far}


def read_objects(folder: Path) -> ListedObjects:
    """Return the objects of the inventory in an output folder, none if it has no inventory.

    Raises ReadError if the inventory is damaged.
    """
    path = next((folder / name for name in INVENTORIES if (folder / name).is_file()), None)
    if path is None:
        return ListedObjects.none()
    table = _parquet(path) if path.suffix == ".parquet" else _geopackage(path)
    missing = [name for name in _NEEDED if name not in table]
    if missing:
        raise ReadError(f"{path}: no column {missing[0]!r}: label the survey again")
    return ListedObjects.of(table)


def _parquet(path: Path) -> pd.DataFrame:
    try:
        file = pq.ParquetFile(path)
        names = [name for name in file.schema_arrow.names if name not in _NOT_READ]
        return file.read(columns=names).to_pandas()
    except (OSError, ValueError) as error:
        raise ReadError(f"{path}: not a GeoParquet inventory: {' '.join(str(error).split())}") from error


def _geopackage(path: Path) -> pd.DataFrame:
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
            names = [row[1] for row in base.execute('PRAGMA table_info("objects")')]
            chosen = ", ".join(f'"{name}"' for name in names if name not in (*_NOT_READ, "fid"))
            return pd.DataFrame() if not chosen else pd.read_sql_query(f"SELECT {chosen} FROM objects", base)
    except (sqlite3.Error, pd.errors.DatabaseError) as error:
        raise ReadError(f"{path}: not a GeoPackage inventory: {error}") from error
