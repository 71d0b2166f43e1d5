"""What workers do with the files of a survey: describe one, find its corridor, read and cut a range of rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud, concatenate
from mlsroad_pipeline.algorithms.quality.chunks import inspect_chunk
from mlsroad_pipeline.algorithms.quality.tables import chunk_to_arrays
from mlsroad_pipeline.algorithms.scenes.cutting import (
    axis_of_samples,
    corridor_from_arrays,
    corridor_to_arrays,
    cut_points,
)
from mlsroad_pipeline.algorithms.scenes.splits import SplitPart
from mlsroad_pipeline.algorithms.scenes.trajectory_estimation import trajectory_from_windows
from mlsroad_pipeline.formats.files import spread_starts
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.surveys.sbet import coverage_note, in_weeks_of
from mlsroad_pipeline.surveys.time_windows import read_time_windows
from mlsroad_pipeline.surveys.trajectory_files import read_trajectory

SAMPLE_RUNS, SAMPLE_SIZE = 16, 256
"""A file's sample: this many runs of this many points, evenly spread."""

SCENE_COLUMNS = ("rgb", "intensity", "gps_time", "scanner", "label", "instance")
"""What scenes keep of a file's attributes; the rest is read again where it is written."""


CLASS = "classification"

UNUSED_COLUMNS = ("gps_time", "scanner")
"""What is looked at for the quality report and then dropped where no method is trained."""


TELLING_COLUMNS = ("rgb", "intensity")
"""Columns that methods learn from; where all points have one value, as in files that were exported without, the file
is taken not to have the column."""


def _scene_options(path: str, options: ReadOptions, *, labels: bool, constant: Sequence[str] = ()) -> ReadOptions:
    """Ask for the columns that scenes keep, as far as the file has them, and where it is labelled for its class."""
    form = get_format(path)
    have = form.info(Path(path), replace(options, coding=options.coding if labels else None)).columns
    barred = {*constant, *(() if labels else ("label", "instance"))}
    wanted = [name for name in SCENE_COLUMNS if name in have and name not in barred]
    if not labels and form.name == "LAS" and CLASS in have:
        wanted.append(CLASS)
    return replace(options, only=tuple(wanted), coding=options.coding if "label" in wanted else None)


def constant_columns(sample: PointCloud) -> list[str]:
    """Find the columns of a sample that tell nothing."""
    return [
        name
        for name in TELLING_COLUMNS
        if name in sample and len(sample) > 1 and bool((sample[name] == sample[name][0]).all())
    ]


def describe_file(path: str, *, options: ReadOptions, labels: bool, windows: bool) -> dict[str, Any]:
    """Count a file's points and take a sample of them.

    Raises
    ------
    ReadError
        If the file is empty, damaged or of another format than its name says.
    """
    form = get_format(path)
    chosen = _scene_options(path, options, labels=labels)
    n_points = form.info(Path(path), chosen).n_points
    if n_points == 0:
        raise ReadError(f"{path} is empty: it holds no points")
    starts = spread_starts(n_points, SAMPLE_RUNS, SAMPLE_SIZE)
    runs = [form.read(Path(path), chosen, start=start, stop=start + SAMPLE_SIZE) for start in starts]
    sample = concatenate(runs)
    stretches = read_time_windows(form, path, chosen, sample=sample, n_points=n_points) if windows else None
    return {
        "info": {"n_points": np.array([n_points]), "constant": np.array(constant_columns(sample), dtype=np.str_)},
        "sample": sample,
        "windows": sample.select(np.zeros(0, dtype=np.int64)) if stretches is None else stretches,
    }


def find_corridor(
    samples: Sequence[PointCloud], windows: Sequence[PointCloud], *, trajectory: str | None, along: bool
) -> dict[str, NDArray]:
    """Find what the files of one drive are cut along.

    Raises
    ------
    ReadError
        If the trajectory cannot be read.
    DataError
        If the trajectory has no length, a coordinate is not finite, or the files have different coordinate reference
        systems.
    """
    other = next((sample for sample in samples if sample.crs != samples[0].crs), None)
    if other is not None:
        raise DataError(
            f"{samples[0].source} and {other.source} have different coordinate reference systems; "
            "set read.reproject, or take them apart"
        )
    if trajectory is not None:
        path = read_trajectory(trajectory, crs=samples[0].crs if samples else None)
        times = _times_of(samples)
        path = in_weeks_of(path, *times)
        note = coverage_note(path, *times)
        return {**corridor_to_arrays(path), **({"note": np.array(note)} if note else {})}
    if not along:
        return corridor_to_arrays(None)
    stretches = [part for part in windows if len(part)]
    if not stretches:
        return corridor_to_arrays(axis_of_samples(samples))
    try:
        found = trajectory_from_windows(stretches)
    except DataError as error:
        note = f"{error}; cut along the main axis of the points"
        return {**corridor_to_arrays(axis_of_samples(samples)), "note": np.array(note)}
    return {**corridor_to_arrays(found), "note": np.array(f"{found.source}: {found.length:.0f} m of trajectory")}


def _times_of(samples: Sequence[PointCloud]) -> tuple[float, float]:
    times = [sample["gps_time"][np.isfinite(sample["gps_time"])] for sample in samples if "gps_time" in sample]
    joined = np.concatenate(times) if times else np.empty(0)
    return (float(joined.min()), float(joined.max())) if len(joined) else (np.nan, np.nan)


def read_and_cut(
    path: str,
    corridor: dict[str, NDArray],
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
) -> dict[str, Any]:
    """Read a range of a file's rows, look at their quality and sort them into the corridor's bins.

    Raises
    ------
    ReadError
        If the file is damaged.
    DataError
        If a value cannot be used.
    """
    chosen = _scene_options(path, options, labels=labels, constant=constant)
    cloud = get_format(path).read(Path(path), chosen, start=start, stop=stop)
    has_classes = np.array([cloud[CLASS].any()] if CLASS in cloud else [], dtype=np.bool_)
    cloud = cloud.without_columns([CLASS])
    quality = chunk_to_arrays(inspect_chunk(cloud, max_gap=time_gap, n_total=n_total))
    pieces = cut_points(
        cloud if labels else cloud.without_columns(UNUSED_COLUMNS),
        corridor_from_arrays(corridor),
        part,
        along=along,
        bin_length=bin_length,
        first_row=start,
        file=file,
    )
    return {**pieces, "quality": quality, "classes": {"has_classes": has_classes}}
