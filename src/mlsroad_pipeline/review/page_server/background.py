"""Background of the map: an orthophoto or map tiles of a local file, in the coordinate system of the survey."""

import base64
import io
import logging
import re
import sqlite3
import struct
import threading
import warnings
import zlib
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ParameterError, ReadError
from mlsroad_pipeline.review.page_server.tile_files import MbTiles, PmTiles, TileSource, mosaic
from mlsroad_pipeline.review.page_server.wanted import LARGEST

logger = logging.getLogger(__name__)

Area = tuple[float, float, float, float]
"""West, south, east, north."""

Frame = tuple[float, float, float, float, float, float, float, float]
"""Axes to the right and upwards (east, north), lower left corner along them, width and height: that of a map."""

_CLOUD = re.compile(r'<image data-layer="cloud"[^>]* data-frame="([-+.,e\d]+)" href="([^"]*)"')
"""Picture of the cloud on the map of a report."""

MOST_PIXELS = 120_000_000
"""Largest GeoTIFF, pixels: it is held in memory."""

_DAMAGED = (OSError, sqlite3.Error, zlib.error, ValueError, IndexError, OverflowError, SyntaxError, struct.error)
_SCALE, _TIE, _MATRIX, _KEYS = 33550, 33922, 34264, 34735  # tags of GeoTIFF
_PROJECTED, _GEOGRAPHIC, _RASTER_TYPE, _POINT, _OWN = 3072, 2048, 1025, 2, 32767
_KNOTS = 17  # per direction, between which coordinates are interpolated


class Background:
    """A local file under the map."""

    def __init__(self, path: Path, system: CRS | None) -> None:
        """Open a file; `system` is that of the survey, None where it is unknown."""
        if not path.is_file():
            raise ReadError(f"{path}: no such file (--background)")
        self.name, self._path = path.name, path
        self._source = _source(path)
        own = self._source.system if isinstance(self._source, GeoTiff) else CRS.from_epsg(3857)
        if system is None and not isinstance(self._source, GeoTiff):
            raise ParameterError(
                f"{path}: map tiles need a survey with a coordinate reference system: label it with --crs"
            )
        self._moved: Transformer | None = None
        self._is_empty = False
        if own is not None and system is not None and own.to_2d() != system.to_2d():
            try:
                self._moved = Transformer.from_crs(system.to_2d(), own.to_2d(), always_xy=True)
            except ProjError as error:
                raise ReadError(f"{path}: {own.name} cannot be transformed to {system.name}") from error

    def picture(self, area: Area, size: tuple[int, int]) -> tuple[bytes, str]:
        """Return an area of the survey's system as JPEG, or as PNG where a part has no colour, and its media type."""
        west, south, east, north = area
        return self._checked((1.0, 0.0, 0.0, 1.0, west, south, east - west, north - south), size)

    def _checked(self, frame: Frame, size: tuple[int, int]) -> tuple[bytes, str]:
        try:
            return self._picture(frame, size)
        except MlsRoadError:
            raise
        except _DAMAGED as error:
            raise ReadError(f"{self._path} is damaged: {' '.join(str(error).split())}") from error

    def _picture(self, frame: Frame, size: tuple[int, int]) -> tuple[bytes, str]:
        x, y = self._places(frame, size)
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            found = np.zeros((*x.shape, 4), np.uint8)
        elif isinstance(self._source, GeoTiff):
            found = self._source.sample(x, y)
        else:
            found = _sample_tiles(self._source, x, y)
        if not found[..., 3].any() and not self._is_empty:
            self._is_empty = True
            logger.warning(
                "%s shows nothing of the survey: it lies elsewhere, or its system is another one", self._path
            )
        stream, is_whole = io.BytesIO(), bool((found[..., 3] == 255).all())
        image = Image.fromarray(found)
        if is_whole:
            image.convert("RGB").save(stream, "JPEG", quality=88)
        else:
            image.save(stream, "PNG", compress_level=1)
        return stream.getvalue(), "image/jpeg" if is_whole else "image/png"

    def embedded(self, area: Area) -> dict[str, Any]:
        """Return the picture of an area as a data address, for a page without a server."""
        west, south, east, north = area
        return {
            "address": self._address((1.0, 0.0, 0.0, 1.0, west, south, east - west, north - south)),
            "area": list(area),
        }

    def report(self, path: Path) -> str:
        """Return a report with this file under its map; as it is where the file cannot be read."""
        page = path.read_text(encoding="utf-8")
        try:
            return self.in_report(page)
        except MlsRoadError as error:
            logger.warning("%s", error)
            return page

    def in_report(self, page: str) -> str:
        """Return a report whose map shows this file in place of the cloud; one without a frame is unchanged."""
        found = _CLOUD.search(page)
        if found is None:
            return page
        frame = tuple(float(number) for number in found[1].split(","))
        page = f"{page[: found.start(2)]}{self._address(cast('Frame', frame))}{page[found.end(2) :]}"
        return page.replace(">cloud by class</label>", f">{escape(self.name)}</label>", 1)

    def _address(self, frame: Frame) -> str:
        """Return the picture of a frame as a data address."""
        width, height = (max(1, round(LARGEST * side / max(frame[6:]))) for side in frame[6:])
        content, kind = self._checked(frame, (width, height))
        return f"data:{kind};base64,{base64.b64encode(content).decode()}"

    def _places(self, frame: Frame, size: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the places of the pixels in the system of the file."""
        (*axes, left, bottom, wide, high), (width, height) = frame, size
        right = left + (np.arange(width) + 0.5) / width * wide
        up = bottom + high - (np.arange(height) + 0.5) / height * high
        if self._moved is None:
            return _turned(right, up, axes)
        knots_right, knots_up = np.linspace(left, left + wide, _KNOTS), np.linspace(bottom + high, bottom, _KNOTS)
        moved = self._moved.transform(*_turned(knots_right, knots_up, axes))
        across, down = _hats(right, knots_right), _hats(-up, -knots_up)
        return tuple(down @ np.asarray(part) @ across.T for part in moved)


def _turned(
    right: NDArray[np.float64], up: NDArray[np.float64], axes: Sequence[float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the eastings and northings of places along two axes, shape (up, right)."""
    x, y = (right * axes[k] + up[:, None] * axes[k + 2] for k in (0, 1))
    return x, y


def _hats(values: NDArray[np.float64], knots: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weights of linear interpolation, shape (values, knots)."""
    share = (values - knots[0]) / (knots[-1] - knots[0]) * (len(knots) - 1)
    weights: NDArray[np.float64] = np.maximum(0.0, 1.0 - np.abs(share[:, None] - np.arange(len(knots))))
    return weights


def _source(path: Path) -> "GeoTiff | TileSource":
    suffix = path.suffix.lower()
    if suffix in (".tif", ".tiff"):
        return GeoTiff(path)
    if suffix == ".mbtiles":
        return MbTiles(path)
    if suffix == ".pmtiles":
        return PmTiles(path)
    raise ParameterError(f"{path}: a background is a GeoTIFF (.tif), .mbtiles or .pmtiles file")


def _sample_tiles(source: TileSource, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.uint8]:
    area = (float(x.min()), float(y.min()), float(x.max()), float(y.max()))
    resolution = max((area[2] - area[0]) / x.shape[1], (area[3] - area[1]) / x.shape[0], 1e-3)
    whole, (west, north, size) = mosaic(source, area, resolution)
    return _picked(whole, (north - y) / size, (x - west) / size)


def _picked(picture: NDArray[np.uint8], row: NDArray[np.float64], column: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return the pixels at places from the upper left corner, transparent ones beyond the picture."""
    height, width = picture.shape[:2]
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    i, j = (np.where(inside, value, 0).astype(np.int64) for value in (row, column))
    found = picture[i, j]
    if found.shape[-1] == 3:
        found = np.concatenate([found, np.full((*found.shape[:2], 1), 255, np.uint8)], axis=-1)
    return np.where(inside[..., None], found, np.uint8(0))


class _Place(NamedTuple):
    """Affine places of a raster: column and row to x and y."""

    matrix: NDArray[np.float64]  # x = m[0] @ (column, row, 1), y = m[1] @ (column, row, 1)

    def pixels(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[Any, Any]:
        """Return rows and columns of places."""
        inverse = np.linalg.inv(np.vstack([self.matrix, [0, 0, 1]]))
        column, row = (inverse[k, 0] * x + inverse[k, 1] * y + inverse[k, 2] for k in (0, 1))
        return row, column


class GeoTiff:
    """An orthophoto of 8 bits per channel; it is decoded at the first request."""

    def __init__(self, path: Path) -> None:
        self._path, self._guard = path, threading.Lock()
        self._levels: list[NDArray[np.uint8]] = []
        with _opened(path) as image:
            tags = dict(getattr(image, "tag_v2", {}))
            if image.width * image.height > MOST_PIXELS:
                raise ReadError(
                    f"{path} has {image.width} x {image.height} pixels, allowed are {MOST_PIXELS:,}: make it smaller "
                    "(gdal_translate -outsize 50% 50%), or tiles of it (gdal_translate -of MBTiles)"
                )
            if image.mode.startswith(("I", "F")):
                raise ReadError(f"{path} has pixels of type {image.mode}: make them 8 bits (gdal_translate -ot Byte)")
        keys = _geo_keys(tags)
        self.system = _system(path, keys)
        self._place = _placed(path, tags, is_point=keys.get(_RASTER_TYPE) == _POINT)

    def sample(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return the pixels at places, RGBA; of a coarser level where pixels of the picture would be skipped."""
        row, column = self._place.pixels(x, y)
        step = max(float(np.ptp(row)) / max(len(row), 1), float(np.ptp(column)) / max(row.shape[1], 1), 1.0)
        levels = self._pyramid()
        level = min(int(np.log2(step)), len(levels) - 1)
        return _picked(levels[level], row / 2**level, column / 2**level)

    def _pyramid(self) -> list[NDArray[np.uint8]]:
        """Return the picture, and those of half the size each."""
        with self._guard:
            if not self._levels:
                with _opened(self._path) as image:
                    whole = image.convert("RGBA" if image.mode in ("RGBA", "LA", "PA") else "RGB")
                while True:
                    self._levels.append(np.asarray(whole))
                    if max(whole.size) <= 512:
                        break
                    whole = whole.reduce(2)
            return self._levels


def _opened(path: Path) -> Image.Image:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of large pictures, whose size is checked, and of odd tags
            return Image.open(path)
    except (UnidentifiedImageError, Image.DecompressionBombError, OSError, SyntaxError) as error:
        raise ReadError(f"{path}: not a TIFF that can be read: {' '.join(str(error).split())}") from error


def _geo_keys(tags: dict[int, Any]) -> dict[int, int]:
    """Return the short values of the GeoKeys."""
    values = [int(value) for value in tags.get(_KEYS, ())]
    entries = [values[i : i + 4] for i in range(4, len(values) - 3, 4)]
    return {key: value for key, place, _, value in entries if place == 0}


def _system(path: Path, keys: dict[int, int]) -> CRS | None:
    code = keys.get(_PROJECTED, keys.get(_GEOGRAPHIC))
    if code is None or code == _OWN:
        return None  # taken as that of the survey
    try:
        return CRS.from_epsg(code)
    except CRSError as error:
        raise ReadError(f"{path}: unknown coordinate reference system EPSG:{code}") from error


def _placed(path: Path, tags: dict[int, Any], *, is_point: bool) -> _Place:
    """Return the places of the pixels, from the tags of GeoTIFF or the world file beside it."""
    world = next((p for end in (".tfw", ".TFW", ".tifw") if (p := path.with_suffix(end)).is_file()), None)
    half = 0.5 if is_point else 0.0
    if _MATRIX in tags:
        m = [float(value) for value in tags[_MATRIX]]
        rows = [[m[0], m[1], m[3]], [m[4], m[5], m[7]]]
    elif _SCALE in tags and _TIE in tags:
        (dx, dy), (i, j, _, x, y) = tags[_SCALE][:2], tags[_TIE][:5]
        rows = [[dx, 0.0, x - i * dx], [0.0, -dy, y + j * dy]]
    elif world is not None:
        try:
            a, d, b, e, c, f = (float(text) for text in world.read_text(encoding="ascii").split())
        except (ValueError, OSError) as error:
            raise ReadError(f"{world}: not a world file of six numbers") from error
        rows, half = [[a, b, c], [d, e, f]], 0.5
    else:
        raise ReadError(f"{path} does not say where it lies: it has neither tags of GeoTIFF nor a world file (.tfw)")
    matrix = np.array(rows, np.float64)
    matrix[:, 2] -= half * (matrix[:, 0] + matrix[:, 1])  # of the corner of the first pixel
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:, :2])) < 1e-18:
        raise ReadError(f"{path}: its places are not finite, or all on a line")
    return _Place(matrix)


def open_background(path: Path, folder: Path) -> Background:
    """Open a background for the survey of an output folder."""
    from mlsroad_pipeline.review.corrections.edited_inventory import system_of  # noqa: PLC0415  # GeoPandas

    try:
        return Background(path, system_of(folder))
    except MlsRoadError:
        raise
    except (*_DAMAGED, KeyError, TypeError) as error:
        raise ReadError(f"{path}: not a background that can be read: {' '.join(str(error).split())}") from error
