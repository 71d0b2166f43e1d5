"""NPZ and NPY: points as arrays of NumPy."""

import logging
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.column_names import ALIASES
from mlsroad_pipeline.formats.files import FileKey, atomic_file, check_expansion, file_key
from mlsroad_pipeline.formats.standard_columns import COLOURS, COORDINATES
from mlsroad_pipeline.formats.tables import PointTable, TableFormat

# Arrays whose first three columns have names, in lower case.
VECTORS = {
    **dict.fromkeys(("xyz", "points", "point", "positions", "pos", "coord", "coords", "coordinates"), COORDINATES),
    **dict.fromkeys(("rgb", "color", "colors", "colour", "colours"), COLOURS),
}
TIME_UNITS = ("W", "D", "h", "m", "s", "ms", "us", "ns")  # units of times of NumPy that have a fixed length
CRS = "crs"
DAY = 86_400  # seconds; smaller times may begin with each file
LARGEST_RATIO = 1100  # maximum compression ratio of Deflate, about 1,032 to 1: an entry above it is damaged
DAMAGE = (ValueError, EOFError, OSError, struct.error, zipfile.BadZipFile, zlib.error)
# Errors raised for a damaged header of an archive entry or an array.
MANGLED = (SyntaxError, tokenize.TokenError, KeyError, TypeError, RuntimeError)
LARGEST_WIDTH = 32  # largest number of columns of an array of coordinates and attributes with few points
EPOCH = (1980, 1, 1, 0, 0, 0)

logger = logging.getLogger(__name__)


class NpzFormat(TableFormat):
    """Reader and writer of NPZ, and reader of NPY.

    Every array with one row per point is a column; those of several columns are split, by name where it is known
    (``xyz``, ``points``, ``rgb``), by number otherwise. The fields of structured arrays are columns, too. The rows are
    those of the coordinates; arrays of another length, or without numbers, are left out and logged.
    """

    name = "NPZ"
    extensions: tuple[str, ...] = (".npz", ".npy")
    signatures: tuple[bytes, ...] = (b"PK\x03\x04", b"\x93NUMPY")

    def recognises(self, path: Path, head: bytes) -> bool:
        """Return whether a file is an array, or an archive of arrays."""
        if not head.startswith(self.signatures[0]):
            return head.startswith(self.signatures[1])
        with path.open("rb") as stream:
            stream.seek(26)
            length = int.from_bytes(stream.read(2), "little")
            stream.seek(30)
            return stream.read(min(length, 1 << 12)).endswith(b".npy")

    def open_table(self, path: Path, options: ReadOptions) -> PointTable:
        """Open a file; its arrays are held in memory."""
        return _open(file_key(path))

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write ``xyz`` (world coordinates, float64), one array per column and, where there is one, ``crs``."""
        path = Path(path)
        taken = sorted({"xyz", CRS} & set(cloud.columns))
        if path.suffix.lower() != ".npz" or taken:
            what = f"column {taken[0]!r} has a name that NPZ files need" if taken else "clouds are written as .npz"
            raise DataError(f"{path}: {what}")
        arrays = {"xyz": cloud.world_xyz() / options.metres, **cloud.columns}
        if cloud.crs:
            arrays[CRS] = np.array(cloud.crs)
        with atomic_file(path) as stream, zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, values in arrays.items():
                with archive.open(archive_entry(f"{name}.npy"), "w", force_zip64=True) as target:
                    np.lib.format.write_array(target, np.asarray(values, order="C"), allow_pickle=False)


def archive_entry(name: str) -> zipfile.ZipInfo:
    """Return a compressed entry of an archive without a date, so that the same points give the same bytes."""
    entry = zipfile.ZipInfo(name, EPOCH)
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry


@lru_cache(maxsize=1)
def _open(key: FileKey) -> PointTable:
    path = Path(key[0])
    try:
        if zipfile.is_zipfile(path):
            arrays = _archive(path)
        else:
            with path.open("rb") as stream:
                arrays = {"points": _array(stream, path.stat().st_size, path.name)}
    except ReadError:
        raise
    except (*DAMAGE, *MANGLED) as error:
        raise ReadError(f"{path} is damaged: {error}") from error
    crs = arrays.pop(CRS, None)
    notes = _stand_up(arrays)
    columns = _columns(arrays, path)

    def rows(names: Sequence[str], start: int, stop: int) -> Mapping[str, NDArray]:
        return {name: np.ascontiguousarray(columns[name][start:stop]) for name in names}

    n_points = len(columns["x"]) if "x" in columns else 0
    wkt = str(crs) if crs is not None and crs.dtype.kind == "U" and crs.shape == () else None
    details = {"arrays": {n: str(a.dtype) for n, a in arrays.items()}}
    return PointTable(tuple(columns), n_points, rows, wkt, details, notes, times=_times(columns))


def _times(columns: Mapping[str, NDArray]) -> str:
    """Return the array `time` where it holds dates or seconds of the week (PandaSet), not those of a turn."""
    if {"gps_time", *ALIASES["gps_time"]} & {name.lower() for name in columns} or "time" not in columns:
        return ""
    known = columns["time"][np.isfinite(columns["time"])]
    return "time" if len(known) and known.min() >= DAY else ""


def _stand_up(arrays: dict[str, NDArray]) -> tuple[str, ...]:
    """Transpose coordinates, and other arrays, that have one column per point; return a sentence on each."""
    notes = []
    lengths = {array.shape[1] for name, array in arrays.items() if _lies(name, array)}
    for name, array in arrays.items():
        if _lies(name, array) or (array.ndim == 2 and array.shape[1] in lengths and array.shape[0] < array.shape[1]):
            notes.append(f"array {name!r} of shape {array.shape} has one column per point and is transposed")
            arrays[name] = array.T
    return tuple(notes)


def _lies(name: str, array: NDArray) -> bool:
    """Return whether an array of coordinates has a row per axis: a handful of points has no dozens of attributes."""
    known = VECTORS.get(name.lower()) == COORDINATES and array.ndim == 2
    return known and array.shape[0] in (3, 4) and array.shape[1] > LARGEST_WIDTH


def _archive(path: Path) -> dict[str, NDArray]:
    arrays = {}
    with zipfile.ZipFile(path) as archive:
        unpacked = sum(entry.file_size for entry in archive.infolist() if entry.filename.endswith(".npy"))
        check_expansion(path, unpacked, path.stat().st_size)
        for entry in archive.infolist():
            if not entry.filename.endswith(".npy"):
                continue
            if entry.file_size > LARGEST_RATIO * max(entry.compress_size, 1):
                raise ValueError(f"{entry.filename} claims {entry.file_size} bytes in {entry.compress_size}")
            with archive.open(entry) as stream:
                arrays[entry.filename.removesuffix(".npy")] = _array(stream, entry.file_size, entry.filename)
    return arrays


def _array(stream: IO[bytes], size: int, name: str) -> NDArray:
    """Read one array; raise an error for a size beyond its bytes before memory is allocated."""
    version = np.lib.format.read_magic(stream)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran_order, dtype = read_header(stream)
    if dtype.hasobject:
        raise ValueError(f"{name} holds Python objects")
    n_bytes, size = dtype.itemsize, size - stream.tell()
    for length in shape:
        n_bytes *= length
    if min(shape, default=0) < 0 or n_bytes > size:
        raise ValueError(f"{name} claims {shape} values of {dtype} in {size} bytes")
    data = stream.read(n_bytes)
    if len(data) < n_bytes:
        raise ValueError(f"{name} ends after {len(data)} of {n_bytes} bytes")
    values: NDArray = np.frombuffer(data, dtype=dtype, count=n_bytes // max(dtype.itemsize, 1))
    return values.reshape(shape, order="F" if fortran_order else "C")


def _columns(arrays: Mapping[str, NDArray], path: Path) -> dict[str, NDArray]:
    """Split arrays into columns as long as the coordinates."""
    flat: dict[str, tuple[str, NDArray]] = {}
    for name, array in arrays.items():
        for part, values in _parts(name, array).items():
            flat.setdefault(part, (name, values))
    coordinates = next((v for n, (_, v) in flat.items() if n.lower() in COORDINATES), np.empty(0))
    flat = {name: (source, _seconds(v) if v.dtype.kind in "mM" else v) for name, (source, v) in flat.items()}
    columns = {name: v for name, (_, v) in flat.items() if v.dtype.kind in "biuf" and len(v) == len(coordinates)}
    lost = sorted(set(arrays) - {flat[name][0] for name in columns})
    if lost:
        logger.info("%s: arrays that are not columns of the points are left out: %s", path, ", ".join(lost))
    types = {n: np.dtype("u1") if v.dtype == np.bool_ else v.dtype.newbyteorder("=") for n, v in columns.items()}
    return {name: values.astype(types[name], copy=False) for name, values in columns.items()}


def _seconds(times: NDArray) -> NDArray:
    """Return dates as seconds since 1970, and durations as seconds; NaN where there is none."""
    if np.datetime_data(times.dtype)[0] not in TIME_UNITS:
        return times
    elapsed = times - np.datetime64(0, "s") if times.dtype.kind == "M" else times
    return np.asarray(elapsed / np.timedelta64(1, "s"))


def _parts(name: str, array: NDArray) -> dict[str, NDArray]:
    if array.dtype.names and array.ndim == 1:
        return {k: v for field in array.dtype.names for k, v in _parts(field, array[field]).items()}
    if array.ndim == 1:
        return {name: array}
    if array.ndim != 2:
        return {}
    known = VECTORS.get(name.lower(), ())
    numbered = "column" if known == COORDINATES else name
    names = [known[i] if i < len(known) and array.shape[1] >= 3 else f"{numbered}_{i}" for i in range(array.shape[1])]
    return {part: array[:, i] for i, part in enumerate(names)}
