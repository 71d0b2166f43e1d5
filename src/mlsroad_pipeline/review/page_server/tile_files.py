"""Map tiles of a local MBTiles or PMTiles file, and the picture of several of them."""

import gzip
import io
import math
import sqlite3
import struct
from contextlib import closing
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from mlsroad_pipeline.algorithms.core.exceptions import ReadError

HALF = math.pi * 6378137.0
"""Half the width of the world in Web Mercator (EPSG:3857), metres."""

_MOST_TILES = 150  # of a picture, where there are lower levels
_MOST_AT_ALL = 4096  # of a picture; of a wider view nothing is drawn
_MOST_PIXELS = 40_000_000  # of the picture of all tiles
_PMTILES = struct.Struct("<7sB11Q6B")
_RASTER = {2: "png", 3: "jpg", 4: "webp", 5: "avif"}
_GZIP, _PLAIN = 2, 1


class TileSource(Protocol):
    """File with tiles: its levels, and the encoded picture of a tile, counted from the north-west."""

    levels: tuple[int, int]

    def tile(self, level: int, column: int, row: int) -> bytes | None:
        """Return a tile, None where there is none."""


class MbTiles:
    """Tiles of an MBTiles file (SQLite)."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with closing(self._open()) as base:
                found = dict(base.execute("SELECT name, value FROM metadata").fetchall())
                levels = base.execute("SELECT min(zoom_level), max(zoom_level) FROM tiles").fetchone()
        except sqlite3.Error as error:
            raise ReadError(f"{path}: not an MBTiles file: {error}") from error
        if found.get("format") == "pbf":
            raise ReadError(f"{path} holds vector tiles: the background needs tiles of png, jpg or webp")
        if levels[0] is None:
            raise ReadError(f"{path} holds no tiles")
        self.levels = (int(levels[0]), int(levels[1]))

    def _open(self) -> sqlite3.Connection:
        return sqlite3.connect(f"{self._path.resolve().as_uri()}?mode=ro", uri=True)

    def tile(self, level: int, column: int, row: int) -> bytes | None:
        """Return a tile, None where there is none."""
        query = "SELECT tile_data FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?"
        with closing(self._open()) as base:
            found = base.execute(query, (level, column, 2**level - 1 - row)).fetchone()
        return None if found is None else bytes(found[0])


class PmTiles:
    """Tiles of a PMTiles file of version 3 (github.com/protomaps/PMTiles)."""

    def __init__(self, path: Path) -> None:
        self._path = path
        head = self._read(0, 127)
        if len(head) < 127 or head[:7] != b"PMTiles" or head[7] != 3:
            raise ReadError(f"{path}: not a PMTiles file of version 3")
        values = _PMTILES.unpack_from(head)
        self._root, self._leaves, self._data = values[2:4], values[6], values[8]
        _, self._packed, _, kind, least, most = values[13:]
        if kind not in _RASTER:
            raise ReadError(f"{path} holds vector tiles: the background needs tiles of png, jpg or webp")
        if self._packed not in (_PLAIN, _GZIP):
            raise ReadError(f"{path}: its directories are packed by another method than gzip")
        self.levels = (least, most)
        self._directory = lru_cache(64)(self._read_directory)

    def _read(self, offset: int, length: int) -> bytes:
        with self._path.open("rb") as stream:
            stream.seek(offset)
            return stream.read(length)

    def _read_directory(self, offset: int, length: int) -> NDArray[np.int64]:
        """Return the entries of a directory: number of the first tile, run, length, offset."""
        data = self._read(offset, length)
        numbers = _varints(gzip.decompress(data) if self._packed == _GZIP else data)
        n = int(numbers[0])
        tile, run, size, place = numbers[1 : 1 + 4 * n].reshape(4, n)
        first, offsets = np.cumsum(tile), place - 1
        for i in np.flatnonzero(place == 0):  # it follows the one before
            offsets[i] = offsets[i - 1] + size[i - 1]
        return np.column_stack([first, run, size, offsets])

    def tile(self, level: int, column: int, row: int) -> bytes | None:
        """Return a tile, None where there is none."""
        number, (offset, length) = _hilbert(level, column, row), self._root
        for _ in range(4):
            entries = self._directory(offset, length)
            at = int(np.searchsorted(entries[:, 0], number, side="right")) - 1
            if at < 0:
                return None
            first, run, size, place = entries[at].tolist()
            if run:
                return self._read(self._data + place, size) if number < first + run else None
            offset, length = self._leaves + place, size
        return None


def _varints(data: bytes) -> NDArray[np.int64]:
    found, value, shift = [], 0, 0
    for byte in data:
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            found.append(value)
            value = shift = 0
    return np.array(found, np.int64)


def _hilbert(level: int, x: int, y: int) -> int:
    """Return the number of a tile in PMTiles: those of lower levels, then the place on the Hilbert curve."""
    found, side = (4**level - 1) // 3, 2**level // 2
    while side:
        right, low = int(bool(x & side)), int(bool(y & side))
        found += side * side * ((3 * right) ^ low)
        if not low:
            if right:
                x, y = side - 1 - (x & (side - 1)), side - 1 - (y & (side - 1))
            x, y = y, x
        x, y, side = x & (side - 1), y & (side - 1), side // 2
    return found


def mosaic(
    source: TileSource, area: tuple[float, float, float, float], resolution: float
) -> tuple[NDArray[np.uint8], tuple[float, float, float]]:
    """Return the tiles of an area of Web Mercator as RGBA, and west edge, north edge and pixel size of the picture.

    `area` is west, south, east, north; `resolution` the wanted size of a pixel, metres.
    """
    least, most = source.levels
    level = min(max(round(math.log2(2 * HALF / 256 / resolution)), least), most)
    while True:
        side = 2 * HALF / 2**level
        left, right = (int((value + HALF) // side) for value in (area[0], area[2]))
        top, bottom = (int((HALF - value) // side) for value in (area[3], area[1]))
        count = (right - left + 1) * (bottom - top + 1)
        if count <= _MOST_TILES or level == least:
            break
        level -= 1
    largest = 2 ** int(math.log2(math.sqrt(_MOST_PIXELS / count))) if count <= _MOST_AT_ALL else 0
    pictures = {
        (column, row): _decoded(data, largest)
        for column in range(max(left, 0), min(right, 2**level - 1) + 1 if largest else 0)
        for row in range(max(top, 0), min(bottom, 2**level - 1) + 1)
        if (data := source.tile(level, column, row)) is not None
    }
    if not pictures:
        return np.zeros((1, 1, 4), np.uint8), (left * side - HALF, HALF - top * side, side)
    size = max(len(picture) for picture in pictures.values())
    whole = np.zeros(((bottom - top + 1) * size, (right - left + 1) * size, 4), np.uint8)
    for (column, row), picture in pictures.items():
        y, x = (row - top) * size, (column - left) * size
        whole[y : y + len(picture), x : x + picture.shape[1]] = picture
    return whole, (left * side - HALF, HALF - top * side, side / size)


def _decoded(data: bytes, largest: int) -> NDArray[np.uint8]:
    """Return a tile with sides of at most a number of pixels."""
    try:
        tile = Image.open(io.BytesIO(data)).convert("RGBA")
    except (UnidentifiedImageError, Image.DecompressionBombError, OSError, SyntaxError) as error:
        raise ReadError(f"a tile of the background is damaged: {error}") from error
    wanted = min(largest, 512)
    return np.asarray(tile if max(tile.size) <= wanted else tile.resize((wanted, wanted), Image.Resampling.BOX))
