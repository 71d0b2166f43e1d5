"""Writer of labelled surveys: all points with their original attributes, class and confidence."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import lazrs
import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.codings import NOISE_CODES
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_column
from mlsroad_pipeline.formats.base import BY_CRS, PointFormat, ReadOptions, WriteOptions
from mlsroad_pipeline.formats.crs import parse_crs, sidecar_crs
from mlsroad_pipeline.formats.files import LAZ_CHUNK, atomic_file
from mlsroad_pipeline.formats.labelled_names import CLASS, CONFIDENCE, OBJECT, RESULTS, PointLabels
from mlsroad_pipeline.formats.las.crs import read_crs, with_assigned_crs, with_wkt
from mlsroad_pipeline.formats.las.extra import ExtraDimension
from mlsroad_pipeline.formats.las.header import LasHeader, read_header, with_class_names
from mlsroad_pipeline.formats.las.layers import LayerCopier, has_layers
from mlsroad_pipeline.formats.las.layout import new_header, pack_records, with_extra
from mlsroad_pipeline.formats.las.records import RecordReader
from mlsroad_pipeline.formats.las.upgrade import upgrade_records, upgraded_header
from mlsroad_pipeline.formats.las.writer import RecordWriter
from mlsroad_pipeline.formats.native_labels import LabelSink, native_path, native_sink
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.surveys.reading import options_in_use

LabelsOf = Callable[[int, int], tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.uint32]]]
"""Function from a range of rows to the class codes, confidences and objects of its points."""

ORIGINAL_CLASS = "original_classification"
ADDED = {CONFIDENCE: ("f4", "of the class, 0 to 1"), OBJECT: ("u4", "number in the inventory")}
"""Extra dimension to its type and description."""

SCALE = 0.001
LEAST_UNIT = 0.1
"""Unit in metres down to which results have `SCALE` in the unit of their file; that of smaller ones is in metres."""

WITHHELD_BIT = 0x04
CLASS_ONLY = int(lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL | lazrs.SELECTIVE_DECOMPRESS_CLASSIFICATION)


@dataclass(frozen=True)
class _Source:
    """Header to write, and reader of records in its layout."""

    name: str
    n_points: int
    header: LasHeader
    records: Callable[[int, int], NDArray]
    copier: LayerCopier | None = None  # copies unchanged layers without decompression
    flags: Callable[[int, int], NDArray] | None = None  # records with the flags and classes that a copier leaves out


def write_labelled(
    source_path: str | Path,
    target_path: str | Path,
    labels_of: LabelsOf,
    *,
    options: ReadOptions | None = None,
    n_threads: int = 1,
    chunk_size: int = 1_000_000,
    progress: Callable[[int], None] | None = None,
    native: bool = True,
    had_classes: bool | None = None,
    class_names: Mapping[int, str] | None = None,
) -> list[Path]:
    """Copy a survey to LAZ with `classification` and the extra dimensions `confidence` and `object_id`.

    LAS and LAZ keep every dimension, extra dimension, variable length record, CRS, scale, offset and date.
    """
    source, target = Path(source_path), Path(target_path)
    options = options or ReadOptions()
    if target.suffix.lower() != ".laz":
        raise ParameterError(f"a labelled survey is written as .laz, got {target}")
    check_at_least(chunk_size, 1, "chunk_size")
    form = get_format(source)
    if target.exists() and target.samefile(source):
        raise DataError(f"{target} is the survey itself and would be overwritten; choose another folder")
    own = native_path(source, target.parent, form) if native else None
    with ExitStack() as stack:
        stream = stack.enter_context(atomic_file(target))
        sinks = [stack.enter_context(native_sink(source, own, form, options))] if own is not None else []
        if form.name == "LAS":
            crs = sidecar_crs(source) if options.crs is None else parse_crs(options.crs)
            survey = _las_source(source, had_classes, n_threads, chunk_size, stack)
            survey = replace(survey, header=_with_crs(survey.header, crs, assign=options.crs is not None))
        else:
            survey = _other_source(source, form, options)
        header = with_class_names(survey.header, class_names or {})
        writer = RecordWriter(stream, header, compress=True, n_threads=n_threads)
        for start in range(0, survey.n_points, chunk_size):
            stop = min(start + chunk_size, survey.n_points)
            _write_range(survey, writer, sinks, labels_of, (start, stop))
            if progress is not None:
                progress(stop - start)
        writer.close()
    return [target] if own is None else [target, own]


def _with_crs(header: LasHeader, crs: str | None, *, assign: bool) -> LasHeader:
    """Return a header with a system: that of an option in any case, that of a sidecar if the header has none."""
    if crs is None or (not assign and read_crs(header) is not None):
        return header
    return with_assigned_crs(header, crs) if assign else with_wkt(header, crs)


def _write_range(
    survey: _Source, writer: RecordWriter, sinks: list[LabelSink], labels_of: LabelsOf, rows: tuple[int, int]
) -> None:
    start, stop = rows
    place = f"for rows {start} to {stop - 1}"
    given = PointLabels(*labels_of(start, stop))
    codes = check_column(given.codes, stop - start, f"class codes {place}")
    confidence = check_column(given.confidence, stop - start, f"confidences {place}").astype(np.float32, copy=False)
    object_id = check_column(given.object_id, stop - start, f"objects {place}").astype(np.uint32, copy=False)
    if codes.dtype != np.uint8:
        raise DataError(f"class codes {place} must be uint8, got {codes.dtype}")
    labels = PointLabels(codes, confidence, object_id)
    records = survey.records(start, stop)
    if np.isnan(confidence).any():
        message = f"{survey.name}: {{}} of {place[4:]}"
        flagged = records if survey.flags is None else survey.flags(start, stop)
        labels = PointLabels(*_with_withheld(flagged, codes, confidence, message), object_id)
    if survey.copier is None:
        for name, column in labels.columns().items():
            records[name] = column
        writer.write(records)
    else:
        values = labels.columns()
        if ORIGINAL_CLASS in survey.copier.added:
            values[ORIGINAL_CLASS] = records[CLASS]
        writer.write_compressed(records, survey.copier.chunks(start, records, values))
    for sink in sinks:
        sink.write(start, labels)


def _flags(path: Path, header: LasHeader, start: int, stop: int) -> NDArray:
    with RecordReader(path, header, select=CLASS_ONLY | int(lazrs.SELECTIVE_DECOMPRESS_FLAGS)) as reader:
        return reader.read(start, stop)


def _with_withheld(
    records: NDArray, codes: NDArray[np.uint8], confidence: NDArray[np.float32], message: str
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return labels in which withheld points and noise without one have their class of before, confidence 0."""
    unlabelled = np.isnan(confidence)
    lost = unlabelled & (records["classification_flags"] & WITHHELD_BIT == 0) & ~np.isin(records[CLASS], NOISE_CODES)
    if lost.any():
        raise DataError(f"{message.format(int(lost.sum()))} have no label")
    names = records.dtype.names or ()
    before = records[ORIGINAL_CLASS if ORIGINAL_CLASS in names and not records[CLASS].any() else CLASS]
    kept = np.clip(np.where(np.isfinite(before), before, 0), 0, 255).astype(np.uint8)
    return np.where(unlabelled, kept, codes), np.where(unlabelled, np.float32(0), confidence)


def _las_source(path: Path, had_classes: bool | None, n_threads: int, chunk_size: int, stack: ExitStack) -> _Source:
    header = read_header(path)
    if had_classes is None:
        had_classes = _has_classes(path, header, n_threads)
    upgraded = upgraded_header(header)
    target = _with_results(upgraded, keep_class=had_classes, source=str(path))
    own = len(upgraded.extra_dimensions)
    added = {dimension.name: dimension for dimension in target.extra_dimensions[own:]}
    if has_layers(header) and added.keys() >= ADDED.keys() and chunk_size % LAZ_CHUNK == 0:
        copier = LayerCopier(path, header, added, classes=ORIGINAL_CLASS in added, n_threads=n_threads)
        stack.enter_context(copier)
        return _Source(str(path), header.n_points, target, copier.read, copier, partial(_flags, path, header))
    reader = stack.enter_context(RecordReader(path, header, n_threads=n_threads))

    def records(start: int, stop: int) -> NDArray:
        out = upgrade_records(reader.read(start, stop), header, target)
        if ORIGINAL_CLASS in added:
            out[ORIGINAL_CLASS] = out[CLASS]
        return out

    return _Source(str(path), header.n_points, target, records)


def _with_results(header: LasHeader, *, keep_class: bool, source: str) -> LasHeader:
    """Return a header with the dimensions of the result; an existing one of that name is renamed or replaced."""
    existing = list(header.extra_dimensions)
    names = [dimension.name for dimension in existing]
    added = []
    if keep_class and ORIGINAL_CLASS not in names:
        added.append(ExtraDimension.create(ORIGINAL_CLASS, np.dtype("u1"), description="class in the input"))
    for name, (dtype, description) in ADDED.items():
        kept = f"original_{name}"
        if name not in names or kept not in names:
            added.append(ExtraDimension.create(name, np.dtype(dtype), description=description))
        if name not in names:
            continue
        old = existing[names.index(name)]
        if kept not in names:
            existing[names.index(name)] = old.renamed(kept)
        elif old.dtype != np.dtype(dtype) or old.width != 1 or old.scale is not None:
            raise DataError(f"{source} has both {name} ({old.dtype}) and {kept}: rename one of them")
    return with_extra(header, added, existing=existing, source=source)


def _has_classes(path: Path, header: LasHeader, n_threads: int) -> bool:
    """Return whether a class other than 0 occurs; a short range is read first, since most files have classes there."""
    field, mask = ("raw_classification", 0x1F) if header.point_format < 6 else (CLASS, 0xFF)
    with RecordReader(path, header, n_threads=n_threads, select=CLASS_ONLY) as reader:
        size = 50_000
        start = 0
        while start < header.n_points:
            if (reader.read(start, start + size)[field] & mask).any():
                return True
            start += size
            size = 1_000_000
    return False


def result_header(path: Path, form: PointFormat, options: ReadOptions) -> LasHeader:
    """Return the header of the labelled LAZ of a file, read from the header of the file.

    Raises DataError if LAZ cannot hold a column of the file: its message names the file and the column.
    """
    if form.name == "LAS":
        return _with_results(upgraded_header(read_header(path)), keep_class=True, source=str(path))
    empty = _renamed(form.read(path, as_stored(options), start=0, stop=0))
    flat = options_in_use(form, str(path), options).metres if keeps_units(options) else 1.0
    scale = SCALE if flat > LEAST_UNIT else SCALE / flat
    return _with_results(new_header(empty, WriteOptions(scale=scale)), keep_class=False, source=str(path))


def keeps_units(options: ReadOptions) -> bool:
    """Return whether a result has the units of its file, not metres as with options that set a unit or a system."""
    return options.units == BY_CRS and options.reproject is None


def as_stored(options: ReadOptions) -> ReadOptions:
    """Return options that read the coordinates of a file as its result has them."""
    return replace(options, units=1.0, height_units=None) if keeps_units(options) else options


def _other_source(path: Path, form: PointFormat, options: ReadOptions) -> _Source:
    def cloud(start: int, stop: int) -> PointCloud:
        return _renamed(form.read(path, as_stored(options), start=start, stop=stop))

    header = result_header(path, form, options)

    def records(start: int, stop: int) -> NDArray:
        return pack_records(cloud(start, stop), header)

    return _Source(str(path), form.info(path, options).n_points, header, records)


def _renamed(cloud: PointCloud) -> PointCloud:
    """Rename columns whose names the result uses."""
    for name in RESULTS:
        kept = f"original_{name}"
        if name in cloud and kept not in cloud:
            columns = {kept if key == name else key: values for key, values in cloud.columns.items()}
            cloud = replace(cloud, columns=columns)
    return cloud
