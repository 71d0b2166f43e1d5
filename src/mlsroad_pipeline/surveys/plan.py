"""Plan of a run: files to read, read options, keys in the stores."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.scene_key import TRAIN, SceneKey
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.algorithms.scenes.splits import SplitPart, split_config
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.surveys.files import Survey, SurveyFile, check_name, files_to_label
from mlsroad_pipeline.surveys.parameters import LabelParameters, SurveyParameters

_LONGEST_KEY = 120
"""Longest key of a file or folder without its split, characters; of longer ones a digest replaces the end."""


@dataclass(frozen=True)
class PlannedFile:
    """A file with its split, its drive and its key."""

    key: str  # Key of the file in the stores (`SceneKey`)
    split: str  # Name of its split
    number: int  # Index among the files of its drive
    drive: str  # Key of the drive, whose files are cut together
    source: SurveyFile  # The file
    part: SplitPart  # Part of the file that belongs to the split


@dataclass(frozen=True)
class SurveyPlan:
    """All files of a run, and how they are read."""

    files: tuple[PlannedFile, ...]  # Files, ordered by split and name
    options: ReadOptions  # Options of the readers
    labels: bool  # Whether labels are read
    skipped: Mapping[str, str] = field(default_factory=dict)  # Name of each file that is left out to the reason

    def drives(self) -> dict[str, list[PlannedFile]]:
        """Return the files of each drive by its key."""
        drives: dict[str, list[PlannedFile]] = {}
        for file in self.files:
            drives.setdefault(file.drive, []).append(file)
        return drives


def trajectory_beside(files: Sequence[PlannedFile]) -> str | None:
    """Return the path of the trajectory of a drive, or None."""
    return next((file.source.trajectory for file in files if file.source.trajectory), None)


def estimated_drives(plan: SurveyPlan, ingest: IngestParameters) -> set[str]:
    """Return the keys of the drives whose trajectory is estimated from the points."""
    if ingest.cut != "along" or not ingest.estimate_trajectory:
        return set()
    return {drive for drive, files in plan.drives().items() if trajectory_beside(files) is None}


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
            drive = key if ingest.cut == "file" else _store_key(split, source.folder)
            number = count.get(drive, 0)
            count[drive] = number + 1
            planned.append(PlannedFile(key, split, number, drive, source, parts.get(split, SplitPart())))
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
    return replace(plan, skipped=listing.skipped)


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
    """Return neighbouring scenes from the middle of the last drive."""
    drive = SceneKey.parse(keys[-1]).parent
    scenes = [key for key in keys if SceneKey.parse(key).parent == drive]
    first = max(0, (len(scenes) - n_scenes) // 2)
    return scenes[first : first + n_scenes]
