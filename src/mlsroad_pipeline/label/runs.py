"""Start and end of a run of `label`: what it may replace, what it goes on with, and what is finished already."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.execution.fingerprints import code_digest
from mlsroad_pipeline.execution.output_lock import lock_output
from mlsroad_pipeline.execution.run_folder import (
    OVERWRITE,
    UNFINISHED,
    OutputExistsError,
    RunFolder,
    check_closed,
    entries_of,
    state_of,
)
from mlsroad_pipeline.execution.run_identity import FINISHED
from mlsroad_pipeline.formats.crs import SIDECAR
from mlsroad_pipeline.inventory_files.exports import EXPORTS
from mlsroad_pipeline.label.photos import FOLDER, TABLE
from mlsroad_pipeline.label.targets import FOR_ALL, existing, planned_paths
from mlsroad_pipeline.review.corrections.store import check_corrections
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import SurveyPlan

logger = logging.getLogger(__name__)


def plan_inputs(plan: SurveyPlan) -> list[dict[str, Any]]:
    """Return the files of a survey and their trajectories as entries of a record."""
    paths = [Path(file.source.path) for file in plan.files]
    paths += [Path(file.source.trajectory) for file in plan.files if file.source.trajectory]
    return entries_of(str(path.absolute()) for path in paths)


def open_run(plan: SurveyPlan, parameters: LabelParameters, run: RunFolder) -> None:
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
        check_closed(Path(target))
    refused = _refusals(targets, inputs, before, run)
    if refused and not parameters.overwrite:
        more = f"; {len(refused) - 1} more refused" if len(refused) > 1 else ""
        raise OutputExistsError(f"{refused[0]}; {OVERWRITE}{more}")
    if refused:
        logger.warning("Replaces %d files: %s", len(refused), refused[0])
        run.remove_stores("written")  # so that all of them are written again
    if before.get("state") == UNFINISHED:
        logger.info("Going on with the unfinished run in %s", run.path)
    kept = before.get("outputs", [])
    record = {"settings": run.settings, "code": code_digest(), "inputs": inputs, "outputs": kept}
    run.write({**record, "state": UNFINISHED, "overwrite": bool(refused)})


def _refusals(
    targets: Sequence[str], inputs: list[dict[str, Any]], before: Mapping[str, Any], run: RunFolder
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


def finished_record(run: RunFolder, record: Mapping[str, Any], plan: SurveyPlan, parameters: LabelParameters) -> bool:
    """Return whether a run is finished and its inputs, its code and all of its results are unchanged."""
    if record.get("state") != FINISHED or record.get("code") != code_digest():
        return False
    try:
        if _changed_input(plan_inputs(plan), record):
            return False
        others = record.get("other_inputs", [])
        if entries_of(entry["path"] for entry in others) != others:
            return False
        versions = run.versions()
        targets = [Path(target) for target in planned_paths(plan, run.output, parameters)]
        names = {target.relative_to(run.output).as_posix() for target in targets} | versions.keys()
        return all(state_of(run.output / name) in versions.get(name, ()) for name in names)
    except MlsRoadError:  # the run itself reports it
        return False


def is_companion(name: str, written: Collection[str]) -> bool:
    """Return whether a result describes others that a run has written: part of the inventory, or beside a cloud."""
    path = PurePosixPath(name)
    of_all = {file for form in EXPORTS.values() for file in (*form.files, *form.others)} | {*FOR_ALL, TABLE}
    if name in of_all or path.parent == PurePosixPath(FOLDER):
        return FOR_ALL[0] in written
    stem = f"{path.with_suffix('')}."
    return path.suffix == SIDECAR and any(other.startswith(stem) for other in written)
