"""How the files of a survey are divided into ranges of rows, and how scenes are put together from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.scenes.cutting import IngestParameters
from mlsroad_pipeline.algorithms.scenes.tiling import SceneSpan, plan_scenes
from mlsroad_pipeline.surveys.plan import PlannedFile, SurveyPlan

MESSAGE_FILES = 3
"""The most files that messages name of a scene that is put together from several."""


@dataclass(frozen=True)
class RangeOfRows:
    """Consecutive rows of a file.

    Parameters
    ----------
    file : PlannedFile
        The file.
    start, stop : int
        The rows.
    n_total : int
        Points of the whole file.
    constant : tuple of str
        Columns that have one value in all of it.
    """

    file: PlannedFile
    start: int
    stop: int
    n_total: int
    constant: tuple[str, ...]

    @property
    def key(self) -> str:
        """Name of the range in the stores."""
        return str(SceneKey.parse(self.file.key)._replace(part=f"{self.start:012d}"))

    def parameters(self, plan: SurveyPlan, ingest: IngestParameters) -> dict[str, Any]:
        """Return the parameters of `ingest_work.read_and_cut`."""
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


def cut_ranges(
    plan: SurveyPlan, info: Mapping[str, Mapping[str, NDArray]], ingest: IngestParameters
) -> list[RangeOfRows]:
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
    """A scene and the pieces that it is assembled from.

    Parameters
    ----------
    key : str
        Its name in the stores.
    span : SceneSpan
        Its bins.
    pieces : tuple of str
        The ranges that hold points of its core or its buffers.
    source : str
        What messages call it: its name, and the files that its points come from.
    """

    key: str
    span: SceneSpan
    pieces: tuple[str, ...]
    source: str


def plan_drive(
    drive: str, plan: SurveyPlan, bins: Mapping[str, Mapping[str, NDArray]], ingest: IngestParameters
) -> list[PlannedScene]:
    """Plan the scenes of a drive from the bins of its ranges."""
    files = {file.key: file.source.name for file in plan.files if file.drive == drive}
    mine = {key: part for key, part in bins.items() if SceneKey.parse(key).parent in files}
    histogram: dict[int, int] = {}
    for part in mine.values():
        for number, count in zip(part["bins"].tolist(), part["counts"].tolist(), strict=True):
            histogram[number] = histogram.get(number, 0) + count
    whole = ingest.cut == "file"
    spans = plan_scenes(
        histogram,
        scene_length=ingest.bin_length if whole else ingest.scene_length,
        buffer=0.0 if whole else ingest.buffer,
        bin_length=ingest.bin_length,
        max_points=ingest.max_points,
    )
    return [
        _planned(f"{drive}.{span.id}", span, pieces_between(span.buffer_first, span.buffer_stop, mine), files)
        for span in spans
    ]


def _planned(key: str, span: SceneSpan, pieces: tuple[str, ...], files: Mapping[str, str]) -> PlannedScene:
    names = list(dict.fromkeys(files[SceneKey.parse(piece).parent] for piece in pieces))
    more = f" and {len(names) - MESSAGE_FILES} more files" if len(names) > MESSAGE_FILES else ""
    return PlannedScene(key, span, pieces, f"{', '.join(names[:MESSAGE_FILES])}{more} ({span.id})")


def pieces_between(first: int, stop: int, bins: Mapping[str, Mapping[str, NDArray]]) -> tuple[str, ...]:
    """Name the ranges that hold points of some bins."""

    def holds(numbers: NDArray) -> bool:
        low, high = np.searchsorted(numbers, [first, stop])
        return bool(high > low)

    return tuple(key for key, part in bins.items() if holds(part["bins"]))
