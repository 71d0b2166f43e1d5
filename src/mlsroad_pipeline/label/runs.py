"""Start and end of a run of `label`: files that it writes, what it may replace, what is finished already."""

import logging
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ParameterError, ReadError
from mlsroad_pipeline.execution import run_folder
from mlsroad_pipeline.execution.fingerprints import code_digest
from mlsroad_pipeline.execution.output_lock import lock_output
from mlsroad_pipeline.execution.run_identity import FINISHED
from mlsroad_pipeline.formats.crs import SIDECAR
from mlsroad_pipeline.formats.las.copc import copc_path
from mlsroad_pipeline.formats.native_labels import native_path
from mlsroad_pipeline.formats.ply.coloured_ply import coloured_path
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.inventory_files.exports import EXPORTS
from mlsroad_pipeline.label.photos import FOLDER, TABLE
from mlsroad_pipeline.review.corrections.store import check_corrections
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


logger = logging.getLogger(__name__)


def plan_inputs(plan: SurveyPlan) -> list[dict[str, Any]]:
    """Return the files of a survey and their trajectories as entries of a record."""
    paths = [Path(file.source.path) for file in plan.files]
    paths += [Path(file.source.trajectory) for file in plan.files if file.source.trajectory]
    return run_folder.entries_of(str(path.absolute()) for path in paths)


def open_run(plan: SurveyPlan, parameters: LabelParameters, run: run_folder.RunFolder) -> None:
    """Lock the output, check for every target that it may be written, and begin the record.

    Raises OutputInUseError if another process writes to the output, and OutputExistsError for a file that this run did
    not write, that has been edited, or that was written from input that has changed, unless `label.overwrite` is set.
    """
    targets = existing(planned_paths(plan, run.output, parameters, possible=True))
    lock_output(run.output)
    check_corrections(run.output)
    run.clean()
    before, inputs = run.read(), plan_inputs(plan)
    for target in targets:
        run_folder.check_closed(Path(target))
    refused = _refusals(targets, inputs, before, run)
    if refused and not parameters.overwrite:
        more = f"; {len(refused) - 1} more refused" if len(refused) > 1 else ""
        raise run_folder.OutputExistsError(f"{refused[0]}; {run_folder.OVERWRITE}{more}")
    if refused:
        logger.warning("Replaces %d files: %s", len(refused), refused[0])
        run.remove_stores("written")  # so that all of them are written again
    if before.get("state") == run_folder.UNFINISHED:
        logger.info("Going on with the unfinished run in %s", run.path)
    kept = before.get("outputs", [])
    record = {"settings": run.settings, "code": code_digest(), "inputs": inputs, "outputs": kept}
    run.write({**record, "state": run_folder.UNFINISHED, "overwrite": bool(refused)})


def _refusals(
    targets: Sequence[str], inputs: list[dict[str, Any]], before: Mapping[str, Any], run: run_folder.RunFolder
) -> list[str]:
    """Return why existing targets may not be replaced, one line each."""
    changed = _changed_input(inputs, before)
    refused = []
    for target in targets:
        reason = run.refusal(target)
        if reason is None and changed:
            reason = f"{target} was written from other input: {changed}"
        if reason is not None:
            refused.append(reason)
    return refused


def _changed_input(inputs: list[dict[str, Any]], before: Mapping[str, Any]) -> str | None:
    """Return which input differs from that of the record, in a clause."""
    old = {entry["path"]: entry for entry in before.get("inputs", inputs)}
    new = {entry["path"]: entry for entry in inputs}
    for path in sorted(old.keys() | new.keys()):
        if path not in old or path not in new:
            return f"{path} {'is new' if path in new else 'is missing'}"
        if old[path] != new[path]:
            return f"{path} has changed"
    return None


def missing_outputs(
    run: run_folder.RunFolder, record: Mapping[str, Any], plan: SurveyPlan, parameters: LabelParameters
) -> list[str] | None:
    """Return the copies, exports and photos that a finished run lacks.

    None where it must run again: it is not finished, or its inputs, its code or its other results have changed.
    """
    if record.get("state") != FINISHED or record.get("code") != code_digest():
        return None
    try:
        if _changed_input(plan_inputs(plan), record):
            return None
        others = record.get("other_inputs", [])
        if run_folder.entries_of(entry["path"] for entry in others) != others:
            return None
        versions = run.versions()
        alone = replace(parameters, copc=False, coloured_ply=False, export=(), photos=False)
        needed = planned_paths(plan, run.output, alone)
        wanted = [*planned_paths(plan, run.output, parameters), *_further_parts(run, parameters, versions)]
        lacking = [path for path in dict.fromkeys((*needed, *wanted)) if not _is_written(run, path, versions)]
        return None if set(lacking) & {*needed} else lacking
    except MlsRoadError:  # the run itself reports it
        return None


def _further_parts(run: run_folder.RunFolder, parameters: LabelParameters, versions: Collection[str]) -> list[str]:
    """Return files of an earlier run that depend on its survey, and belong to ordered exports and photos."""
    names = {name for form in parameters.export for name in EXPORTS[form].others}
    photos = [name for name in versions if parameters.photos and PurePosixPath(name).parent == PurePosixPath(FOLDER)]
    return [str(run.output / name) for name in (*sorted(names & {*versions}), *sorted(photos))]


def _is_written(run: run_folder.RunFolder, path: str, versions: Mapping[str, Sequence[Any]]) -> bool:
    """Return whether a file is as the run has written it."""
    return run_folder.state_of(path) in versions.get(Path(path).relative_to(run.output).as_posix(), ())


def is_companion(name: str, written: Collection[str]) -> bool:
    """Return whether a result describes others that a run has written: part of the inventory, or beside a cloud."""
    path = PurePosixPath(name)
    of_all = {file for form in EXPORTS.values() for file in (*form.files, *form.others)} | {*FOR_ALL, TABLE}
    if name in of_all or path.parent == PurePosixPath(FOLDER):
        return FOR_ALL[0] in written
    stem = f"{path.with_suffix('')}."
    return path.suffix == SIDECAR and any(other.startswith(stem) for other in written)
