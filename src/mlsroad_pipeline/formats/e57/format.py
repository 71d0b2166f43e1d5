"""E57 (ASTM E2807): the scans of a file as one cloud."""

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.crs import parsed_crs
from mlsroad_pipeline.formats.e57.pages import E57Pages
from mlsroad_pipeline.formats.e57.scans import NAMESPACE, E57Scan, parse_xml, read_field, read_scans
from mlsroad_pipeline.formats.e57.writer import write_e57
from mlsroad_pipeline.formats.files import FileKey, atomic_file, file_key, refuse_packed, spread_starts, with_packed
from mlsroad_pipeline.formats.standard_columns import COLOURS, COORDINATES, FULL, ORIGINAL
from mlsroad_pipeline.formats.tables import PointTable, TableFormat, scalar_columns

CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
INVALID = ("cartesianInvalidState", "sphericalInvalidState")
NAMES = {"colorRed": "red", "colorGreen": "green", "colorBlue": "blue", "timeStamp": "gps_time"}
SCAN = "scan"
CHUNK = 1_000_000
# Number and length of the runs of points whose intensities are compared with the stated limits.
SAMPLES, SAMPLE_SIZE = 8, 2000
logger = logging.getLogger(__name__)


class E57Format(TableFormat):
    """Reader and writer of E57.

    The scans are joined in their order; `scan` is the number of each point's scan where there are several. Poses are
    applied, angles and ranges become coordinates, time stamps count from the scan's start, intensity and colours are
    scaled by the limits of the scan. Points flagged as invalid are left out and their
    number is logged; an intensity flagged invalid is NaN. Every page that is read is checked against its checksum.
    """

    name = "E57"
    extensions: tuple[str, ...] = with_packed(".e57")
    signatures: tuple[bytes, ...] = (b"ASTM-E57",)

    def open_table(self, path: Path, options: ReadOptions) -> PointTable:
        """Open a file; stated limits of intensity apply where `intensity_scale` is ``"dtype"``."""
        return _open(file_key(path), options.intensity_scale in ("dtype", "auto"))

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write a cloud as one scan without a pose, coordinates in float64, in metres.

        Columns outside the standard keep their names.
        """
        refuse_packed(Path(path), self.name)
        own = dict(zip(COORDINATES, CARTESIAN, strict=True)) | {name: key for key, name in NAMES.items()}
        columns = {own.get(name, name): values for name, values in scalar_columns(cloud, options.metres).items()}
        with atomic_file(Path(path)) as stream:
            write_e57(stream, columns, crs=cloud.crs, source=str(path))


class _Scan:
    """The valid points of one scan."""

    def __init__(self, pages: E57Pages, scan: E57Scan, number: int, *, limits: bool) -> None:
        self._pages, self._scan, self._number, self._limits = pages, scan, number, limits
        self._fields = {field.name: field for field in scan.fields if field.kind != "String"}
        self._last: tuple[tuple[int, int], NDArray[np.float64]] = ((-1, -1), np.empty((0, 3)))
        self._kept = self._valid()
        self.n_records = scan.n_points
        self.n_points = scan.n_points if self._kept is None else len(self._kept)
        self.notes = [*scan.notes]
        self._widened = False
        self._intensities = self._intensity_limits()
        self.types = self._types()

    def _valid(self) -> NDArray[np.int64] | None:
        name = next((name for name in INVALID if name in self._fields), None)
        if name is None:
            return None
        kept = []
        for start in range(0, self._scan.n_points, CHUNK):
            stop = min(start + CHUNK, self._scan.n_points)
            kept.append(start + np.flatnonzero(self._raw(name, start, stop) == 0))
        index = np.concatenate(kept) if kept else np.empty(0, np.int64)
        return None if len(index) == self._scan.n_points else index

    def stored(self, start: int, stop: int) -> list[NDArray]:
        """Return the coordinates of a range of the valid points in the type of the file; none where they are angles."""
        if not set(CARTESIAN) <= self._fields.keys():
            return []
        return [self._of_kept(partial(self._raw, name), start, stop) for name in CARTESIAN]

    def _of_kept(self, read: Callable[[int, int], NDArray], start: int, stop: int) -> NDArray:
        """Return the values of a range of the valid points from a function of a range of records."""
        if self._kept is None:
            return read(start, stop)
        index = self._kept[start:stop]
        return read(int(index[0]), int(index[-1]) + 1)[index - index[0]] if len(index) else read(0, 0)

    def _raw(self, name: str, start: int, stop: int) -> NDArray:
        return read_field(self._pages, self._scan, name, start, stop)

    def _types(self) -> dict[str, np.dtype]:
        types = {axis: np.dtype("f8") for axis in COORDINATES}
        hidden = {*CARTESIAN, *SPHERICAL, *INVALID}
        for name, field in self._fields.items():
            if name not in hidden:
                given = NAMES.get(name, name)
                types[given] = self.column(given, 0, 0).dtype if name in ("intensity", *NAMES) else field.dtype
        if self._widened:
            types[ORIGINAL] = self._fields["intensity"].dtype
        if not (set(CARTESIAN) <= self._fields.keys() or set(SPHERICAL) <= self._fields.keys()):
            have = ", ".join(self._fields) or "none"
            raise ReadError(f"{self._pages.path}: scan {self._number} has no coordinates (fields: {have})")
        return types

    def column(self, name: str, start: int, stop: int) -> NDArray:
        """Return a column for a range of the valid points."""
        return self._of_kept(partial(self._column, name), start, stop)

    def _column(self, name: str, start: int, stop: int) -> NDArray:
        if name in COORDINATES:
            return self._coordinate(COORDINATES.index(name), start, stop)
        field = next((key for key, given in NAMES.items() if given == name), name)
        values = self._raw("intensity" if name == ORIGINAL and self._widened else field, start, stop)
        if name == "gps_time":
            return values.astype(np.float64) + self._scan.start
        if name in COLOURS:
            return self._colour(values, field)
        return self._intensity(values, start, stop) if name == "intensity" else values

    def _coordinate(self, axis: int, start: int, stop: int) -> NDArray[np.float64]:
        weights, moved = self._scan.rotation[axis], self._scan.translation[axis]
        if set(CARTESIAN) <= self._fields.keys() and np.array_equal(self._scan.rotation, np.eye(3)):
            values = self._raw(CARTESIAN[axis], start, stop).astype(np.float64)
            return values + moved if moved else values
        if self._last[0] != (start, stop):
            self._last = ((start, stop), self._local(start, stop))
        turned: NDArray[np.float64] = self._last[1] @ weights + moved
        return turned

    def _local(self, start: int, stop: int) -> NDArray[np.float64]:
        if set(CARTESIAN) <= self._fields.keys():
            return np.stack([self._raw(name, start, stop).astype(np.float64) for name in CARTESIAN], axis=1)
        distance, azimuth, elevation = (self._raw(name, start, stop).astype(np.float64) for name in SPHERICAL)
        flat = distance * np.cos(elevation)
        return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)], axis=1)

    def _colour(self, values: NDArray, field: str) -> NDArray:
        spec = self._fields[field]
        greatest = self._scan.limits.get(f"{field}Maximum", spec.maximum)
        if values.dtype.kind == "f" and not np.isfinite(greatest):
            return values
        if values.dtype.kind == "f" and greatest <= 1:
            values = np.rint(values * 255)
        return values.astype(np.uint8 if greatest <= 255 else np.uint16)

    def _intensity_limits(self) -> tuple[float, float] | None:
        """Return the values that become 0 and 1: the stated limits, or wider ones where intensities exceed these."""
        if "intensity" not in self._fields or not self._limits:
            return None
        spec, limits = self._fields["intensity"], self._scan.limits
        scaled = spec.kind != "Integer"
        low = limits.get("intensityMinimum", spec.minimum * spec.scale + spec.offset if scaled else spec.minimum)
        high = limits.get("intensityMaximum", spec.maximum * spec.scale + spec.offset if scaled else spec.maximum)
        if not (np.isfinite([low, high]).all() and high > low):
            return None
        found = self._intensity_extremes(spread_starts(self._scan.n_points, SAMPLES, SAMPLE_SIZE), SAMPLE_SIZE)
        slack = (high - low) * 1e-6
        if low - slack <= found[0] and found[1] <= high + slack:
            return low, high
        found = self._intensity_extremes(range(0, self._scan.n_points, CHUNK), CHUNK)
        self._widened = True
        wider = (min(low, found[0]), next((full for full in FULL if found[1] <= full), found[1]))
        self.notes.append(
            f"scan {self._number} states intensities from {low:g} to {high:g} and has {found[0]:g} to {found[1]:g}: "
            f"{wider[0]:g} to {wider[1]:g} are mapped to 0 to 1"
        )
        return wider

    def _intensity_extremes(self, starts: Iterable[int], size: int) -> tuple[float, float]:
        low, high = np.inf, -np.inf
        for start in starts:
            values = self._raw("intensity", start, min(start + size, self._scan.n_points))
            values = values[np.isfinite(values)]
            if len(values):
                low, high = min(low, float(values.min())), max(high, float(values.max()))
        return low, high

    def _intensity(self, values: NDArray, start: int, stop: int) -> NDArray:
        if self._intensities is not None:
            low, high = self._intensities
            values = np.clip((values.astype(np.float64) - low) / (high - low), 0.0, 1.0)
        if "isIntensityInvalid" in self._fields:
            flags = self._raw("isIntensityInvalid", start, stop)
            values = np.where(flags != 0, np.nan, values)
        return values


@lru_cache(maxsize=4)
def _open(key: FileKey, limits: bool) -> PointTable:
    path = Path(key[0])
    pages = E57Pages(path)
    root = parse_xml(pages)
    scans = [_Scan(pages, scan, i, limits=limits) for i, scan in enumerate(read_scans(pages, root))]
    if not scans:
        raise ReadError(f"{path} has no scans")
    ends = np.cumsum([scan.n_points for scan in scans])
    total = sum(scan.n_records for scan in scans)
    n_invalid = total - int(ends[-1])
    if n_invalid:
        logger.info("%s: %d of %d points are flagged invalid; they are left out", path, n_invalid, total)
    types = _joined_types(scans, path)

    def rows(names: Sequence[str], start: int, stop: int) -> Mapping[str, NDArray]:
        return {name: _joined(scans, ends, name, types[name], (start, max(start, stop))) for name in names}

    details = {"scans": len(scans), "invalid": n_invalid, "guid": root.findtext(NAMESPACE + "guid")}
    notes = tuple(dict.fromkeys(note for scan in scans for note in scan.notes))
    stored = tuple((scan.stored, scan.n_points) for scan in scans)
    return PointTable(tuple(types), int(ends[-1]), rows, _crs(root), details, notes, stored=stored)


def _joined_types(scans: Sequence[_Scan], path: Path) -> dict[str, np.dtype]:
    """Return the columns of all scans; one that a scan lacks is NaN there, colours are black."""
    types: dict[str, np.dtype] = {}
    partial = []
    for name in {name: None for scan in scans for name in scan.types}:
        present = [scan.types[name] for scan in scans if name in scan.types]
        types[name] = np.result_type(*present)
        if len(present) < len(scans):
            partial.append(name)
            if name not in COLOURS:
                types[name] = np.result_type(types[name], np.dtype("f4"))
    if partial:
        logger.warning("%s: only some of its scans have %s; the others get NaN, or black", path, ", ".join(partial))
    if len(scans) > 1 and SCAN not in types:
        types[SCAN] = np.dtype("i4")
    return types


def _joined(scans: Sequence[_Scan], ends: NDArray, name: str, dtype: np.dtype, span: tuple[int, int]) -> NDArray:
    start, stop = span
    out = np.empty(stop - start, dtype=dtype)
    for number, (scan, end) in enumerate(zip(scans, ends.tolist(), strict=True)):
        begin = end - scan.n_points
        low, high = max(start, begin), min(stop, end)
        if low >= high:
            continue
        if name in scan.types:
            out[low - start : high - start] = scan.column(name, low - begin, high - begin)
        else:
            missing: Any = number if name == SCAN else 0 if name in COLOURS else np.nan
            out[low - start : high - start] = missing
    return out


def _crs(root: Any) -> str | None:
    """Return the CRS in the file's coordinate metadata, if any."""
    text = (root.findtext(NAMESPACE + "coordinateMetadata") or "").strip()
    if not text:
        return None
    crs = parsed_crs(text)
    if crs is None:
        logger.info("PROJ cannot parse its coordinate metadata as a CRS: %.80s", text)
    return None if crs is None else str(crs.to_wkt())
