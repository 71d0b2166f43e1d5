"""Files with a background of the map: GeoTIFF, MBTiles and PMTiles, written without the code of the package."""

import gzip
import io
import math
import sqlite3
import struct
from contextlib import closing

from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

HALF = math.pi * 6378137.0


def write_geotiff(path, picture, west, north, size, *, epsg=None, point=False):
    """Write an array as GeoTIFF; `west` and `north` are the upper left corner, or centre of the first pixel."""
    tags = ImageFileDirectory_v2()
    for tag, kind, values in ((33550, 12, (size, size, 0.0)), (33922, 12, (0.0, 0.0, 0.0, west, north, 0.0))):
        tags.tagtype[tag] = kind
        tags[tag] = values
    if epsg is not None:
        keys = (1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 2 if point else 1, 3072, 0, 1, epsg)
        tags.tagtype[34735] = 3
        tags[34735] = keys
    Image.fromarray(picture).save(path, "TIFF", tiffinfo=tags, compression="tiff_deflate")


def tiles_of(level, area, colour):
    """Return the encoded tiles of an area of Web Mercator by column and row; `colour` gives that of x, y arrays."""
    import numpy as np

    side = 2 * HALF / 2**level
    found = {}
    for column in range(int((area[0] + HALF) // side), int((area[2] + HALF) // side) + 1):
        for row in range(int((HALF - area[3]) // side), int((HALF - area[1]) // side) + 1):
            steps = (np.arange(256) + 0.5) / 256 * side
            x, y = np.meshgrid(column * side - HALF + steps, HALF - row * side - steps)
            stream = io.BytesIO()
            Image.fromarray(colour(x, y)).save(stream, "PNG")
            found[column, row] = stream.getvalue()
    return found


def write_mbtiles(path, level, tiles, *, kind="png"):
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("CREATE TABLE metadata (name TEXT, value TEXT)")
        base.execute("INSERT INTO metadata VALUES ('format', ?)", (kind,))
        base.execute("CREATE TABLE tiles (zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER, tile_data BLOB)")
        rows = [(level, column, 2**level - 1 - row, data) for (column, row), data in tiles.items()]
        base.executemany("INSERT INTO tiles VALUES (?, ?, ?, ?)", rows)


def write_pmtiles(path, level, tiles, *, leaves=False):
    """Write PMTiles of version 3; with `leaves` the root directory points to one further directory."""
    numbered = sorted((number(level, *place), data) for place, data in tiles.items())
    entries, offset = [], 0
    for first, data in numbered:
        entries.append((first, 1, len(data), offset))
        offset += len(data)
    whole = b"".join(data for _, data in numbered)
    own = gzip.compress(directory(entries))
    root, leaf = (gzip.compress(directory([(entries[0][0], 0, len(own), 0)])), own) if leaves else (own, b"")
    at = 127 + len(root)
    head = struct.pack(
        "<7sB11Q6B", b"PMTiles", 3, 127, len(root), at, 0, at, len(leaf), at + len(leaf), len(whole),
        len(entries), len(entries), len(entries), 1, 2, 1, 2, level, level,
    )  # fmt: skip
    path.write_bytes(head.ljust(127, b"\0") + root + leaf + whole)


def directory(entries):
    """Return a directory: number of entries, differences of numbers, runs, lengths, offsets + 1."""
    firsts = [entry[0] for entry in entries]
    steps = [b - a for a, b in zip([0, *firsts[:-1]], firsts, strict=True)]
    values = [len(entries), *steps, *(e[1] for e in entries), *(e[2] for e in entries), *(e[3] + 1 for e in entries)]
    return b"".join(map(varint, values))


def varint(value):
    parts = []
    while value > 127:
        parts.append(value % 128 + 128)
        value //= 128
    return bytes([*parts, value])


def number(level, x, y):
    """Return the number of a tile: it walks along the curve of the level, as its definition does."""
    before = sum(4**k for k in range(level))
    d, rx, ry, s = 0, 0, 0, 2 ** (level - 1)
    while s > 0:
        rx, ry = int((x & s) > 0), int((y & s) > 0)
        d += s * s * ((3 * rx) ^ ry)
        if ry == 0:
            if rx == 1:
                x, y = 2**level - 1 - x, 2**level - 1 - y
            x, y = y, x
        s //= 2
    return before + d
