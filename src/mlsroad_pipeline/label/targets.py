"""Files that `label` writes for a survey, by their paths."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.formats.las.copc import copc_path
from mlsroad_pipeline.formats.native_labels import native_path
from mlsroad_pipeline.formats.ply.coloured_ply import coloured_path
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.inventory_files.exports import EXPORTS
from mlsroad_pipeline.label.photos import FOLDER, TABLE
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import PlannedFile, SurveyPlan

FOR_ALL = ("inventory.gpkg", "inventory.parquet", "inventory.qml", "report.html")
"""Results on all files together, in the output folder."""


_LONGEST_NAME = 215
"""Longest name of a result, bytes: file systems have 255, and an unfinished file has 39 more."""


def labelled_path(file: PlannedFile, folder: Path) -> str:
    """Return the path of the labelled LAZ of a file; subfolders are mirrored."""
    name = PurePosixPath(file.source.name)
    stem = name.name[: -len(".gz")] if name.name.lower().endswith(".gz") else name.name
    stem = PurePosixPath(stem).stem.removesuffix(".copc")  # the result is not in the order of an octree
    return str(folder / name.parent / f"{stem}.laz")


def paths_of(file: PlannedFile, folder: Path, parameters: LabelParameters) -> tuple[str, ...]:
    """Return the paths of all results for one file: LAZ, copies, and the copy in its own format."""
    target = labelled_path(file, folder)
    copies = [copc_path(target)] * parameters.copc + [coloured_path(target)] * parameters.coloured_ply
    return (target, *copies, *_native(file, target))


def _native(file: PlannedFile, target: str) -> list[str]:
    source = Path(file.source.path)
    try:
        own = native_path(source, Path(target).parent, get_format(source))
    except ReadError:  # the reading reports it
        return []
    return [] if own is None else [str(own)]


def planned_paths(
    plan: SurveyPlan, folder: Path, parameters: LabelParameters, *, possible: bool = False
) -> dict[str, str]:
    """Return the paths of all results and what each holds; raise ParameterError if two have the same path.

    With `possible` they include files that are written only with a reference system or a trajectory.
    """
    sources = {os.path.realpath(file.source.path) for file in plan.files}
    formats = [EXPORTS[name] for name in parameters.export]
    names = [
        *FOR_ALL,
        *([TABLE] * parameters.photos),
        *(name for form in formats for name in (*form.files, *(form.others if possible else ()))),
    ]
    if possible and parameters.photos:
        names += [path.relative_to(folder).as_posix() for path in sorted(folder.glob(f"{FOLDER}/*.jpg"))]
    found = {str(folder / name): "a result on the whole survey" for name in names}
    taken = next((path for path in found if os.path.realpath(path) in sources), None)
    if taken is not None:
        raise ParameterError(f"{taken} is a file of the survey; choose another label.output")
    for file in plan.files:
        for path in paths_of(file, folder, parameters):
            if os.path.realpath(path) in sources:
                raise ParameterError(f"{path} is a file of the survey; choose another label.output")
            if path in found:
                raise ParameterError(
                    f"{path} would hold {file.source.name} and {found[path]}: rename one, or label them separately"
                )
            _check_length(path, file.source.name)
            found[path] = file.source.name
    return found


def _check_length(path: str, source: str) -> None:
    """Raise ParameterError for a name without room for the endings of a file that is being written."""
    n_bytes = len(os.fsencode(os.path.basename(path)))
    if n_bytes > _LONGEST_NAME:
        raise ParameterError(
            f"{source}: the name of its result has {n_bytes} bytes, at most {_LONGEST_NAME} can be written: rename it"
        )


def existing(paths: Iterable[str]) -> list[str]:
    """Return the paths that exist, broken links included."""
    return [path for path in paths if os.path.lexists(path)]
