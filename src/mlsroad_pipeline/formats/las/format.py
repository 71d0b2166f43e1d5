"""LAS and LAZ, versions 1.0 to 1.5, point formats 0 to 10."""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats import files
from mlsroad_pipeline.formats.base import BY_CRS, FileInfo, PointFormat, ReadOptions, WriteOptions
from mlsroad_pipeline.formats.column_names import resolve_columns
from mlsroad_pipeline.formats.crs import auto_note, in_metres, with_units
from mlsroad_pipeline.formats.las.copc import SUFFIX, is_copc, without_copc, write_copc
from mlsroad_pipeline.formats.las.crs import read_crs, two_systems_note, with_crs_of
from mlsroad_pipeline.formats.las.dimensions import (
    Depths,
    colour_bits,
    dimension,
    dimension_names,
    local_xyz,
    near_corner,
    sampled_maximum,
)
from mlsroad_pipeline.formats.las.header import LasHeader, read_header
from mlsroad_pipeline.formats.las.layout import header_like, new_header, pack_records, with_room
from mlsroad_pipeline.formats.las.records import RecordReader, layers_of
from mlsroad_pipeline.formats.las.writer import RecordWriter
from mlsroad_pipeline.formats.standard_columns import COLOUR_DEPTH, COLOURS, COORDINATES, origin_near, standard_cloud
from mlsroad_pipeline.formats.tables import parts_of

CHUNK = 1_000_000


class LasFormat(PointFormat):
    """Reader and writer of LAS and LAZ.

    Columns have the names of the dimensions in laspy; `intensity` becomes float32 in [0, 1], `red`, `green` and `blue`
    become `rgb` (uint8, with the 16-bit values beside it as `rgb16` where the file uses them), scaled extra dimensions
    become float64. A file without points gives an empty cloud.
    """

    name = "LAS"
    extensions: tuple[str, ...] = files.with_packed(".las", ".laz")
    signatures: tuple[bytes, ...] = (b"LASF",)

    def info(self, path: Path, options: ReadOptions) -> FileInfo:
        """Return the contents of a file's header."""
        path = files.check_file(path)
        header = read_header(path)
        crs = read_crs(header, path)
        notes = [*header.notes, auto_note(options, crs, path), two_systems_note(header)]
        options = with_units(options, crs, path)
        sample = self._cloud(path, header, options, 0, 0, notes)
        columns = {name: values.dtype for name, values in sample.columns.items()}
        bounds = header.bounds * options.factors if header.n_points and options.reproject is None else None
        details = {
            "version": f"1.{header.minor}",
            "point_format": header.point_format,
            "compressed": header.compressed,
            "cloud_optimised": is_copc(header),
            "scale": header.scale,
            "offset": header.offset,
            "created": (header.integer("year"), header.integer("day")),
            "gps_time": "adjusted standard" if header.integer("encoding") & 1 else "week",
            "software": bytes(header.fields["software"]).split(b"\0")[0].decode("utf-8", "replace"),
        }
        warnings = tuple(text for text in notes if text)
        return FileInfo(
            *(path, self.name, header.n_points, columns, sample.origin, sample.crs, bounds, details), notes=warnings
        )

    def read(self, path: Path, options: ReadOptions, *, start: int = 0, stop: int | None = None) -> PointCloud:
        """Read a range of rows."""
        path = files.check_file(path)
        header = read_header(path)
        options = with_units(options, read_crs(header, path), path)
        return self._cloud(path, header, options, *files.clip_range(start, stop, header.n_points))

    def _cloud(
        self, path: Path, header: LasHeader, options: ReadOptions, start: int, stop: int, notes: list[str] | None = None
    ) -> PointCloud:
        names = resolve_columns(dimension_names(header), options, path)
        bits = options.rgb_bits
        if set(COLOURS) <= names.keys() and bits is None:
            bits = colour_bits(files.file_key(path))
            files.log_once(str(path), COLOUR_DEPTH.format(bits))
        raw_names = [name for given, name in names.items() if given not in COORDINATES]
        with RecordReader(path, header, n_threads=options.n_threads, select=layers_of(header, raw_names)) as reader:
            records = reader.read(start, stop)
        first = records[:1] if start == 0 and stop > 0 else first_record(files.file_key(path))
        corner = near_corner(first, header, options.factors)
        origin = origin_near(corner)
        raw = {given: dimension(records, header, name) for given, name in names.items() if given not in COORDINATES}
        if set(COLOURS) <= raw.keys() and bits == 16:
            raw["rgb16"] = np.stack([raw[name] for name in COLOURS], axis=1)
        if options.only is not None and "rgb16" not in options.only:
            raw.pop("rgb16", None)
        return standard_cloud(
            raw,
            local_xyz(records, header, origin, options.factors, path=path, start=start),
            options=replace(options, rgb_bits=bits),
            source=path,
            origin=origin,
            crs=read_crs(header, path),
            anchor=corner if header.n_points else origin,
            extremes=lambda given: _extremes(path, header, [names[name] for name in given], options),
            notes=notes,
        )

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write a cloud as LAS or, where the path ends in ``.laz``, as LAZ; ``.copc.laz`` is cloud-optimised.

        With a template (`like`), its header, records, scale, offset and layout are used; columns that it lacks become
        extra dimensions; without one, the header is LAS 1.4 and every column is kept.
        """
        path = Path(path)
        files.refuse_packed(path, self.name)
        if path.name.lower().endswith(SUFFIX):
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=path.parent) as folder:
                plain = Path(folder) / "points.las"
                self.write(plain, cloud, options)
                write_copc(plain, path, n_threads=options.n_threads)
            return
        like = _template(cloud, options)
        metres = np.full(3, options.metres)
        header = new_header(cloud, options) if like is None else header_like(like, cloud)
        if like is not None:
            metres = _template_units(like, header, cloud, options)
            placed = with_crs_of(header, cloud, path, metres)
            header = without_copc(header if placed is header else with_room(placed, cloud, metres))
        depths = None if like is None else Depths.of_file(like)
        # intensities of 8 bits were divided by the range of 16; divided by 255, 1 is 0.004
        if depths is not None and "intensity" in cloud and np.nanmax(cloud["intensity"], initial=0.0) * 65535 <= 255.5:
            depths = replace(depths, intensity=65535)
        with files.atomic_file(path) as stream:
            compress = path.suffix.lower() == ".laz"
            writer = RecordWriter(stream, header, compress=compress, n_threads=options.n_threads)
            for part in parts_of(cloud):
                writer.write(pack_records(part, header, metres=metres, depths=depths))
            writer.close()


def _template(cloud: PointCloud, options: WriteOptions) -> Path | None:
    if options.like == "none":
        return None
    if options.like != "source":
        return files.check_file(options.like)
    source = Path(cloud.source)
    return source if source.name.lower().endswith(LasFormat.extensions) and source.is_file() else None


def _template_units(like: Path, header: LasHeader, cloud: PointCloud, options: WriteOptions) -> NDArray[np.float64]:
    """Return the factors to metres of a template: those of its system where the cloud was converted from it."""
    stated = read_crs(header)
    factors = with_units(ReadOptions(units=BY_CRS), stated, like).factors
    converted = stated is not None and cloud.crs == in_metres(stated, *factors[1:].tolist()) != stated
    return factors if converted and options.metres == 1.0 else np.full(3, options.metres)


def _extremes(path: Path, header: LasHeader, names: list[str], options: ReadOptions) -> tuple[float, float]:
    """Return minimum and maximum of dimensions; a sample of unsigned intensities shows whether they use 8 bits only."""
    if names == ["intensity"] and options.intensity_scale == "auto":
        return 0.0, float(sampled_maximum(files.file_key(path), ("intensity",)))
    return file_extremes(files.file_key(path), tuple(names))


@lru_cache(maxsize=64)
def first_record(key: files.FileKey) -> NDArray:
    """Return the first record of a file, or none."""
    path = Path(key[0])
    with RecordReader(path, read_header(path)) as reader:
        return reader.read(0, 1)


@lru_cache(maxsize=64)
def file_extremes(key: files.FileKey, names: Sequence[str]) -> tuple[float, float]:
    """Return minimum and maximum of dimensions over a whole file."""
    path = Path(key[0])
    header = read_header(path)
    low, high = np.inf, -np.inf
    with RecordReader(path, header) as reader:
        for start in range(0, header.n_points, CHUNK):
            records = reader.read(start, start + CHUNK)
            for name in names:
                values = dimension(records, header, name)
                low, high = min(low, float(np.fmin.reduce(values))), max(high, float(np.fmax.reduce(values)))
    return (low, high) if low <= high else (0.0, 0.0)
