"""Plan of a run: files to read, read options, keys in the stores, ranges of rows, scenes."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.scene_key import TRAIN, SceneKey
from mlsroad_pipeline.algorithms.scenes.binning import BinCounts
from mlsroad_pipeline.algorithms.scenes.joining import SceneSpan, plan_scenes
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.algorithms.scenes.splits import SplitPart, split_config
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.surveys.files import Survey, SurveyFile, check_name, files_to_label
from mlsroad_pipeline.surveys.given_classes import GivenParameters, prediction_file
from mlsroad_pipeline.surveys.parameters import LabelParameters, SurveyParameters

if TYPE_CHECKING:
    from mlsroad_pipeline.surveys.reading import FileFacts

_LONGEST_KEY = 120
"""Longest key of a file or folder without its split, characters; of longer ones a digest replaces the end."""


@dataclass(frozen=True)
class PlannedFile:
    """A file with its split, its pass and its key."""

    key: str  # Key of the file in the stores (`SceneKey`)
    split: str  # Name of its split
    number: int  # Index among the files of its pass
    pass_key: str  # Key of the pass, whose files are cut together
    source: SurveyFile  # The file
    part: SplitPart  # Part of the file that belongs to the split


@dataclass(frozen=True)
class SurveyPlan:
    """All files of a run, and how they are read."""

    files: tuple[PlannedFile, ...]  # Files, ordered by split and name
    options: ReadOptions  # Options of the readers
    labels: bool  # Whether labels are read
    skipped: Mapping[str, str] = field(default_factory=dict)  # Name of each file that is left out to the reason
    given: GivenParameters = field(default_factory=GivenParameters)  # Classes that the survey comes with
    predictions: Mapping[str, str] = field(default_factory=dict)  # Key of each file to the file with its predictions

    def passes(self) -> dict[str, list[PlannedFile]]:
        """Return the files of each pass by its key."""
        passes: dict[str, list[PlannedFile]] = {}
        for file in self.files:
            passes.setdefault(file.pass_key, []).append(file)
        return passes


def trajectory_beside(files: Sequence[PlannedFile]) -> str | None:
    """Return the path of the trajectory of a pass, or None."""
    return next((file.source.trajectory for file in files if file.source.trajectory), None)


def estimated_passes(plan: SurveyPlan, ingest: IngestParameters) -> set[str]:
    """Return the keys of the passes whose trajectory is estimated from the points."""
    if ingest.cut != "along" or not ingest.estimate_trajectory:
        return set()
    return {pass_key for pass_key, files in plan.passes().items() if trajectory_beside(files) is None}


def _store_key(split: str, source: str) -> str:
    """Return the key of a file or folder; characters that stores do not accept are replaced by `_` or their code."""
    parts = (split, source)
    safe = [re.sub(r"[^A-Za-z0-9-]", lambda m: "_" if m[0] in "_/ ." else f"_{ord(m[0]):x}_", p) for p in parts]
    if len(safe[1]) > _LONGEST_KEY:  # file systems limit names to 255 bytes
        safe[1] = f"{safe[1][: _LONGEST_KEY - 13]}_{hashlib.blake2b(source.encode(), digest_size=6).hexdigest()}"
    return str(SceneKey(*safe))


def plan_survey(
    splits: Mapping[str, list[SurveyFile]],
    parts: Mapping[str, SplitPart],
    *,
    options: ReadOptions,
    labels: bool,
    ingest: IngestParameters,
) -> SurveyPlan:
    """Plan a run on the files of some splits."""
    planned: list[PlannedFile] = []
    count: dict[str, int] = {}
    for split, files in splits.items():
        for source in files:
            check_name(source.path)
            key = _store_key(split, source.name)
            pass_key = key if ingest.cut == "file" else _store_key(split, source.folder)
            number = count.get(pass_key, 0)
            count[pass_key] = number + 1
            planned.append(PlannedFile(key, split, number, pass_key, source, parts.get(split, SplitPart())))
    for key, n_files in Counter(file.key for file in planned).items():
        if n_files > 1:
            same = ", ".join(file.source.name for file in planned if file.key == key)
            raise ParameterError(f"these files get the same key {key} in the stores, rename one: {same}")
    return SurveyPlan(tuple(planned), options, labels)


def plan_comparison(parameters: SurveyParameters, ingest: IngestParameters, codings: Any) -> SurveyPlan:
    """Plan a comparison."""
    parameters.check_root()
    configured = {name: split_config(value) for name, value in parameters.splits.items() if value is not None}
    files = Survey.at(parameters.root).split_files(configured, trajectory=parameters.trajectory)
    parts = {name: part for name, (_, part) in configured.items()}
    return plan_survey(files, parts, options=parameters.options(codings), labels=True, ingest=ingest)


def plan_labelling(parameters: LabelParameters, ingest: IngestParameters) -> SurveyPlan:
    """Plan the labelling of a survey."""
    for name in ("survey", "output"):
        if not getattr(parameters, name):
            raise ParameterError(f"label.{name} is not set: kedro run --pipelines=label --params=label.{name}=...")
    options = parameters.options()
    text = options.delimiter is None and options.decimal is None  # files that need neither are recognised
    listing = files_to_label(
        Survey.at(parameters.survey), str(parameters.output), trajectory=parameters.trajectory, text=text
    )
    _check_named_trajectory(parameters.trajectory, listing.files)
    plan = plan_survey({"survey": listing.files}, {}, options=options, labels=False, ingest=ingest)
    given = parameters.given_classes
    named = {} if given.labels is None else {f.key: prediction_file(given.labels, f.source.name) for f in plan.files}
    return replace(plan, skipped=listing.skipped, given=given, predictions=named)


def _check_named_trajectory(name: str | None, files: Sequence[SurveyFile]) -> None:
    """Raise ParameterError for a trajectory that was named, and lies beside no file of the survey."""
    if name in (None, LabelParameters.trajectory) or any(file.trajectory is not None for file in files):
        return
    folder = Path(files[0].path).parent
    raise ParameterError(
        f"label.trajectory: {folder / str(name)} does not exist; name a file beside the points, or null for none"
    )


def training_keys(keys: Iterable[str]) -> list[str]:
    """Return the keys of the split ``train``."""
    return [key for key in keys if SceneKey.parse(key).split == TRAIN]


def held_out_keys(keys: Iterable[str]) -> list[str]:
    """Return the keys of all splits but ``train``."""
    return [key for key in keys if SceneKey.parse(key).split != TRAIN]


def middle_scenes(keys: Sequence[str], *, n_scenes: int = 3) -> list[str]:
    """Return neighbouring scenes from the middle of the last pass."""
    pass_key = SceneKey.parse(keys[-1]).parent
    scenes = [key for key in keys if SceneKey.parse(key).parent == pass_key]
    first = max(0, (len(scenes) - n_scenes) // 2)
    return scenes[first : first + n_scenes]


FEW_SCENES, LEAST_PER_SCENE = 50, 20
"""Number of scenes up to which a pass may have fewer points per scene than the second."""

MESSAGE_FILES = 3
"""Largest number of files that a message names for a scene."""


@dataclass(frozen=True)
class RangeOfRows:
    """Consecutive rows of a file."""

    file: PlannedFile  # The file
    # start, stop: first row and the row after the last one
    start: int
    stop: int
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
            **({"given": plan.given} if plan.given.in_use else {}),
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


def plan_pass(
    pass_key: str, plan: SurveyPlan, bins: Mapping[str, BinCounts], ingest: IngestParameters
) -> list[PlannedScene]:
    """Plan the scenes of a pass from the bins of its ranges."""
    files = {file.key: file.source.name for file in plan.files if file.pass_key == pass_key}
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
    _check_scattered(sum(histogram.values()), len(spans), ", ".join(list(files.values())[:MESSAGE_FILES]))
    scenes = []
    for span in spans:
        key, pieces = str(SceneKey.parse(pass_key)._replace(part=span.id)), pieces_between(*span.reach, own)
        names = list(dict.fromkeys(files[SceneKey.parse(piece).parent] for piece in pieces))
        more = f" and {len(names) - MESSAGE_FILES} more files" if len(names) > MESSAGE_FILES else ""
        scenes.append(PlannedScene(key, span, pieces, f"{', '.join(names[:MESSAGE_FILES])}{more} ({span.id})"))
    return scenes


def _check_scattered(n_points: int, n_scenes: int, names: str) -> None:
    """Raise DataError for points that would become far more scenes than they can fill."""
    if n_scenes >= FEW_SCENES and n_points < LEAST_PER_SCENE * n_scenes:
        raise DataError(
            f"{names}: {n_points:,} points would become {n_scenes:,} scenes with fewer than {LEAST_PER_SCENE} points "
            "each: coordinates are damaged, or in other units (read.units)"
        )


def pieces_between(first: int, stop: int, bins: Mapping[str, BinCounts]) -> tuple[str, ...]:
    """Return the keys of the ranges with points in the bins `first` to `stop`."""
    return tuple(key for key, part in bins.items() if np.diff(np.searchsorted(part["bins"], [first, stop]))[0] > 0)
