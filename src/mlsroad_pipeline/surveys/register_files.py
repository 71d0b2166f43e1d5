"""Registers of road objects: CSV tables, GeoPackage, Shapefile, GeoJSON and other vector files."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import shapely

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable
from mlsroad_pipeline.formats.crs import parse_crs
from mlsroad_pipeline.formats.registry import format_of_name
from mlsroad_pipeline.surveys.truth_tables import read_csv, typed_objects

KINDS = ("pole", "sign", "tree")
"""Kinds of entries."""
COLUMNS = ("id", "kind", "x", "y", "height")
"""Columns of a register that are used."""
TABLES = (".csv", ".txt")
IGNORED = "-"
"""Kind of values that are left out."""


def is_point_cloud(path: str) -> bool:
    """Return whether a file is a point cloud by its name; a table is a register."""
    return format_of_name(path) is not None and not path.lower().endswith(TABLES)


@dataclass(frozen=True)
class RegisterFile:
    """A file with a register, and the meaning of its columns and values."""

    path: Path
    columns: Mapping[str, str] = field(default_factory=dict)  # Column of `COLUMNS` to its name in the file
    kinds: Mapping[str, str] = field(default_factory=dict)  # Value of the column of kinds to a kind, or `IGNORED`
    kind: str | None = None  # Kind of all entries, for a file without a column of kinds
    layer: str | None = None  # Layer of a vector file
    crs: str | None = None  # Coordinate reference system in place of that of the file

    def __post_init__(self) -> None:
        for name in self.columns:
            if name not in COLUMNS:
                raise ParameterError(f"--column {name}: unknown column (known: {', '.join(COLUMNS)})")
        for value, kind in (*self.kinds.items(), ("--kind", self.kind or IGNORED)):
            if kind not in (*KINDS, IGNORED):
                raise ParameterError(f"kind {kind!r} of {value}: unknown kind (known: {', '.join(KINDS)}, {IGNORED})")

    def read(self, crs: str | None) -> pd.DataFrame:
        """Return the entries with `id`, `kind`, `x`, `y`, `height`, in a system; None is the file's own.

        Raises ReadError or DataError, which names the file and the value.
        """
        if not self.path.is_file():
            raise ReadError(f"{self.path} does not exist: name a register (CSV, GeoPackage, Shapefile, GeoJSON)")
        numbers = [self.columns[name] for name in ("x", "y", "height") if name in self.columns]
        is_table = self.path.suffix.lower() in TABLES
        table = read_csv(self.path, numbers) if is_table else self._features()
        table = self._named(table)
        places, table = self._placed(table, crs)
        typed = typed_objects(table.assign(x=places[:, 0], y=places[:, 1]), self.path)
        if typed.empty:
            raise DataError(f"{self.path}: the register has no entries")
        return typed[list(COLUMNS)]

    def _features(self) -> gpd.GeoDataFrame:
        try:
            layers = [str(name) for name in pyogrio.list_layers(self.path)[:, 0]]
            if self.layer is None and len(layers) > 1:
                raise ReadError(f"{self.path} has layers {', '.join(layers)}: name one with --layer")
            if self.layer is not None and self.layer not in layers:
                raise ReadError(f"{self.path} has no layer {self.layer!r} (--layer): it has {', '.join(layers)}")
            frame = gpd.read_file(self.path, layer=self.layer)
        except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError) as error:
            raise ReadError(f"{self.path}: cannot be read as CSV, GeoPackage, Shapefile or GeoJSON") from error
        if not isinstance(frame, gpd.GeoDataFrame):
            raise ReadError(f"{self.path}: the features have no places")
        return frame

    def _error(self, text: str) -> DataError:
        """Return an error; names and kinds of the file may have control characters."""
        return DataError(f"{self.path}: {printable(text)}")

    def _named(self, table: pd.DataFrame) -> pd.DataFrame:
        """Return a table with columns of this module's names and kinds."""
        missing = [name for name in self.columns.values() if name not in table]
        if missing:
            raise self._error(f"no column {missing[0]!r} (has {', '.join(map(str, table))})")
        table = table.assign(**{name: table[given] for name, given in self.columns.items()})
        if self.kind is not None:
            table = table.assign(kind=self.kind)
        if "kind" not in table:
            raise self._error(
                f"no column 'kind' (has {', '.join(map(str, table))}): name it with --column kind=NAME, "
                "or give all entries one with --kind"
            )
        kinds = table["kind"].astype(object).where(table["kind"].notna(), "").astype(str).str.strip()
        if (kinds == "").any():
            entry = int((kinds == "").to_numpy().argmax()) + 1
            raise self._error(f"entry {entry} has no kind: fill it in, or remove it")
        mapped = kinds.map(lambda value: self.kinds.get(value, value.lower()))
        unknown = sorted(set(kinds[~mapped.isin((*KINDS, IGNORED))]))
        if unknown:
            more = f" and {len(unknown) - 5} more" if len(unknown) > 5 else ""
            raise self._error(
                f"unknown kinds {', '.join(unknown[:5])}{more}: give each a kind, such as "
                f"--value '{unknown[0]}=pole' ({', '.join(KINDS)}, {IGNORED} leaves out)"
            )
        table = table.assign(kind=mapped)[(mapped != IGNORED).to_numpy()]
        if "id" not in table:
            table = table.assign(id=np.arange(1, len(table) + 1))
        return table if "height" in table else table.assign(height=np.nan)

    def _placed(self, table: pd.DataFrame, crs: str | None) -> tuple[np.ndarray, pd.DataFrame]:
        """Return the places of entries in a system; lines and areas have their middle."""
        if isinstance(table, gpd.GeoDataFrame):
            shapes, own = table.geometry, table.crs
            table = table[~(shapes.is_empty | shapes.isna())]
            places = shapely.centroid(table.geometry.to_numpy())
        else:
            for name in ("x", "y"):
                if name not in table:
                    columns = ", ".join(map(str, table))
                    raise self._error(f"no column {name!r} (has {columns}): name it with --column {name}=NAME")
            numbers = typed_objects(table, self.path)
            places, own = shapely.points(numbers["x"], numbers["y"]), None
        known = own if self.crs is None else parse_crs(self.crs, option="--crs")
        moved = gpd.GeoSeries(places, crs=known)
        if known is not None and crs is not None:
            moved = moved.to_crs(crs)
        return shapely.get_coordinates(moved.to_numpy()), pd.DataFrame(table)
