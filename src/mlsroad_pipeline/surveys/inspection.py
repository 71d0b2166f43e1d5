"""Inspection of the files of a survey in bounded memory."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pandas as pd
import pyproj
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.codings import NOISE_CODES
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.inventory.objects.sightings import PASS_GAP, visit_columns
from mlsroad_pipeline.algorithms.quality.chunks import inspect_chunk, merge
from mlsroad_pipeline.algorithms.quality.inspection import (
    ColumnSummary,
    ScanLines,
    SurveyMap,
    column_warnings,
    constant_columns,
    summarise,
    time_base,
)
from mlsroad_pipeline.algorithms.quality.report import QualityReport
from mlsroad_pipeline.formats.base import NEW_SURVEY, FileInfo, PointFormat, ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.surveys.files import Survey
from mlsroad_pipeline.surveys.offset_warnings import offset_facts, offset_warnings
from mlsroad_pipeline.surveys.pass_offsets import NO_OFFSETS, Source, SurveyOffsets, survey_offsets
from mlsroad_pipeline.surveys.reading import (
    VISIT_COLUMNS,
    has_whole_numbers,
    options_in_use,
    replaced_crs,
    sample_of,
    time_notes,
)
from mlsroad_pipeline.surveys.survey_warnings import SurveyFacts, file_warnings, survey_warnings
from mlsroad_pipeline.surveys.trajectory_files import coverage_note, distance_note, in_weeks_of, read_trajectory

logger = logging.getLogger(__name__)

ProblemsOf = Callable[[str, ReadOptions, QualityReport], list[str]]
"""Function from a file, options of the reader and quality of the points to the reasons why it cannot be labelled."""

CHUNK = 500_000
SAMPLE_RUNS, SAMPLE_SIZE = 16, 64
LARGEST_RATIO = 10.0
"""Largest ratio of the extent that a header states to that of a sample, for the map to take the stated one."""

MARGIN = 0.05
"""Relative margin around the extent of a sample, for the map of a file without stated bounds."""


@dataclass(frozen=True)
class InspectParameters:
    """A survey to inspect."""

    # File, folder or glob, or several of them; empty takes the survey of the comparison
    survey: str | Sequence[str] = ""
    output: str = ""  # Folder of the report; empty takes the folder of the reports of the project
    trajectory: str | None = "trajectory.csv"  # Name of the trajectory file beside the points
    max_gap: float = 1.0  # Largest step in time that is not a gap, seconds
    read: Mapping[str, Any] = field(default_factory=dict)  # Arguments of `ReadOptions`

    def __post_init__(self) -> None:
        check_positive(self.max_gap, "inspect.max_gap")


@dataclass
class FileInspection:
    """Result of the inspection of one file."""

    name: str  # Path below the root of the survey
    info: FileInfo  # Content of the header
    picture: SurveyMap  # Map of the point density
    facts: dict[str, Any]  # Figures as plain data for JSON
    overview: SurveyFacts  # Facts of the warnings that `label` has too
    more: list[str]  # Further warnings

    @property
    def warnings(self) -> list[str]:
        """One sentence per problem."""
        return [*file_warnings(self.overview), *self.more]


def inspection_warnings(
    files: Sequence[FileInspection], skipped: Mapping[str, str], offsets: SurveyOffsets = NO_OFFSETS
) -> pd.DataFrame:
    """Return the warnings on the files and on differences between them, one row per cause."""
    rows = survey_warnings([file.overview for file in files], skipped, {file.name: file.more for file in files})
    rows += offset_warnings(offsets)
    return pd.DataFrame(rows, columns=["file", "warning"])


def survey_facts(
    survey: str, files: Sequence[FileInspection], warnings: pd.DataFrame, offsets: SurveyOffsets = NO_OFFSETS
) -> dict[str, Any]:
    """Return the facts of a survey as plain data."""
    return {
        "survey": survey,
        "n_points": sum(file.facts["n_points"] for file in files),
        "files": [file.facts for file in files],
        "offsets": offset_facts(offsets),
        "warnings": warnings.to_dict("records"),
    }


def inspect_survey(
    parameters: InspectParameters,
    *,
    root: str | Sequence[str],
    read: Mapping[str, Any],
    problems_of: ProblemsOf = lambda path, options, quality: [],
) -> tuple[list[FileInspection], dict[str, str]]:
    """Inspect all files of a survey; return the results, and the reason of each file that is left out."""
    options = ReadOptions.from_config({**NEW_SURVEY, **read})
    text = options.delimiter is None and options.decimal is None  # as in `plan.plan_labelling`
    listing = Survey.at(root).listing(trajectory=parameters.trajectory, text=text)
    files, unread = [], dict(listing.skipped)
    for file in listing.files:
        logger.info("Inspecting %s", file.name)
        try:
            inspected = inspect_file(
                *(file.path, file.name),
                options=options,
                max_gap=parameters.max_gap,
                trajectory=file.trajectory,
                wanted=parameters.trajectory is not None,
            )
        except DataError as error:
            unread[file.name] = f"cannot be read: {error}"
        else:
            inspected.more.extend(problems_of(file.path, options, inspected.overview.quality))
            files.append(inspected)
    return files, unread


def offsets_of_files(
    parameters: InspectParameters, files: Sequence[FileInspection], *, read: Mapping[str, Any]
) -> SurveyOffsets:
    """Return the offsets between the files and passes of an inspected survey; a file of one pass alone has none."""
    if len(files) < 2 and not any((file.facts["time"]["longest_gap"] or 0.0) > PASS_GAP for file in files):
        return NO_OFFSETS
    options = ReadOptions.from_config({**NEW_SURVEY, **read})
    return survey_offsets(
        [Source(f.name, PurePosixPath(f.name).parent.as_posix(), partial(_chunks, f.info.path, options)) for f in files]
    )


def _chunks(path: Path, options: ReadOptions) -> Iterator[PointCloud]:
    form = get_format(path)
    info = form.info(path, replace(options, coding=None))
    names = {"gps_time", *VISIT_COLUMNS} & set(info.columns)
    chosen = replace(options, only=tuple(sorted(names)), coding=None)
    for start in range(0, info.n_points, CHUNK):
        cloud = form.read(path, chosen, start=start, stop=start + CHUNK)
        yield cloud.with_columns(**visit_columns(cloud))


def inspect_file(
    path: str, name: str, *, options: ReadOptions, max_gap: float, trajectory: str | None = None, wanted: bool = False
) -> FileInspection:
    """Inspect one file; a missing trajectory is a warning if one is wanted."""
    form = get_format(path)
    info = form.info(Path(path), options)
    columns: dict[str, ColumnSummary] = {}
    lines, chunks, in_las = ScanLines(), [], form.name == "LAS"
    picture = _empty_map(form, info, options)
    with ThreadPoolExecutor(max_workers=1) as pool:  # prefetches the next range
        ahead = pool.submit(form.read, Path(path), options, start=0, stop=CHUNK)
        for start in range(0, max(info.n_points, 1), CHUNK):
            cloud = ahead.result()
            if start + CHUNK < info.n_points:
                ahead = pool.submit(form.read, Path(path), options, start=start + CHUNK, stop=start + 2 * CHUNK)
            cloud = replace(cloud, source=name)
            noise = np.isin(cloud["classification"], NOISE_CODES) if in_las and "classification" in cloud else None
            chunks.append(inspect_chunk(cloud, max_gap=max_gap, n_total=info.n_points, noise=noise))
            summarise(cloud, columns)
            lines.add(cloud)
            picture.add(cloud)
    quality = merge(chunks)
    times = replace(options, only=tuple({"gps_time"} & columns.keys()), coding=None)
    more = column_warnings(columns)
    in_use = options_in_use(form, path, options)
    more += [] if trajectory is None else _trajectory_warnings(trajectory, quality, info.crs, in_use)
    overview = SurveyFacts(
        quality,
        info.crs,
        info.format,
        trajectory="beside" if trajectory is not None else "none" if wanted else "off",
        constant=constant_columns(columns),
        columns=tuple(columns),
        whole_numbers=has_whole_numbers(
            form.read(info.path, replace(options, only=(), coding=None), stop=SAMPLE_RUNS * SAMPLE_SIZE)
        ),
        in_metres=bool((options.factors == 1.0).all()),
        stated_crs=replaced_crs(form, path, options),
        notes=(*info.notes, *time_notes(sample_of(form, path, times, info.n_points))),
        bounds=info.bounds,
    )
    return FileInspection(name, info, picture, _facts(name, info, quality, columns, lines), overview, more)


def _empty_map(form: PointFormat, info: FileInfo, options: ReadOptions) -> SurveyMap:
    starts = np.unique(np.linspace(0, max(info.n_points - SAMPLE_SIZE, 0), SAMPLE_RUNS).astype(int)).tolist()
    only = replace(options, only=(), coding=None)
    runs = [form.read(info.path, only, start=s, stop=s + SAMPLE_SIZE).world_xyz() for s in starts]
    sample = np.concatenate(runs)
    if not len(sample):
        return SurveyMap.over(np.zeros(2), np.zeros(2))
    low, high = sample.min(axis=0), sample.max(axis=0)
    if info.bounds is not None and _plausible(info.bounds, low, high):
        return SurveyMap.over(*info.bounds)
    wider = MARGIN * (high - low).max()
    return SurveyMap.over(low - wider, high + wider)


def _plausible(bounds: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
    """Return whether stated bounds hold a sample and are not much larger than it."""
    with np.errstate(invalid="ignore", over="ignore"):
        near = (bounds[1] - bounds[0])[:2].max() <= LARGEST_RATIO * max(float((high - low)[:2].max()), 1.0)
        return bool(near and (bounds[0] <= low + MARGIN).all() and (bounds[1] >= high - MARGIN).all())


def _facts(
    name: str, info: FileInfo, quality: QualityReport, columns: Mapping[str, ColumnSummary], lines: ScanLines
) -> dict[str, Any]:
    """Return the figures of a file as plain data for JSON."""
    seconds = quality.time_end - quality.time_start
    facts: dict[str, Any] = {
        **{"file": name, "bytes": info.path.stat().st_size, "format": info.format, "details": info.details},
        **{"n_points": quality.n_points, "low": quality.low, "high": quality.high, "crs": info.crs},
        **{"crs_name": _crs_name(info.crs), "density": quality.density, "median_density": quality.median_density},
        **{"concentration": quality.concentration, "n_duplicates": quality.n_duplicates},
        **{"duplicates_exact": quality.duplicates_exact, "n_not_finite": quality.n_not_finite},
        "columns": {
            name: {
                **{"type": column.dtype, "minimum": column.minimum, "maximum": column.maximum},
                **{"missing": column.n_missing, **({"counts": column.counts} if column.counts else {})},
            }
            for name, column in columns.items()
        },
        "time": {
            **{"start": quality.time_start, "end": quality.time_end},
            **{"base": time_base(quality.time_start, quality.time_end), "gaps": quality.n_gaps},
            **{"longest_gap": quality.longest_gap, "steps_back": quality.n_backward},
        },
        "scan_lines": {
            **{"jumps_of_the_angle": lines.n_jumps, "edges_of_lines": lines.n_edges},
            "lines_per_second": lines.n_jumps / seconds if seconds > 0 else None,
        },
    }
    return {key: _plain(value) for key, value in facts.items()}


def _trajectory_warnings(trajectory: str, quality: QualityReport, crs: str | None, options: ReadOptions) -> list[str]:
    path = read_trajectory(trajectory, crs=crs, factors=options.factors)
    first, last = quality.time_start, quality.time_end
    covered = coverage_note(in_weeks_of(path, first, last), first, last) if np.isfinite(first) else ""
    return [note for note in (path.note, covered, distance_note(path, quality.low, quality.high)) if note]


def _crs_name(crs: str | None) -> str | None:
    if crs is None:
        return None
    try:
        return str(pyproj.CRS.from_user_input(crs).name)
    except pyproj.exceptions.CRSError:
        return "not understood by PROJ"


def _plain(value: Any) -> Any:
    """Return a value in types of JSON, with None for NaN and infinity."""
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in (value.tolist() if isinstance(value, np.ndarray) else value)]
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value if isinstance(value, str | int | bool) or value is None else str(value)
