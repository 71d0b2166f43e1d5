"""Tasks of the ingest: describe a file, find the corridor of a pass, read and cut a range of rows."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud, concatenate
from mlsroad_pipeline.algorithms.inventory.objects.sightings import visit_columns
from mlsroad_pipeline.algorithms.quality.chunks import inspect_chunk
from mlsroad_pipeline.algorithms.quality.tables import chunk_to_arrays
from mlsroad_pipeline.algorithms.scenes.binning import CutPoints, cut_points
from mlsroad_pipeline.algorithms.scenes.corridor import (
    Corridor,
    CorridorArrays,
    axis_of_samples,
    corridor_from_arrays,
    corridor_to_arrays,
)
from mlsroad_pipeline.algorithms.scenes.splits import SplitPart
from mlsroad_pipeline.algorithms.scenes.trajectory_estimation import SHARED, measured_times, trajectory_from_windows
from mlsroad_pipeline.algorithms.scenes.weeks import continued
from mlsroad_pipeline.formats.base import BY_CRS, PointFormat, ReadOptions
from mlsroad_pipeline.formats.crs import crs_label, is_same_crs, parse_crs, with_units
from mlsroad_pipeline.formats.files import spread_starts
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.surveys.given_classes import GivenParameters, given_columns
from mlsroad_pipeline.surveys.trajectory_files import coverage_note, distance_note, in_weeks_of, read_trajectory

SAMPLE_RUNS, SAMPLE_SIZE = 16, 256
"""Number and length of the evenly spaced runs of points that make a sample of a file."""

SCENE_COLUMNS = ("rgb", "intensity", "gps_time", "scanner", "label", "instance")
"""Attributes of a file that scenes keep; the others are read again by the writer."""

CLASS, WITHHELD = "classification", "withheld"

WHOLE_SAMPLE = 1024
"""Number of coordinates that are tested for whole numbers."""

UNUSED_COLUMNS = ("gps_time", "scanner")
"""Columns that only the quality report and the training need; `label` keeps the columns of `visit_columns` instead."""

VISIT_COLUMNS = ("scanner_channel", "point_source_id")
"""Dimensions of LAS that distinguish scanners and routes."""

LABEL_COLUMNS = ("label", "instance")
"""Columns of a file that `label` keeps and does not use."""

FEATURE_COLUMNS = ("rgb", "intensity")
"""Columns with features; a column with a single value, as in files exported without it, counts as missing."""


def _scene_options(
    path: str, options: ReadOptions, *, labels: bool, constant: Sequence[str] = (), added: Sequence[str] = ()
) -> ReadOptions:
    """Return options to read the scene columns of a file, its withheld flags, and the classes of LAS files to label."""
    form = get_format(path)
    columns = form.info(Path(path), replace(options, coding=options.coding if labels else None)).columns
    skipped = {*constant, *(() if labels else LABEL_COLUMNS)}
    selected = [name for name in SCENE_COLUMNS if name in columns and name not in skipped]
    wanted = [WITHHELD] if labels else [WITHHELD, *(added if form.name == "LAS" else set(added) & set(LABEL_COLUMNS))]
    if not labels and form.name == "LAS":
        wanted.append(CLASS)
    selected += [name for name in wanted if name in columns]
    return replace(options, only=tuple(selected), coding=options.coding if labels and "label" in selected else None)


def constant_columns(sample: PointCloud) -> list[str]:
    """Return the feature columns with a single value in the sample."""
    return [
        name
        for name in FEATURE_COLUMNS
        if name in sample and len(sample) > 1 and bool((sample[name] == sample[name][0]).all())
    ]


def has_whole_numbers(cloud: PointCloud) -> bool:
    """Return whether coordinates are whole numbers, as millimetres are; False for fewer than 64 points."""
    units = cloud.world_xyz()[:WHOLE_SAMPLE]
    return len(units) >= 64 and bool(np.abs(units - np.rint(units)).max() <= 1e-6)


def options_in_use(form: PointFormat, path: str, options: ReadOptions) -> ReadOptions:
    """Return the options with the units of the file."""
    if options.units != BY_CRS:
        return options
    stated = form.info(Path(path), replace(options, units=1.0, crs=None, reproject=None, coding=None)).crs
    return with_units(options, stated, Path(path))


def time_notes(sample: PointCloud) -> list[str]:
    """Return a sentence if times of a sample are infinite or shared by many points."""
    if "gps_time" not in sample or len(sample) <= SHARED or (sample["gps_time"] == sample["gps_time"][0]).all():
        return []
    share = 1.0 - float(measured_times(sample["gps_time"]).mean())
    if share == 0.0:
        return []
    return [f"{max(100 * share, 1):.0f} % of the gps_time are infinite or shared by many points: they are not used"]


def replaced_crs(form: PointFormat, path: str, options: ReadOptions) -> str | None:
    """Return the system that a file states, if the option `crs` replaces it by another."""
    if options.crs is None:
        return None
    stated = form.info(Path(path), replace(options, crs=None, reproject=None, coding=None)).crs
    return None if stated is None or is_same_crs(stated, parse_crs(options.crs)) else stated


def sample_of(form: PointFormat, path: str, options: ReadOptions, n_points: int) -> PointCloud:
    """Return evenly spaced runs of the points of a file."""
    starts = spread_starts(n_points, SAMPLE_RUNS, SAMPLE_SIZE)
    return concatenate([form.read(Path(path), options, start=start, stop=start + SAMPLE_SIZE) for start in starts])


class FileFacts(TypedDict):
    """Facts of a file: numbers and flags of shape (1,), systems as WKT or empty."""

    n_points: NDArray[np.int64]
    constant: NDArray[np.str_]  # names of the feature columns with a single value
    crs: NDArray[np.str_]
    stated_crs: NDArray[np.str_]  # if an option replaces it
    whole_numbers: NDArray[np.bool_]
    form: NDArray[np.str_]
    notes: NDArray[np.str_]  # sentences on guesses and repairs
    bounds: NDArray[np.float64]  # of the header, shape (2, 3); NaN without them
    factors: NDArray[np.float64]  # from the file's units to metres


class FileDescription(TypedDict):
    """Stored parts of a described file; `windows` is empty if the trajectory is not estimated."""

    info: FileFacts
    sample: PointCloud
    windows: PointCloud


class PassCorridor(CorridorArrays):
    """Corridor of a pass, with a note for the log."""

    note: NotRequired[NDArray[np.str_]]


class FileClasses(TypedDict):
    """Whether any row of a range has a class, shape (1,); empty if the column was not read."""

    has_classes: NDArray[np.bool_]


class CutRange(CutPoints):
    """Stored parts of a range of rows."""

    quality: dict[str, NDArray]  # arrays of `chunk_to_arrays`
    classes: FileClasses


def describe_file(path: str, *, options: ReadOptions, labels: bool, windows: bool) -> FileDescription:
    """Return the number of points of a file, a sample, and time windows for the estimation of the trajectory."""
    form = get_format(path)
    chosen = _scene_options(path, options, labels=labels)
    info = form.info(Path(path), chosen)
    n_points = info.n_points
    if n_points == 0:
        raise ReadError(f"{path} is empty: it holds no points")
    sample = sample_of(form, path, chosen, n_points)
    time_windows = _time_windows(form, path, chosen, sample=sample, n_points=n_points) if windows else None
    return {
        "info": {
            "n_points": np.array([n_points]),
            "constant": np.array(constant_columns(sample), dtype=np.str_),
            "crs": np.array([sample.crs or ""]),
            "stated_crs": np.array([replaced_crs(form, path, options) or ""]),
            "whole_numbers": np.array([has_whole_numbers(sample)]),
            "form": np.array([form.name]),
            "notes": np.array([*info.notes, *time_notes(sample)], dtype=np.str_),
            "bounds": np.full((2, 3), np.nan) if info.bounds is None else info.bounds,
            "factors": options_in_use(form, path, options).factors,
        },
        "sample": sample,
        "windows": sample.select(np.zeros(0, dtype=np.int64)) if time_windows is None else time_windows,
    }


WINDOW_LENGTH = 0.1
"""Length of a window, seconds: 20 rotations at 200 lines per second, 4 at 40."""

WINDOW_INTERVAL = 1.0
"""Interval of the windows, seconds; the trajectory is interpolated linearly between them."""

MAX_WINDOWS = 1000
"""Largest number of windows of a file; longer files have a larger interval."""

WINDOW_POINTS = 12_000
"""Largest number of points per window; longer windows are thinned."""


def _time_windows(
    form: PointFormat, path: str, options: ReadOptions, *, sample: PointCloud, n_points: int
) -> PointCloud | None:
    """Return evenly spaced windows of a file stored in the order of time, or None without times."""
    if "gps_time" not in sample:
        return None
    duration = _duration(sample["gps_time"])
    if duration is None:
        return None
    n_windows = int(np.clip(duration / WINDOW_INTERVAL, 2, MAX_WINDOWS))
    length = int(np.ceil(min(n_points * WINDOW_LENGTH / duration, n_points / n_windows)))
    chosen = replace(options, only=tuple(name for name in ("gps_time", "scanner") if name in sample), coding=None)
    windows = []
    for number, start in enumerate(np.linspace(0, n_points - length, n_windows).astype(int)):
        cloud = form.read(Path(path), chosen, start=int(start), stop=int(start) + length)
        thin = cloud.select(np.arange(0, len(cloud), -(-len(cloud) // WINDOW_POINTS)))
        windows.append(thin.with_columns(window=np.full(len(thin), number, dtype=np.int32)))
    return concatenate(windows)


def _duration(times: NDArray) -> float | None:
    """Return the duration of a file in seconds; single times far from the others do not count."""
    measured = continued(times[measured_times(times)])
    if len(measured) < 2 or not measured.max() > measured.min():
        return None
    low, high = np.percentile(measured, [10, 90])
    most = (high - low) / 0.8
    whole = float(measured.max() - measured.min())
    return whole if whole <= 10 * most or most <= 0 else float(most)


def find_corridor(
    samples: Sequence[PointCloud],
    windows: Sequence[PointCloud],
    *,
    trajectory: str | None,
    along: bool,
    factors: NDArray[np.float64] | None = None,
) -> PassCorridor:
    """Return the corridor of a pass as arrays, with a note for the log; `factors` turn a trajectory into metres."""
    check_one_crs([(sample.source, sample.crs) for sample in samples])
    if trajectory is not None:
        path = read_trajectory(trajectory, crs=samples[0].crs if samples else None, factors=factors)
        times = _times_of(samples)
        path = in_weeks_of(path, *times)
        xyz = np.concatenate([np.empty((0, 3)), *(sample.world_xyz() for sample in samples)])
        extent = (xyz.min(axis=0), xyz.max(axis=0)) if len(xyz) else np.full((2, 3), np.nan)
        notes = (path.note, coverage_note(path, *times), distance_note(path, *extent))
        return _with_note(path, "; ".join(filter(None, notes)))
    if not along:
        return _with_note(None)
    filled = _continued_windows([part for part in windows if len(part)])
    if not filled:
        return _with_note(axis_of_samples(samples))
    try:
        estimated = trajectory_from_windows(filled)
    except DataError as error:
        return _with_note(axis_of_samples(samples), f"{error}; cut along the main axis of the points")
    return _with_note(estimated, f"{estimated.source}: {estimated.length:.0f} m of trajectory")


def check_one_crs(systems: Sequence[tuple[str, str | None]]) -> None:
    """Raise DataError if files have different systems; one system in several spellings is one."""
    (name, crs), *others = systems
    for other, found in others:
        if found != crs and not (crs is not None and found is not None and is_same_crs(crs, found)):
            option = "read.crs (label.crs) if it is the same" if None in (crs, found) else "read.reproject"
            raise DataError(
                f"{name} and {other} have different coordinate reference systems ({crs_label(crs)} and "
                f"{crs_label(found)}); set {option}, or separate them"
            )


def _with_note(corridor: Corridor, note: str = "") -> PassCorridor:
    arrays: PassCorridor = {**corridor_to_arrays(corridor)}
    if note:
        arrays["note"] = np.array(note)
    return arrays


def _continued_windows(windows: Sequence[PointCloud]) -> list[PointCloud]:
    """Return windows whose times go on after the end of a week."""
    if not windows:
        return []
    times = continued(np.concatenate([part["gps_time"] for part in windows]))
    parts = np.split(times, np.cumsum([len(part) for part in windows])[:-1])
    return [part.with_columns(gps_time=time) for part, time in zip(windows, parts, strict=True)]


def _times_of(samples: Sequence[PointCloud]) -> tuple[float, float]:
    times = [sample["gps_time"] for sample in samples if "gps_time" in sample]
    times = [part[measured_times(part)] for part in times]
    joined = continued(np.concatenate(times)) if times else np.empty(0)
    return (float(joined.min()), float(joined.max())) if len(joined) else (np.nan, np.nan)


def read_and_cut(
    path: str,
    corridor: CorridorArrays,
    *,
    options: ReadOptions,
    labels: bool,
    along: bool,
    part: SplitPart,
    start: int,
    stop: int,
    n_total: int,
    file: int,
    bin_length: float,
    time_gap: float,
    constant: Sequence[str] = (),
    given: GivenParameters | None = None,
    predictions: str | None = None,
) -> CutRange:
    """Read a range of rows, inspect its quality and sort it into bins of the corridor."""
    added = (*VISIT_COLUMNS, *LABEL_COLUMNS)  # labels are read, so that a wrong one is an error before the labelling
    chosen = _scene_options(path, options, labels=labels, constant=constant, added=added)
    cloud = get_format(path).read(Path(path), chosen, start=start, stop=stop)
    noise = np.isin(cloud[CLASS], (given or GivenParameters()).noise) if CLASS in cloud else None
    has_classes = np.array([cloud[CLASS].any()] if CLASS in cloud else [], dtype=np.bool_)
    visits = {} if labels else visit_columns(cloud)
    if given is not None:
        visits |= given_columns(cloud, given, predictions, path=path, start=start, n_total=n_total)
    cloud = cloud.without_columns([CLASS, *VISIT_COLUMNS, *(() if labels else LABEL_COLUMNS)])
    quality = chunk_to_arrays(inspect_chunk(cloud, max_gap=time_gap, n_total=n_total, noise=noise))
    used = np.ones(len(cloud), dtype=np.bool_) if WITHHELD not in cloud else cloud[WITHHELD] == 0
    used = used if noise is None else used & ~noise
    cloud = cloud.without_columns([WITHHELD])
    pieces = cut_points(
        cloud if labels else cloud.without_columns(UNUSED_COLUMNS).with_columns(**visits),
        corridor_from_arrays(corridor),
        part,
        along=along,
        bin_length=bin_length,
        first_row=start,
        file=file,
        used=used,
    )
    return {**pieces, "quality": quality, "classes": {"has_classes": has_classes}}
