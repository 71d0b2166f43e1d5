"""Damaged content of files: bytes, values of JSON, cells of tables."""

import copy
import json
import sqlite3
import struct
from contextlib import closing

import numpy as np
import shapely

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError

HUGE = (b"\xff\xff\xff\xff", b"\x00\x00\x00\x80", b"\xff\xff\xff\x7f", b"\x00\x00\x00\x00", struct.pack("<d", 1e300))
VALUES = (None, True, -1, 0, 1, 2**31, 2**63, 1e308, 0.5, "", "x", "1e400", "NaN", [], {}, [1], [[1, 2]], {"a": 1})
CELLS = ("", "x", "-1", "0", "nan", "inf", "1e308", "1e400", "9" * 25, "0.5", '"', "1,2", "\0", "é", "True", "-")


def mutated(data, rng):
    """Return damaged content: cut, flipped, overwritten, repeated, or with numbers that make no sense."""
    data = bytearray(data)
    kind = int(rng.integers(8))
    early = int(rng.integers(min(len(data), 600)))  # headers matter more than points
    at = early if rng.random() < 0.7 else int(rng.integers(len(data)))
    if kind == 0:
        return bytes(data[:at])
    if kind == 1:
        for place in rng.integers(0, len(data), rng.integers(1, 20)):
            data[place] ^= 1 << int(rng.integers(8))
    elif kind == 2:
        data[at] ^= 1 << int(rng.integers(8))
    elif kind == 3:
        value = HUGE[int(rng.integers(len(HUGE)))]
        data[at : at + len(value)] = value
    elif kind == 4:
        data[at : at + 8] = struct.pack("<d", [np.nan, np.inf, -1e308, 1e-300][int(rng.integers(4))])
    elif kind == 5:
        del data[at : at + int(rng.integers(1, 200))]
    elif kind == 6:
        data[at:at] = data[at : at + int(rng.integers(1, 200))]
    else:
        digits = [i for i in range(min(len(data), 600)) if 48 <= data[i] < 58]
        if digits:
            place = digits[int(rng.integers(len(digits)))]
            data[place : place + 1] = [b"99999999999", b"-1", b"nan", b"", b"0"][int(rng.integers(5))]
    return bytes(data)


def _places(value, path=()):
    """Return the paths of all values inside a JSON value."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(place for key, item in items for place in _places(item, (*path, key)))]


def mutated_value(value, rng):
    """Return a copy of a JSON value in which one value is another one, missing or repeated."""
    value = copy.deepcopy(value)
    places = _places(value)
    path = places[int(rng.integers(1, len(places)))]
    parent = value
    for key in path[:-1]:
        parent = parent[key]
    kind = int(rng.integers(4))
    if kind == 0:
        del parent[path[-1]]
    elif kind == 1 and isinstance(parent, list):
        parent.append(copy.deepcopy(parent[path[-1]]))
    else:
        parent[path[-1]] = copy.deepcopy(VALUES[int(rng.integers(len(VALUES)))])
    return value


def mutated_json(data, rng):
    """Return damaged JSON, which mostly still is JSON."""
    if rng.random() < 0.3:
        return mutated(data, rng)
    return json.dumps(mutated_value(json.loads(data), rng)).encode()


def mutated_table(data, rng):
    """Return a damaged text table: another cell, a row or column missing, or other bytes."""
    if rng.random() < 0.3:
        return mutated(data, rng)
    mark = "," if b"," in data else " "
    rows = [line.split(mark) for line in data.decode().splitlines()]
    row, kind = rows[int(rng.integers(len(rows)))], int(rng.integers(6))
    at = int(rng.integers(len(row)))
    if kind == 0:
        del row[at]
    elif kind == 1:
        rows.remove(row)
    elif kind == 2:
        rows.append(row)
    else:
        row[at] = CELLS[int(rng.integers(len(CELLS)))]
    return "\n".join(mark.join(cells) for cells in rows).encode()


SHAPES = (
    "POINT Z (0 0 0)", "POINT EMPTY", "POINT (500 900)", "POINT Z (1e308 900 12)", "POINT (NaN NaN)", "LINESTRING EMPTY",
    "LINESTRING Z (500 895 12, 510 895 12)", "LINESTRING (0 0, 0 0)", "LINESTRING Z (500 895 NaN, 1e300 0 0)",
    "MULTIPOINT ((500 900), (1 2))", "MULTILINESTRING ((500 895, 510 895), (520 895, 530 895))", "POLYGON EMPTY",
    "POLYGON ((0 0, 1 1, 0 1, 1 0, 0 0))", "GEOMETRYCOLLECTION (POINT (500 900), LINESTRING (0 0, 1 1))",
)  # fmt: skip


def _geometry(rng):
    """Return a geometry as a GeoPackage holds it."""
    shape = shapely.from_wkt(SHAPES[int(rng.integers(len(SHAPES)))])
    return b"GP\0\1" + struct.pack("<i", 25832) + shapely.to_wkb(shape, byte_order=1)


def _damage_table(base, rng):
    """Change a cell, a row or a column of a table of an SQLite file; layers are chosen more often than others."""
    names = [name for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table' AND sql > ''")]
    layers = [name for (name,) in base.execute("SELECT table_name FROM gpkg_contents") if name in names]
    table = rng.choice(layers if layers and rng.random() < 0.9 else names)
    columns = {row[1]: row[2] for row in base.execute(f'PRAGMA table_info("{table}")')}
    column, kind = str(rng.choice(list(columns))), int(rng.integers(8))
    where = f'WHERE rowid = (SELECT rowid FROM "{table}" ORDER BY rowid LIMIT 1 OFFSET {int(rng.integers(6))})'
    kept = ", ".join(f'"{name}"' for name in list(columns)[1:])
    if kind == 0:
        base.execute(f'DELETE FROM "{table}" {where if rng.random() < 0.8 else ""}')
    elif kind == 1:
        base.execute(f'INSERT INTO "{table}" ({kept}) SELECT {kept} FROM "{table}" {where}')
    elif kind == 2:
        base.execute(
            f'ALTER TABLE "{table}" {rng.choice(["DROP", "RENAME"])} COLUMN "{column}"'
            + " TO other" * (rng.random() < 0.5)
        )
    else:
        column = next((c for c in columns if c in ("geom", "geometry")), column) if kind > 5 else column
        known = [value for (value,) in base.execute(f'SELECT "{column}" FROM "{table}"')]
        other = (
            VALUES[int(rng.integers(len(VALUES)))]
            if rng.random() < 0.5 or not known
            else known[int(rng.integers(len(known)))]
        )
        value = _geometry(rng) if kind > 5 else mutated(other, rng) if isinstance(other, bytes) else other
        value = value if isinstance(value, bytes | None | int | float | str) else str(value)
        base.execute(f'UPDATE "{table}" SET "{column}" = ? {where}', (value,))


def mutated_geopackage(data, rng):
    """Return a damaged GeoPackage, which mostly still is an SQLite file: cells, rows, columns, geometries."""
    if rng.random() < 0.1:
        return mutated(data, rng)
    try:
        with closing(sqlite3.connect(":memory:")) as base:
            base.deserialize(data)
            for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
                base.execute(f'DROP TRIGGER "{name}"')  # those of the index need functions of GDAL
            for _ in range(int(rng.integers(1, 4))):
                _damage_table(base, rng)
            base.commit()
            return base.serialize()
    except (sqlite3.Error, OverflowError):
        return mutated(data, rng)


def mutated_arrays(arrays, rng):
    """Return named arrays in which one has other values, another shape or type, or is missing."""
    arrays = {name: np.array(values) for name, values in arrays.items()}
    name = list(arrays)[int(rng.integers(len(arrays)))]
    values, kind = arrays[name], int(rng.integers(7))
    if kind == 0:
        del arrays[name]
    elif kind == 1 and values.ndim:
        arrays[name] = values[: int(rng.integers(len(values)))] if len(values) else np.zeros(3)
    elif kind == 2:
        arrays[name] = values[..., None] if rng.random() < 0.5 else np.concatenate([values.ravel()] * 2)
    elif kind == 3:
        arrays[name] = values.astype(["f4", "i8", "u1", "U5", "c8"][int(rng.integers(5))])
    elif values.size:
        flat = values.reshape(-1)
        worst = [np.nan, np.inf, -1e300, 1e300] if values.dtype.kind == "f" else [-1, 2**31 - 1, -(2**31), 255]
        with np.errstate(over="ignore"):
            places = rng.integers(flat.size, size=1 if kind == 4 else max(1, flat.size // 4))
            flat[places] = np.array(worst[int(rng.integers(4))]).astype(values.dtype)
    return arrays


def refusals(path, damage, reader, n_cases):
    """Read a file with damaged content so many times; return how often it is refused, in one line that names the file."""
    sound, refused = path.read_bytes(), 0
    reader(path)
    for case in range(n_cases):
        rng = np.random.default_rng([case, len(path.name)])
        path.write_bytes(damage(sound, rng))
        try:
            reader(path)
        except MlsRoadError as error:
            text = str(error)
            assert path.name in text or str(path.parent) in text, f"case {case}: {error}"
            assert text.isprintable(), f"case {case}: {error!r}"
            refused += 1
        except Exception as error:
            raise AssertionError(f"{path}, case {case}: {type(error).__name__}: {error}") from error
    return refused
