"""GeoTIFF keys in LAS files: systems named by EPSG codes, and systems spelled out by projection and ellipsoid.

OGC GeoTIFF 1.1 (19-008r4), clause 7; key numbers and codes of transformations are those of its annexes. Only
explicit keys are used: a system with an unsupported part is None.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyproj
from pyproj.crs import (  # type: ignore[attr-defined]  # two are documented, but not in its list of exports
    CompoundCRS,
    CoordinateOperation,
    Ellipsoid,
    GeographicCRS,
    ProjectedCRS,
)
from pyproj.crs import coordinate_operation as operations
from pyproj.crs.coordinate_system import Cartesian2DCS
from pyproj.crs.datum import CustomDatum, CustomEllipsoid

from mlsroad_pipeline.algorithms.core.exceptions import DataError

DIRECTORY, DOUBLES, TEXTS = 34735, 34736, 34737
MODEL, RASTER, CITATION = 1024, 1025, 1026
GEOGRAPHIC, DATUM, ANGULAR_UNIT, ELLIPSOID, SEMI_MAJOR, SEMI_MINOR, INVERSE_FLATTENING = (
    *(2048, 2050, 2054, 2056, 2057),
    *(2058, 2059),
)
PROJECTED, CONVERSION, METHOD, LINEAR_UNIT = 3072, 3074, 3075, 3076
VERTICAL, VERTICAL_UNIT = 4096, 4099

USER_DEFINED, DEGREE = 32767, 9102
EPSG_CODES = range(1024, 32767)  # key values that are EPSG codes (7.5.1)
LINEAR = {9001: (1.0, "EASTING_NORTHING"), 9002: (0.3048, "EASTING_NORTHING_FT")}
# Code of a unit to its length in metres and to its axes in pyproj.
LINEAR[9003] = (1200 / 3937, "EASTING_NORTHING_US_FT")
# GeoTIFF 1.0 named vertical systems by the codes of their datums.
DATUMS_AS_SYSTEMS = {5101: 5701, 5102: 5702, 5103: 5703, 5104: 5736, 5105: 5705, 5106: 5706}
IN_FEET = {(5703, 9003): 6360, (5703, 9002): 8228}  # the same heights (NAVD88) in another unit, by code and unit
EAST, NORTH, SCALE = (3082, 3086, 3090), (3083, 3087, 3091), (3092, 3093)
LONGITUDE, LATITUDE, FIRST, SECOND = (3080, 3084, 3088), (3081, 3085, 3089), (3078,), (3079,)
_FALSE = {"false_easting": EAST, "false_northing": NORTH}
_NATURAL = {"latitude_natural_origin": LATITUDE, "longitude_natural_origin": LONGITUDE}
_SCALED = {**_NATURAL, **_FALSE, "scale_factor_natural_origin": SCALE}
_TWO_PARALLELS = {"latitude_first_parallel": FIRST, "latitude_second_parallel": SECOND}
_FALSE_ORIGIN = {
    **{"latitude_false_origin": LATITUDE, "longitude_false_origin": LONGITUDE},
    **{"easting_false_origin": EAST, "northing_false_origin": NORTH},
}
# Code of a transformation to its class and, for each of its parameters, its possible keys.
METHODS: dict[int, tuple[Any, dict[str, tuple[int, ...]]]] = {
    1: (operations.TransverseMercatorConversion, _SCALED),
    7: (operations.MercatorAConversion, _SCALED),
    8: (operations.LambertConformalConic2SPConversion, {**_FALSE_ORIGIN, **_TWO_PARALLELS}),
    9: (operations.LambertConformalConic1SPConversion, _SCALED),
    10: (operations.LambertAzimuthalEqualAreaConversion, {**_NATURAL, **_FALSE}),
    11: (operations.AlbersEqualAreaConversion, {**_FALSE_ORIGIN, **_TWO_PARALLELS}),
}
_NEEDED = {"latitude_first_parallel", "latitude_second_parallel"}  # parameters without a sensible default


class _Unsupported(Exception):
    """Unsupported part of the keys."""


@dataclass(frozen=True)
class GeotiffKeys:
    """The keys of a file, each with its value."""

    values: Mapping[int, int | float | str]  # key to value

    @classmethod
    def parse(cls, directory: bytes, doubles: bytes, texts: bytes) -> GeotiffKeys:
        """Read the keys from the data of records 34735, 34736 and 34737 (the last two may be empty).

        A key that points outside the records is left out; `DataError` if there are fewer keys than the directory
        states.
        """
        words = np.frombuffer(directory[: len(directory) // 8 * 8], dtype="<u2").reshape(-1, 4)
        stated = int(words[0, 3]) if len(words) else 0
        if len(words) < 1 + stated:
            raise DataError(f"their directory of {stated} keys is cut")
        numbers = np.frombuffer(doubles[: len(doubles) // 8 * 8], dtype="<f8")
        values: dict[int, int | float | str] = {}
        for key, where, count, value in words[1 : 1 + stated].tolist():
            if where == 0:
                values[key] = value
            elif where == DOUBLES and value < len(numbers):
                values[key] = float(numbers[value])
            elif where == TEXTS and value < len(texts):
                values[key] = texts[value : value + count].decode("latin-1").rstrip("|\0 ")
        return cls(values)

    def wkt(self) -> str:
        """Return the system as WKT; `DataError` if there is none or a part, which is named, is not supported."""
        try:
            crs = self._horizontal()
            height = self._vertical()
            if height is not None:
                crs = CompoundCRS(f"{crs.name} + {height.name}", [crs, height])
        except (_Unsupported, pyproj.exceptions.CRSError) as error:
            raise DataError(str(error)) from error
        return str(crs.to_wkt())

    def _code(self, key: int) -> int:
        value = self.values.get(key, 0)
        return value if isinstance(value, int) and value in EPSG_CODES else 0

    def _number(self, *keys: int) -> float | None:
        return next((float(v) for key in keys if isinstance(v := self.values.get(key), int | float)), None)

    def _horizontal(self) -> pyproj.CRS:
        if code := self._code(PROJECTED):
            return pyproj.CRS.from_epsg(code)
        if self.values.get(PROJECTED, 0) == USER_DEFINED or METHOD in self.values or self._code(CONVERSION):
            return self._projected()
        if self.values.get(MODEL) == 1:
            raise _Unsupported("a projected system without its code")
        return self._geographic()

    def _geographic(self) -> pyproj.CRS:
        if code := self._code(GEOGRAPHIC):
            return pyproj.CRS.from_epsg(code)
        if GEOGRAPHIC not in self.values:
            raise _Unsupported("they name no system")
        if self.values.get(ANGULAR_UNIT, DEGREE) != DEGREE:
            raise _Unsupported(f"angular unit {self.values[ANGULAR_UNIT]}")
        datum = self._code(DATUM)
        if datum and (crs := _of_datum(datum)) is not None:
            return crs
        major, inverse = self._number(SEMI_MAJOR), self._number(INVERSE_FLATTENING)
        minor = self._number(SEMI_MINOR)
        if code := self._code(ELLIPSOID):
            ellipsoid = Ellipsoid.from_epsg(code)
        elif major is not None and (inverse is not None or minor is not None):
            size = {"inverse_flattening": inverse} if inverse is not None else {"semi_minor_axis": minor}
            ellipsoid = CustomEllipsoid(semi_major_axis=major, **size)
        else:
            raise _Unsupported("a user-defined datum without an ellipsoid")
        return GeographicCRS(str(self.values.get(2049, "unnamed")), datum=CustomDatum(ellipsoid=ellipsoid))

    def _projected(self) -> pyproj.CRS:
        unit = self.values.get(LINEAR_UNIT, 9001)
        if unit not in LINEAR:
            raise _Unsupported(f"linear unit {unit}")
        metres, axes = LINEAR[int(unit)]
        if code := self._code(CONVERSION):
            conversion: Any = CoordinateOperation.from_epsg(code)
        else:
            conversion = self._conversion(metres)
        name = str(self.values.get(3073) or self.values.get(CITATION) or "unnamed")
        return ProjectedCRS(conversion, name, Cartesian2DCS(axis=axes), self._geographic())

    def _conversion(self, metres: float) -> Any:
        method = self.values.get(METHOD)
        if method not in METHODS:
            raise _Unsupported(f"transformation {method}" if method else "a projection without a transformation")
        kind, parameters = METHODS[int(method)]
        arguments = {}
        for name, keys in parameters.items():
            value = self._number(*keys)
            if value is None and name in _NEEDED:
                raise _Unsupported(f"transformation {method} without key {keys[0]}")
            if value is None:
                value = 1.0 if name.startswith("scale") else 0.0
            arguments[name] = value * metres if keys in (EAST, NORTH) else value
        return kind(**arguments)

    def _vertical(self) -> pyproj.CRS | None:
        code = self._code(VERTICAL)
        if not code:
            return None
        code = DATUMS_AS_SYSTEMS.get(code, code)
        unit = self.values.get(VERTICAL_UNIT, 0)
        crs = pyproj.CRS.from_epsg(IN_FEET.get((code, int(unit)), code) if isinstance(unit, int) else code)
        if not crs.is_vertical:
            raise _Unsupported(f"vertical system {code}")
        return crs


def _of_datum(code: int) -> pyproj.CRS | None:
    """Return the geographic system of a datum: EPSG code less 2000, if its datum has the given code."""
    try:
        crs = pyproj.CRS.from_epsg(code - 2000)
    except pyproj.exceptions.CRSError:
        return None
    stated = crs.datum.to_json_dict().get("id", {}).get("code") if crs.datum is not None else None
    return crs if crs.is_geographic and stated == code else None


def pack_directory(crs: str) -> bytes:
    """Return the record 34735 that names a system by EPSG codes; `DataError` if a part has no code."""
    system = pyproj.CRS.from_user_input(crs)
    parts = system.sub_crs_list or [system]
    keys = {MODEL: 2 if parts[0].is_geographic else 1, RASTER: 1}
    for part in parts:
        code = part.to_epsg(min_confidence=100)
        if code is None or code not in EPSG_CODES:
            raise DataError(f"{part.name} has no EPSG code")
        keys[VERTICAL if part.is_vertical else GEOGRAPHIC if part.is_geographic else PROJECTED] = code
    words = [[1, 1, 0, len(keys)], *([key, 0, 1, value] for key, value in sorted(keys.items()))]
    return np.array(words, dtype="<u2").tobytes()
