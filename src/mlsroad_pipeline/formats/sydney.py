"""Sydney Urban Objects (De Deuge et al. 2013): one scanned object a file, as packed records or as text.

Both forms have the fields t, intensity, id, x, y, z, azimuth, range and pid, without names. Files have no signature;
their content identifies them: times of day, and ranges that agree with the coordinates.
"""

import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MissingColumnError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.files import FileKey, file_key, write_atomic
from mlsroad_pipeline.formats.tables import PointTable, TableFormat

RECORD = np.dtype(
    [
        *(("t", "<i8"), ("intensity", "u1"), ("id", "u1"), ("x", "<f4"), ("y", "<f4"), ("z", "<f4")),
        *(("azimuth", "<f4"), ("range", "<f4"), ("pid", "<i4")),
    ]
)
# Columns that are read: the time is in seconds, all others are unchanged.
NAMES = ("gps_time", *(RECORD.names or ())[1:])
MICRO = 1e-6
# Microseconds since 1970 of the years 1990 and 2100: times outside are invalid.
EARLIEST, LATEST = 631_152_000_000_000, 4_102_444_800_000_000
PROBED = 64  # records whose ranges are compared with their coordinates
RANGE_SLACK = 0.05  # metres that a range may differ from the length of its vector, by the calibration of the lasers
TIME_TEXT = re.compile(rb"\d{8}T\d{6}(\.\d{1,6})?,")


def object_class(path: str | Path) -> str:
    """Return the class of an object: the first part of its file's name, ``<class>.<instance>.<scan>.bin``."""
    parts = Path(path).name.split(".")
    if len(parts) < 4 or not parts[0] or not all(part.isdigit() for part in parts[1:3]):
        raise ReadError(f"{path} is not named <class>.<instance>.<scan>.bin, so its class is unknown")
    return parts[0]


class SydneyFormat(TableFormat):
    """Reader and writer of Sydney Urban Objects.

    Columns are `gps_time` (seconds since 1970, float64), `intensity` (float32 in [0, 1]), `id` (laser, uint8),
    `azimuth` (radians, float32), `range` (metres, float32) and `pid` (number of the point in its scan, int32). The
    class is in the name of the file: `object_class`.
    """

    name = "Sydney"
    extensions: tuple[str, ...] = (".bin", ".csv")
    signatures: tuple[bytes, ...] = ()

    def recognises(self, path: Path, head: bytes) -> bool:
        """Return whether a file's records have plausible times, and ranges that agree with their coordinates."""
        if path.suffix.lower() == ".csv":
            with path.open("rb") as stream:
                line = stream.readline(1000)
            return TIME_TEXT.match(line) is not None and line.count(b",") == len(NAMES) - 1
        if path.suffix.lower() != ".bin" or path.stat().st_size < RECORD.itemsize:
            return False
        records = np.fromfile(path, dtype=RECORD, count=PROBED)
        with np.errstate(all="ignore"):  # bytes of other formats are arbitrary numbers
            xyz = np.stack([records[axis] for axis in "xyz"], axis=1).astype(np.float64)
            near = np.abs(np.linalg.norm(xyz, axis=1) - records["range"]) <= RANGE_SLACK
        return bool((near & (records["t"] > EARLIEST) & (records["t"] < LATEST)).mean() > 0.5)

    def open_table(self, path: Path, options: ReadOptions) -> PointTable:
        """Open a file of objects."""
        if path.suffix.lower() == ".csv":
            table = _text_records(file_key(path))
            return PointTable(NAMES, len(table["x"]), lambda names, a, b: {n: table[n][a:b] for n in names})
        size = path.stat().st_size
        if size % RECORD.itemsize:
            raise ReadError(
                f"{path} is truncated: {size} bytes, no multiple of the {RECORD.itemsize} of a Sydney record"
            )
        records = np.memmap(path, dtype=RECORD, mode="r")

        def rows(names: Sequence[str], start: int, stop: int) -> Mapping[str, NDArray]:
            return {
                name: records["t"][start:stop] * MICRO if name == "gps_time" else np.array(records[name][start:stop])
                for name in names
            }

        return PointTable(NAMES, len(records), rows)

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write packed records."""
        columns = [name for name in NAMES if name not in "xyz"]
        lost = sorted(set(cloud.columns) - set(columns))
        if lost:
            raise DataError(f"{path}: Sydney records cannot hold {', '.join(lost)}; drop them or write LAZ or PLY")
        missing = [name for name in columns if name not in cloud]
        if missing:
            raise MissingColumnError(f"{path}: Sydney records need {', '.join(missing)}, which {cloud.source} lacks")
        records = np.empty(len(cloud), dtype=RECORD)
        world = cloud.world_xyz() / options.metres
        for axis, name in enumerate("xyz"):
            records[name] = world[:, axis]
        scaled = {"t": cloud["gps_time"] / MICRO, "intensity": cloud["intensity"].astype(np.float64) * 255}
        for name in ("t", "intensity", "id", "azimuth", "range", "pid"):
            values = np.rint(scaled[name]) if name in scaled else cloud[name]
            _store(records, name, values, path)
        write_atomic(path, records.tobytes())


def _store(records: NDArray, name: str, values: NDArray, path: Path) -> None:
    dtype = records.dtype[name]
    if dtype.kind in "iu" and len(values):
        limits = np.iinfo(dtype)
        if not limits.min <= values.min() <= values.max() <= limits.max:
            raise DataError(f"{path}: {name} {values.min()} to {values.max()} does not fit the record's {dtype} field")
    records[name] = values


@lru_cache(maxsize=8)
def _text_records(key: FileKey) -> dict[str, NDArray]:
    """Return the columns of a text file; times such as 20111104T013210.881031 are read as UTC."""
    path = Path(key[0])
    types = {"gps_time": pa.string(), **{name: pa.from_numpy_dtype(RECORD[name]) for name in NAMES[1:]}}
    try:
        table = pa.csv.read_csv(
            path,
            read_options=pa.csv.ReadOptions(column_names=list(NAMES), use_threads=False),
            convert_options=pa.csv.ConvertOptions(column_types=types),
        )
        text = table["gps_time"].combine_chunks()
        whole = pc.strptime(pc.utf8_slice_codeunits(text, 0, 15), format="%Y%m%dT%H%M%S", unit="us")
        fraction = pc.utf8_slice_codeunits(pc.utf8_rpad(pc.utf8_slice_codeunits(text, 16), 6, "0"), 0, 6)
        micro = pc.add(whole.cast(pa.int64()), fraction.cast(pa.int64()))
    except (pa.ArrowInvalid, OSError) as error:
        raise ReadError(f"{path} is damaged: {error}") from error
    columns = {name: table[name].to_numpy() for name in NAMES[1:]}
    return {"gps_time": micro.to_numpy(zero_copy_only=False) * MICRO, **columns}
