"""Interface of a point cloud format, and options of reading and writing."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_at_least

UNITS: dict[str, float] = {
    "metre": 1.0,
    "millimetre": 0.001,
    "centimetre": 0.01,
    "kilometre": 1000.0,
    "foot": 0.3048,
    "us_survey_foot": 1200.0 / 3937.0,
    "inch": 0.0254,
}
"""Length units in metres."""

BY_CRS = "crs"
"""Value of `ReadOptions.units` for those of the coordinate reference system."""

NEW_SURVEY = {"units": BY_CRS, "intensity_scale": "auto"}
"""Options of the readers for a survey to inspect or to label, whose files describe themselves."""

TAXONOMY_CODING = Coding("taxonomy", {code: name for name, code in TAXONOMY.items()})
"""The coding of files whose labels are taxonomy codes already."""


def _unit_factor(units: str | float) -> float:
    if isinstance(units, str):
        if units not in UNITS:
            raise ParameterError(f"units must be one of {', '.join(UNITS)} or a factor to metres, got {units!r}")
        return UNITS[units]
    if isinstance(units, bool) or not np.isfinite(units) or units <= 0:
        raise ParameterError(f"units as a factor to metres must be a finite number > 0, got {units!r}")
    return float(units)


class _Configured:
    """Options that can be built from a configuration mapping."""

    @classmethod
    def from_config(cls, config: Mapping[str, Any] | None) -> Self:
        """Build options from parameter names and values; `ParameterError` for an unknown name or a wrong value."""
        known = [f.name for f in fields(cls)]  # type: ignore[arg-type]  # every subclass is a dataclass
        unknown = sorted(set(config or {}) - set(known))
        if unknown:
            raise ParameterError(f"unknown {cls.__name__} {', '.join(unknown)} (known: {', '.join(known)})")
        return cls(**(config or {}))


def _as_coding(coding: Coding | Mapping[int, str] | str | None) -> Coding | None:
    if coding is None or isinstance(coding, Coding):
        return coding
    if isinstance(coding, str):
        if coding != "taxonomy":
            raise ParameterError(f"coding must be 'taxonomy' or a mapping of codes to classes, got {coding!r}")
        return TAXONOMY_CODING
    return Coding("of the options", {int(code): str(name) for code, name in coding.items()})


def _as_range(values: Any) -> tuple[float, float] | None:
    if values is None:
        return None
    numbers = [v for v in values if isinstance(v, int | float)] if isinstance(values, Sequence) else []
    if len(numbers) != 2 or len(values) != 2 or not np.isfinite(numbers).all() or numbers[0] >= numbers[1]:
        raise ParameterError(f"intensity_range must be two finite numbers, the smaller first, got {values!r}")
    return float(numbers[0]), float(numbers[1])


def _as_columns(columns: Any) -> dict[str, Any]:
    if not isinstance(columns, Mapping):
        raise ParameterError(f"columns must map standard names to columns of the file, got {columns!r}")
    for name, wanted in columns.items():
        parts = wanted if name == "rgb" and isinstance(wanted, Sequence) and not isinstance(wanted, str) else (wanted,)
        if len(parts) != (3 if name == "rgb" else 1) or not all(isinstance(part, int | str) for part in parts):
            kind = "three columns" if name == "rgb" else "a column"
            raise ParameterError(f"columns.{name} must be {kind}, by name or by index, got {wanted!r}")
    return dict(columns)


@dataclass(frozen=True)
class ReadOptions(_Configured):
    """Options for reading a survey; the defaults suit a self-describing file. docs/formats.md describes each."""

    columns: Mapping[str, Any] = field(default_factory=dict)
    units: str | float = "metre"
    coding: Any = None
    delimiter: str | None = None
    decimal: str | None = None
    header: bool | None = None
    comment: str = "#"
    intensity_scale: str | float = "dtype"
    rgb_bits: int | None = None
    time_scale: float = 1.0
    time_offset: float = 0.0
    crs: str | None = None
    reproject: str | None = None
    only: tuple[str, ...] | None = None
    n_threads: int = 1
    height_units: str | float | None = None
    intensity_range: Any = None

    def __post_init__(self) -> None:
        for units in (self.units, self.height_units):
            _unit_factor(1.0 if units is None or units == BY_CRS else units)
        object.__setattr__(self, "intensity_range", _as_range(self.intensity_range))
        object.__setattr__(self, "coding", _as_coding(self.coding))
        object.__setattr__(self, "columns", _as_columns(self.columns))
        if self.only is not None:
            object.__setattr__(self, "only", (self.only,) if isinstance(self.only, str) else tuple(self.only))
        if self.delimiter is not None and self.delimiter != "whitespace" and len(self.delimiter) != 1:
            raise ParameterError(f"delimiter must be one character or 'whitespace', got {self.delimiter!r}")
        if self.decimal not in (None, ".", ",") or (self.decimal is not None and self.decimal == self.delimiter):
            raise ParameterError(f"decimal must be '.' or ',' and differ from the delimiter, got {self.decimal!r}")
        if not self.comment:
            raise ParameterError("comment must not be empty, got ''")
        scale = self.intensity_scale
        if scale not in ("dtype", "auto", "max") and (isinstance(scale, str) or not np.isfinite(scale) or scale <= 0):
            raise ParameterError(
                f"intensity_scale must be 'dtype', 'auto', 'max' or a finite number > 0, got {scale!r}"
            )
        if self.rgb_bits not in (None, 8, 16):
            raise ParameterError(f"rgb_bits must be 8, 16 or None, got {self.rgb_bits!r}")
        if not np.isfinite([self.time_scale, self.time_offset]).all() or self.time_scale <= 0:
            raise ParameterError(
                f"time_scale must be a finite number > 0 and time_offset finite, got {self.time_scale!r}, "
                f"{self.time_offset!r}"
            )
        check_at_least(self.n_threads, 1, "n_threads")

    @property
    def metres(self) -> float:
        """Return the factor from the file's unit to metres; 1 where the system gives it (`crs_units.with_units`)."""
        return 1.0 if self.units == BY_CRS else _unit_factor(self.units)

    @property
    def factors(self) -> NDArray[np.float64]:
        """Return the factors from the file's units to metres, of x, y and z."""
        flat = self.metres
        return np.array([flat, flat, flat if self.height_units is None else _unit_factor(self.height_units)])


@dataclass(frozen=True)
class WriteOptions(_Configured):
    """Options for writing a cloud."""

    # LAS: the file whose header, scale, offset, variable length records and point layout are used; "source": that of
    # the cloud where it is LAS or LAZ; "none": a new header
    like: str | Path = "source"
    scale: float = 0.001  # LAS without `like`: resolution of the coordinates, metres
    units: str | float = "metre"  # unit of the coordinates in the file: a name of `UNITS` or a factor to metres
    delimiter: str = " "  # text: one character between values
    decimals: int = 4  # text: digits after the point of coordinates; 0.0001 m is finer than any mobile scanner
    n_threads: int = 1  # above one, LAZ is compressed in parallel; the bytes do not depend on it

    def __post_init__(self) -> None:
        _unit_factor(self.units)
        if not np.isfinite(self.scale) or self.scale <= 0:
            raise ParameterError(f"scale must be a finite number > 0, got {self.scale!r}")
        if len(self.delimiter) != 1:
            raise ParameterError(f"delimiter must be one character, got {self.delimiter!r}")
        if not 0 <= self.decimals <= 15:
            raise ParameterError(f"decimals must be in 0..15, got {self.decimals!r}")
        check_at_least(self.n_threads, 1, "n_threads")

    @property
    def metres(self) -> float:
        """Return the factor from the file's unit to metres."""
        return _unit_factor(self.units)


__all__ = ["FileInfo", "PointFormat", "ReadOptions", "WriteOptions"]


@dataclass(frozen=True)
class FileInfo:
    """Description of a file from its header, without reading its points."""

    path: Path
    format: str  # name of its format
    n_points: int
    columns: Mapping[str, np.dtype]  # columns of the result of `read`, after renaming, with their types there
    origin: NDArray[np.float64]  # local zero of every range of the file in world coordinates, metres
    crs: str | None = None  # coordinate reference system as WKT
    bounds: NDArray[np.float64] | None = None  # (2, 3): minimum and maximum in metres, where the header has them
    details: Mapping[str, Any] = field(default_factory=dict)  # others of the format, such as the version of a LAS file
    notes: tuple[str, ...] = ()  # one sentence per guess and repair of the reader that a user should know of


class PointFormat(Protocol):
    """A point cloud format; each has a module and an entry in `registry.FORMATS`."""

    name: str  # in messages
    extensions: tuple[str, ...]  # file name endings in lower case, with the dot; ``.txt.gz`` is one, too
    signatures: tuple[bytes, ...]  # first bytes of such files; empty where the format has none

    def recognises(self, path: Path, head: bytes) -> bool:
        """Return whether the first bytes of a file are those of this format.

        Formats without signatures examine the content or the name.
        """
        return head.startswith(self.signatures) if self.signatures else False

    def info(self, path: Path, options: ReadOptions) -> FileInfo:
        """Return the description of the file; raise `ReadError` where it is not of this format or is damaged."""
        ...

    def read(self, path: Path, options: ReadOptions, *, start: int = 0, stop: int | None = None) -> PointCloud:
        """Return rows `start` to `stop` (None: the end; clipped to the file) with their columns, in file order.

        `ReadError` for damaged files, `MissingColumnError` if a mapped column is not in the file, `DataError` if a
        value is outside its domain.
        """
        ...

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write the cloud; the file appears whole or not at all."""
