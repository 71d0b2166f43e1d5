"""Results of a survey as they were before each learning: kept as hard links, compared, and put back step by step."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.execution.run_folder import FileState, RunFolder, check_closed, state_of
from mlsroad_pipeline.execution.run_identity import RECORD, STATE, finished_record
from mlsroad_pipeline.formats.files import write_atomic
from mlsroad_pipeline.formats.las.header import ENTRY, class_names, read_header
from mlsroad_pipeline.formats.las.records import RecordReader
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput

KEPT = "before_learn"
"""Name, before a number, of the folders below the state of an output that hold the results of before a learning."""

STEPS = 5
"""Number of learnings that can be undone."""

_NOTE, _RESULTS, _RUNS = "kept.json", "results", "runs"
_CHUNK = 2_000_000  # points that are read at once


def keep_results(output: LabelledOutput) -> None:
    """Keep the results of an output, beside those of the last `STEPS` - 1 learnings."""
    kept = kept_folders(output.path)
    if kept and kept_note(output.path)["outputs"] == output.record["outputs"]:  # the learning ended without results
        shutil.rmtree(kept.pop())
    place = output.path / STATE / f"{KEPT}-{_number(kept[-1]) + 1 if kept else 1}"
    new = place.with_name(f"{KEPT}.new")
    shutil.rmtree(new, ignore_errors=True)
    for entry in output.record["outputs"]:
        target = new / _RESULTS / entry["path"]
        target.parent.mkdir(parents=True, exist_ok=True)
        _link(output.path / entry["path"], target)
    runs = _runs(output.path)
    for name in runs:
        shutil.copytree(output.path / STATE / name, new / _RUNS / name)
    note = {"outputs": list(output.record["outputs"]), "runs": runs, "summary": output.record["summary"]}
    (new / _NOTE).write_text(json.dumps(note), encoding="utf-8")
    os.replace(new, place)
    for old in kept[: 1 - STEPS]:
        shutil.rmtree(old)


def kept_folders(folder: Path) -> list[Path]:
    """Return the folders with what was kept of an output, that of the last learning last."""
    found = [note.parent for note in (folder / STATE).glob(f"{KEPT}*/{_NOTE}")]
    return sorted((kept for kept in found if re.fullmatch(rf"{KEPT}(-\d+)?", kept.name)), key=_number)


def _number(kept: Path) -> int:
    return int(kept.name.removeprefix(KEPT).removeprefix("-") or 0)  # earlier versions kept one, without a number


def _runs(folder: Path) -> list[str]:
    return sorted(path.parent.name for path in (folder / STATE).glob(f"*/{RECORD}"))


def _link(source: Path, target: Path) -> None:
    """Link a file, or copy it where the file system has no links; results are replaced, never changed in place."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def kept_note(folder: Path) -> Mapping[str, Any]:
    """Return what was kept of a folder before the last learning; ReadError if nothing was."""
    kept = kept_folders(folder)
    if not kept:
        raise ReadError(f"{folder}: no learning to undo: mlsroad learn keeps the results of the last {STEPS} learnings")
    path = kept[-1] / _NOTE
    try:
        note: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ReadError(f"{path} is damaged ({error}): label the survey again (--overwrite)") from error
    return note


def put_back(folder: Path) -> None:
    """Put the results of before the last learning in the place of the present ones.

    Raises ReadError if none were kept, and DataError if a present result was edited.
    """
    note, place = kept_note(folder), kept_folders(folder)[-1]
    runs = [RunFolder(str(folder / STATE / name)) for name in _runs(folder)]
    versions: dict[str, list[FileState]] = {}
    for run in runs:
        for name, states in run.versions().items():
            versions.setdefault(name, []).extend(states)
    for entry in note["outputs"]:
        versions.setdefault(entry["path"], []).append(FileState(entry["bytes"], entry["blake2b"]))
    for name, known in versions.items():
        now = state_of(folder / name)
        if now is not None and now not in known:
            raise DataError(f"{folder / name} was edited since the learning: move it away, then undo")
        check_closed(folder / name)
    for entry in note["outputs"]:
        source, target = place / _RESULTS / entry["path"], folder / entry["path"]
        if source.is_file():  # else an undo that was killed has moved it
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(source, target)
    old = {entry["path"] for entry in note["outputs"]}
    for name in versions.keys() - old:
        (folder / name).unlink(missing_ok=True)
    for run in runs:
        if Path(run.path).name not in note["runs"]:
            shutil.rmtree(run.path)
    for name in note["runs"]:
        (folder / STATE / name).mkdir(exist_ok=True)
        for file in sorted((place / _RUNS / name).glob("*")):
            target = folder / STATE / name / file.name
            write_atomic(target, file.read_bytes())
            os.utime(target, ns=(file.stat().st_atime_ns, file.stat().st_mtime_ns))  # the newest record is in force
    shutil.rmtree(place)


def changed_points(folder: Path) -> pd.DataFrame:
    """Return, by class, the points before and after the last learning, those that changed, and what most became."""
    note, place = kept_note(folder), kept_folders(folder)[-1]
    counts, names = np.zeros((256, 256), np.int64), dict[int, str]()
    for entry in note["outputs"]:
        name = entry["path"]
        if not name.lower().endswith(".laz") or ".copc." in name.lower():
            continue
        old, new = place / _RESULTS / name, folder / name
        names |= class_names(read_header(old)) | class_names(read_header(new))
        counts += _moves(old, new)
    return move_table(counts, _whole(names, note["summary"], (finished_record(folder) or {}).get("summary", {})))


def _whole(names: Mapping[int, str], *summaries: Mapping[str, Any]) -> dict[int, str]:
    """Return names of codes as the runs have them: files hold 15 characters."""
    known = [str(name) for summary in summaries for name in summary.get("classes", ())]
    by_cut = {name.encode("ascii", "replace")[: ENTRY["name"].itemsize].decode(): name for name in known}
    return {code: by_cut.get(name, name) for code, name in names.items()}


def _moves(old: Path, new: Path) -> NDArray[np.int64]:
    """Return the number of points of each pair of classes before and after, of a file."""
    counts = np.zeros((256, 256), np.int64)
    headers = read_header(old), read_header(new)
    n_points = min(header.n_points for header in headers)
    with RecordReader(old, headers[0]) as before, RecordReader(new, headers[1]) as after:
        for start in range(0, n_points, _CHUNK):
            pair = [
                reader.read(start, min(start + _CHUNK, n_points))["classification"].astype(np.int64)
                for reader in (before, after)
            ]
            counts += np.bincount(pair[0] * 256 + pair[1], minlength=256 * 256).reshape(256, 256)
    return counts


def move_table(counts: NDArray[np.integer], names: Mapping[int, str]) -> pd.DataFrame:
    """Return the table of a matrix of numbers before and after, with the names of its classes."""
    before, after, kept = counts.sum(axis=1), counts.sum(axis=0), counts.diagonal()
    used = np.flatnonzero(before + after)
    others = counts - np.diag(kept)
    rows = [
        {
            "class": names.get(int(code), str(code)),
            "before": int(before[code]),
            "after": int(after[code]),
            "changed": int(before[code] - kept[code]),
            "to": names.get(int(others[code].argmax()), str(int(others[code].argmax()))) if others[code].any() else "",
        }
        for code in used
    ]
    return pd.DataFrame(rows, columns=["class", "before", "after", "changed", "to"])
