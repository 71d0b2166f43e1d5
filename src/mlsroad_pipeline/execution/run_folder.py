"""Folder of one run below its output: working state, the files it writes before they are moved, and its record.

```
<output>/.mlsroad/lock                   held by the process that writes to this output
<output>/.mlsroad/<run>/run.json         settings, inputs, outputs with size and digest, state, summary
<output>/.mlsroad/<run>/<stage>/         scene stores; removed at the end
<output>/.mlsroad/<run>/staged/          outputs that are being written
<output>/.mlsroad/<run>/journal/         size and digest of each output, entered before it is moved to its place
```

An output is entered in the journal before it is moved: after a kill it is missing, or its content is known.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ReadError
from mlsroad_pipeline.execution.digests import digest_file, digest_json
from mlsroad_pipeline.execution.run_identity import FINISHED, RECORD, first_difference
from mlsroad_pipeline.execution.store_files import StoreFiles, sync_file, sync_folder

FORMAT = 1
JOURNAL, STAGED, REMOVED = "journal", "staged", "removed"
STORES = ("files", "corridors", "pieces", "results", "objects", "written", "model")
"""Scene stores of a run, and the copy of its model."""

_MARKERS = ("manifest.json", "model.json")

UNFINISHED = "unfinished"  # state of the record of a run that is not finished
OVERWRITE = "--overwrite (label.overwrite=true) replaces it; another output keeps both"
OPEN_ENDINGS = ("-wal", "-shm", "-journal")
"""Endings of the files that SQLite keeps beside a database that is open, or was not closed."""


class OutputExistsError(MlsRoadError):
    """An output would replace a file that this run did not write, or that has been edited."""


class FileState(NamedTuple):
    """Size in bytes and BLAKE2b digest of a file."""

    size: int
    digest: str


def state_of(path: str | Path) -> FileState | None:
    """Return the state of a file, or None if there is none."""
    if not os.path.lexists(path):
        return None
    return FileState(os.stat(path).st_size, digest_file(str(path)))


def entries_of(paths: Iterable[str]) -> list[dict[str, Any]]:
    """Return path, size and digest of the files that exist, sorted by path: the entries of a record."""
    states = {path: state_of(path) for path in sorted(set(paths))}
    return [{"path": path, "bytes": s.size, "blake2b": s.digest} for path, s in states.items() if s is not None]


@dataclass(frozen=True)
class RunFolder:
    """Folder of a run; small and picklable."""

    path: str  # The folder, ``<output>/.mlsroad/<run>``
    # Settings of the run, for its record and for messages
    settings: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)

    @property
    def output(self) -> Path:
        """Output folder of the run."""
        return Path(self.path).parents[1]

    @property
    def _files(self) -> StoreFiles:
        return StoreFiles.at(self.path)

    def read(self) -> dict[str, Any]:
        """Return the record, empty if there is none of this format."""
        record = self._files.read_json(RECORD)
        return record if isinstance(record, dict) and record.get("format") == FORMAT else {}

    def write(self, record: Mapping[str, Any]) -> None:
        """Write the record atomically."""
        self._files.write_json(RECORD, {"format": FORMAT, **record})

    def clean(self) -> None:
        """Remove unfinished files of a killed process; the caller holds the lock of the output."""
        for folder in (Path(self.path), Path(self.path, JOURNAL)):
            for part in folder.glob(".*.tmp"):
                part.unlink(missing_ok=True)

    def others(self) -> list[RunFolder]:
        """Return the other runs of this output."""
        folders = sorted(path.parent for path in Path(self.path).parent.glob(f"*/{RECORD}"))
        return [RunFolder(str(folder)) for folder in folders if str(folder) != self.path]

    def versions(self) -> dict[str, list[FileState]]:
        """Return the states that each output may have if nobody else has changed it, by path below the output."""
        found = {
            entry["path"]: [FileState(entry["bytes"], entry["blake2b"])] for entry in self.read().get("outputs", ())
        }
        for path in sorted(Path(self.path, JOURNAL).glob("*.json")):
            entry = self._files.read_json(f"{JOURNAL}/{path.name}")
            found[entry["path"]] = [FileState(*state) for state in entry["versions"]]
        return found

    def _versions_of(self, name: str) -> list[FileState]:
        """Return the entry of one output in `versions`, from its own file of the journal: outputs may be thousands."""
        entry = self._files.read_json(f"{JOURNAL}/{digest_json(name)}.json")
        if entry is not None:
            return [FileState(*state) for state in entry["versions"]]
        outputs = self.read().get("outputs", ())
        return [FileState(entry["bytes"], entry["blake2b"]) for entry in outputs if entry["path"] == name]

    def check_input(self, path: str | Path) -> None:
        """Raise ReadError if an input is no longer the file that the record of the run names: its rows have moved."""
        known = {entry["path"]: entry for entry in self.read().get("inputs", ())}
        before = known.get(str(Path(path).absolute()))
        now = state_of(path)
        if before is not None and (now is None or now != FileState(before["bytes"], before["blake2b"])):
            what = "is gone" if now is None else "has changed"
            raise ReadError(f"{path} {what} since this run began: nothing is written for it; run the command again")

    def staged(self, target: str | Path) -> Path:
        """Return the path at which an output is written before it is moved to its place."""
        return Path(self.path, STAGED, self._name(target))

    def target(self, staged: str | Path) -> Path:
        """Return the place of an output that was written at its staged path."""
        return self.output / Path(staged).relative_to(Path(self.path, STAGED))

    def publish(self, staged: str | Path) -> Path:
        """Enter a written file in the journal, move it to its place and return that."""
        target = self.target(staged)
        sync_file(staged)
        name, fresh, now = self._name(target), state_of(staged), state_of(target)
        known = [state for state in self._versions_of(name) if state == now]
        if now is not None and not known and not self.read().get("overwrite"):
            raise OutputExistsError(f"{target} was written by something else during this run; {OVERWRITE}")
        check_closed(target)
        self._files.write_json(f"{JOURNAL}/{digest_json(name)}.json", {"path": name, "versions": [*known, fresh]})
        target.parent.mkdir(parents=True, exist_ok=True)
        os.replace(staged, target)
        sync_folder(target.parent)
        return target

    def fingerprint_data(self) -> str:
        """Return the representation of the run in fingerprints of tasks."""
        return self.path

    def _name(self, target: str | Path) -> str:
        return Path(target).relative_to(self.output).as_posix()

    def refusal(self, target: str | Path) -> str | None:
        """Return why this run may not replace an existing file, or None if it may."""
        now, name = state_of(target), self._name(target)
        if now is None:
            return None
        own = self.versions().get(name)
        if own is not None and now in own:
            return None
        for other in self.others():
            if now in other.versions().get(name, ()):
                what = first_difference(other.read().get("settings"), self.settings) or "its settings are the same"
                return f"{target} is a result of another run: {what}"
        if own is not None or any(name in other.versions() for other in self.others()):
            return f"{target} has been edited since it was written"
        return f"{target} exists and was not written by label"

    def remove_stale(self, is_companion: Callable[[str, Collection[str]], bool]) -> list[str]:
        """Remove results of replaced runs that this run has not written, if they are unedited; return their names.

        `is_companion` returns whether a file of a given name belongs to the files that this run has written.
        """
        journal = (self._files.read_json(f"{JOURNAL}/{path.name}") for path in Path(self.path, JOURNAL).glob("*.json"))
        written = {entry["path"] for entry in journal}
        known: dict[str, list[FileState]] = {}
        for run in (self, *self.others()):
            for name, states in run.versions().items():
                known.setdefault(name, []).extend(states)
        stale = sorted(
            name
            for name, states in known.items()
            if name not in written and is_companion(name, written) and state_of(self.output / name) in states
        )
        for name in stale:
            (self.output / name).unlink()
        return stale

    def remove_stores(self, *names: str) -> None:
        """Remove scene stores of this run; folders that are none stay.

        A store is renamed first: what a kill leaves of it is no incomplete store.
        """
        removed = Path(self.path, REMOVED)
        for name in names:
            folder = Path(self.path, name)
            if any((folder / marker).is_file() for marker in _MARKERS):
                removed.mkdir(exist_ok=True)
                shutil.rmtree(removed / name, ignore_errors=True)
                os.replace(folder, removed / name)
        shutil.rmtree(removed, ignore_errors=True)

    def close(self, summary: Mapping[str, Any], sources: Iterable[str], *, keep_state: bool) -> None:
        """Record the run as finished, with its outputs and all files it has read, and remove its working state.

        `sources` are the files that tasks have read, such as images; files of the run itself are left out.
        """
        record = self.read()
        known = {entry["path"] for entry in record["inputs"]}
        others = {str(Path(path).absolute()) for path in sources} - known
        outside = [path for path in others if not Path(path).is_relative_to(self.path)]
        outputs = [
            {**entry, "path": self._name(entry["path"])}
            for entry in entries_of(str(self.output / name) for name in self.versions())
        ]
        closed = {"state": FINISHED, "overwrite": False, "outputs": outputs, "other_inputs": entries_of(outside)}
        self.write({**record, **closed, "summary": dict(summary)})
        self.remove_state(keep=keep_state)

    def remove_state(self, *, keep: bool) -> None:
        """Remove the working state of a finished run; `keep` keeps its stores and its model."""
        shutil.rmtree(Path(self.path, JOURNAL), ignore_errors=True)
        shutil.rmtree(Path(self.path, STAGED), ignore_errors=True)
        if not keep:
            self.remove_stores(*STORES)


def check_closed(target: Path) -> None:
    """Raise OutputExistsError for a folder in place of a file, and for a GeoPackage that another program has open."""
    if target.is_dir():
        raise OutputExistsError(f"{target} is a folder, where a file is to be written: move it away")
    if target.suffix.lower() != ".gpkg":
        return
    beside = [target.name + ending for ending in OPEN_ENDINGS if os.path.lexists(f"{target}{ending}")]
    if beside:
        raise OutputExistsError(f"{target} is open in another program ({beside[0]} lies beside it): close it there")
