"""Copies, exports and photos of a finished run that were ordered later: written from its results, without labelling."""

import logging
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import Any

from mlsroad_pipeline.execution.output_lock import lock_output
from mlsroad_pipeline.execution.run_folder import OVERWRITE, OutputExistsError, RunFolder, entries_of
from mlsroad_pipeline.formats.las.copc import copc_path, write_copc
from mlsroad_pipeline.formats.ply.coloured_ply import coloured_path, write_coloured_ply
from mlsroad_pipeline.inventory_files.exports import EXPORTS
from mlsroad_pipeline.inventory_files.geopackage import read_geopackage
from mlsroad_pipeline.label.images import images_of_survey
from mlsroad_pipeline.label.inventory import export_inventory
from mlsroad_pipeline.label.photos import FOLDER, write_photos
from mlsroad_pipeline.label.runs import FOR_ALL, labelled_path
from mlsroad_pipeline.label.summary import LabelSummary, moved_summary
from mlsroad_pipeline.review.corrections import has_corrections, open_corrections
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import SurveyPlan

logger = logging.getLogger(__name__)

_THREADS = 2


def write_further_outputs(
    run: RunFolder, missing: Sequence[str], plan: SurveyPlan, parameters: LabelParameters
) -> LabelSummary:
    """Write the outputs that a finished run lacks, enter them in its record, and return its summary.

    Raises OutputInUseError if another run writes to the output, and OutputExistsError for a file of the user's.
    """
    lock_output(run.output)
    run.clean()
    refused = next((reason for path in missing if (reason := run.refusal(path))), None)
    if refused is not None:
        raise OutputExistsError(f"{refused}; {OVERWRITE}")
    clouds = _copies(run, missing, plan)
    written = [*clouds, *_of_inventory(run, missing, plan, parameters)]
    logger.info("Wrote %d further files of the finished run in %s", len(written), run.output)
    record = run.read()
    summary = moved_summary(record["summary"], run.output)
    outputs = summary["outputs"]
    exports = list(dict.fromkeys([*outputs["exports"], *written[len(clouds) :]]))
    outputs = {**outputs, "clouds": list(dict.fromkeys([*outputs["clouds"], *clouds])), "exports": exports}
    summary = {**summary, "outputs": outputs}
    new = [{**entry, "path": Path(entry["path"]).relative_to(run.output).as_posix()} for entry in _entries(run)]
    names = {entry["path"] for entry in new}
    kept = [entry for entry in record["outputs"] if entry["path"] not in names]
    run.write({**record, "outputs": [*kept, *new], "summary": summary})
    return summary


def _entries(run: RunFolder) -> list[dict[str, Any]]:
    """Return the entries of the files in the journal, which are those that were written now."""
    before = {entry["path"]: entry["blake2b"] for entry in run.read()["outputs"]}
    changed = [
        name for name, states in run.versions().items() if before.get(name) not in {state.digest for state in states}
    ]
    return entries_of(str(run.output / name) for name in changed)


def _copies(run: RunFolder, missing: Sequence[str], plan: SurveyPlan) -> list[str]:
    """Write the copies of labelled files."""
    written = []
    for file in plan.files:
        source = labelled_path(file, run.output)
        for target in (copc_path(source), coloured_path(source)):
            if target not in missing:
                continue
            staged = run.staged(target)
            staged.parent.mkdir(parents=True, exist_ok=True)
            if target == copc_path(source):
                write_copc(source, str(staged), n_threads=_THREADS)
            else:
                write_coloured_ply(source, str(staged))
            written.append(str(run.publish(staged)))
    return written


def _of_inventory(run: RunFolder, missing: Sequence[str], plan: SurveyPlan, parameters: LabelParameters) -> list[str]:
    """Write exports and photos of the inventory of the run."""
    names = {Path(path).relative_to(run.output).as_posix() for path in missing}
    formats = [name for name in parameters.export if names & {*EXPORTS[name].files, *EXPORTS[name].others}]
    with_photos = any(name.startswith(f"{FOLDER}/") for name in names)
    if not formats and not with_photos:
        return []
    if formats and has_corrections(run.output):
        with open_corrections(run.output, write=False) as store:
            n = len(store.current())
        if n:
            logger.warning(
                "The exports hold the objects as labelled, without %d %s: mlsroad export %s -o FILE writes "
                "the corrected ones", n, "decision" if n == 1 else "decisions", quote(str(run.output)),
            )  # fmt: skip
    inventory = read_geopackage(run.output / FOR_ALL[0])
    written = export_inventory(inventory, formats, run)
    if with_photos:
        written.append(write_photos(inventory.objects, images_of_survey(plan, parameters.images), run))
    return written
