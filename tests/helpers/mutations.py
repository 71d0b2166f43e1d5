"""Damaged content of files: bytes, values of JSON, cells of tables."""

import copy
import json
import struct

import numpy as np

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
