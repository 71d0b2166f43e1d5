"""Plan of the ranges of rows that files are read in, and of the scenes that are joined from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.scenes.binning import BinCounts
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.algorithms.scenes.spans import SceneSpan, plan_scenes
from mlsroad_pipeline.surveys.plan import PlannedFile, SurveyPlan
from mlsroad_pipeline.surveys.reading import FileFacts

MESSAGE_FILES = 3
"""Largest number of files that a message names for a scene."""


@dataclass(frozen=True)
class RangeOfRows:
    """Consecutive rows of a file."""

    file: PlannedFile  # The file
    start: int  # First row and the row after the last one
    stop: int  # First row and the row after the last one
    n_total: int  # Number of points of the whole file
    constant: tuple[str, ...]  # Columns with a single value in the whole file; they are not read

    @property
    def key(self) -> str:
        """Key of the range in the stores."""
        return str(SceneKey.parse(self.file.key)._replace(part=f"{self.start:012d}"))

    def parameters(self, plan: SurveyPlan, ingest: IngestParameters) -> dict[str, Any]:
        """Return the parameters of `reading.read_and_cut`."""
        return {
            "options": plan.options,
            "labels": plan.labels,
            "along": ingest.cut == "along",
            "part": self.file.part,
            "start": self.start,
            "stop": self.stop,
            "n_total": self.n_total,
            "file": self.file.number,
            "bin_length": ingest.bin_length,
            "time_gap": ingest.time_gap,
            "constant": self.constant,
        }


def cut_ranges(plan: SurveyPlan, info: Mapping[str, FileFacts], ingest: IngestParameters) -> list[RangeOfRows]:
    """Divide the files of a survey into ranges of rows."""
    ranges = []
    for file in plan.files:
        n_points = int(info[file.key]["n_points"][0])
        for start in range(0, n_points, ingest.range_points):
            stop = min(start + ingest.range_points, n_points)
            ranges.append(RangeOfRows(file, start, stop, n_points, tuple(info[file.key]["constant"].tolist())))
    return ranges


@dataclass(frozen=True)
class PlannedScene:
    """A scene and the pieces that it is assembled from."""

    key: str  # Key of the scene in the stores
    span: SceneSpan  # Bins of core and buffers
    pieces: tuple[str, ...]  # Keys of the ranges with points in its core, its buffers or its context
    source: str  # Name in messages: the files that its points come from, and the name of the span


def plan_drive(
    drive: str, plan: SurveyPlan, bins: Mapping[str, BinCounts], ingest: IngestParameters
) -> list[PlannedScene]:
    """Plan the scenes of a drive from the bins of its ranges."""
    files = {file.key: file.source.name for file in plan.files if file.drive == drive}
    own = {key: part for key, part in bins.items() if SceneKey.parse(key).parent in files}
    histogram: dict[int, int] = {}
    for part in own.values():
        for number, count in zip(part["bins"].tolist(), part["counts"].tolist(), strict=True):
            histogram[number] = histogram.get(number, 0) + count
    whole = ingest.cut == "file"
    spans = plan_scenes(
        histogram,
        scene_length=ingest.bin_length if whole else ingest.scene_length,
        buffer=0.0 if whole else ingest.buffer,
        context=0.0 if whole else ingest.context,
        bin_length=ingest.bin_length,
        max_points=ingest.max_points,
    )
    scenes = []
    for span in spans:
        key = str(SceneKey.parse(drive)._replace(part=span.id))
        scenes.append(_planned(key, span, pieces_between(*span.reach, own), files))
    return scenes


def _planned(key: str, span: SceneSpan, pieces: tuple[str, ...], files: Mapping[str, str]) -> PlannedScene:
    names = list(dict.fromkeys(files[SceneKey.parse(piece).parent] for piece in pieces))
    more = f" and {len(names) - MESSAGE_FILES} more files" if len(names) > MESSAGE_FILES else ""
    return PlannedScene(key, span, pieces, f"{', '.join(names[:MESSAGE_FILES])}{more} ({span.id})")


def pieces_between(first: int, stop: int, bins: Mapping[str, BinCounts]) -> tuple[str, ...]:
    """Return the keys of the ranges with points in the bins `first` to `stop`."""

    def holds(numbers: NDArray) -> bool:
        low, high = np.searchsorted(numbers, [first, stop])
        return bool(high > low)

    return tuple(key for key, part in bins.items() if holds(part["bins"]))
