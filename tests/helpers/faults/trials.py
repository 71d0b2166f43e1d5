"""Trials: a command with one disturbed operation on files, then the same command again, in processes that are forked."""

from __future__ import annotations

import hashlib
import json
import mmap
import os
import re
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

KINDS = {"fail": 1, "full": 2, "tear": 3, "kill": 4, "delay": 5}
"""Disturbances: an input/output error; a disk that is full from then on; half of a write and the end of the process;
the end of the process right after; 0.15 s before."""

UNREACHED = "not reached"
"""Fault of a trial whose run has fewer operations than the one that was listed."""

PLACE = Path(__file__).parent


def build(folder: Path) -> Path:
    """Compile the library that disturbs operations."""
    target = folder / "faults.so"
    subprocess.run(["gcc", "-shared", "-fPIC", "-O1", "-o", str(target), str(PLACE / "shim.c"), "-ldl"], check=True)
    return target


class Trials:
    """A process that has loaded all libraries and forks one process per run.

    Parameters
    ----------
    work : Path
        Folder for the library, the project and the results; results are below ``work/root``.
    command : str
        Name of a function of `commands`.
    """

    def __init__(self, work: Path, command: str) -> None:
        self.root, self._control = work / "root", work / "control"
        temporary = self.root / "temporary"
        temporary.mkdir(parents=True)
        self._control.write_bytes(bytes(32))
        with self._control.open("r+b") as stream:
            self._mapped = mmap.mmap(stream.fileno(), 32)
        places = os.pathsep.join([str(PLACE.parents[1]), *(place for place in sys.path if place)])
        environment = {
            **os.environ,
            **{"PYTHONPATH": places, "LD_PRELOAD": str(build(work)), "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
            **{
                "FAULT_ROOT": str(self.root),
                "TMPDIR": str(temporary),
                "FAULT_CONTROL": str(self._control),
                "FAULT_LIST": str(work / "list"),
            },
        }
        reading, writing = os.pipe()
        line = [sys.executable, "-W", "ignore", "-m", "helpers.faults.commands", command, str(work), str(writing)]
        with (work / "server.log").open("wb") as log:
            streams = {"stdin": subprocess.PIPE, "stdout": log, "stderr": log}
            self._server = subprocess.Popen(line, env=environment, text=True, pass_fds=[writing], **streams)
        os.close(writing)
        self._answers = os.fdopen(reading)
        self._log = work / "run.log"

    def run(self, output: str, *, at: int = 0, kind: str = "fail") -> tuple[int, int, int]:
        """Run the command into a folder below the root; return its status, its operations and the disturbed ones."""
        self._mapped[:] = struct.pack("<4q", 0, at, KINDS[kind], 0)
        assert self._server.stdin is not None
        self._server.stdin.write(output + "\n")
        self._server.stdin.flush()
        status = int(self._answers.readline())
        count, _, _, hits = struct.unpack("<4q", self._mapped[:])
        return status, count, hits

    def operations(self, output: str) -> list[str]:
        """Run the command and return its operations on files, such as ``rename /whole/a.laz``."""
        listed = self._log.with_name("list")
        listed.write_text("")
        status, count, _ = self.run(output, at=-1)
        found = listed.read_text().splitlines()
        assert status == 0 and count == len(found), self.said
        return found

    @property
    def said(self) -> str:
        """The last line that the last run wrote."""
        lines = self._log.read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""

    def close(self) -> None:
        """End the process."""
        assert self._server.stdin is not None
        self._server.stdin.close()
        self._server.wait()
        self._answers.close()

    def __enter__(self) -> Trials:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


VARYING = re.compile(rb"\d{4}-\d\d-\d\dT[\d:.]+Z|\d{4}-\d\d-\d\d \d\d:\d\d(:\d\d)?")


def results(folder: Path) -> dict[str, str]:
    """Return the digests of the files of a folder, less dates, the records of runs and what MLflow keeps."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        records = name.endswith(("run.json", "record.json", "manifest.json", ".mlsroad/lock"))
        if not path.is_file() or records or name.startswith(("mlartifacts/", "mlflow.db")):
            continue
        content = VARYING.sub(b"", path.read_bytes()).replace(str(folder).encode(), b"")
        found[name] = hashlib.blake2b(content, digest_size=8).hexdigest()
    return found


def distinct(operations: list[str]) -> list[int]:
    """Return the numbers, from 1, of the first and the last of consecutive operations of one kind on one file."""
    ends = [k for k in range(1, len(operations)) if operations[k] != operations[k - 1]]
    return sorted({1, len(operations), *ends, *(end + 1 for end in ends)})


def tries(trials: Trials, expected: dict[str, str], points: Iterator[tuple[int, str]]) -> Iterator[dict[str, Any]]:
    """Disturb one operation after the other; yield each trial with what is wrong after the same command again."""
    for at, kind in points:
        output = trials.root / f"{kind}{at}"
        status, _, hits = trials.run(output.name, at=at, kind=kind)
        first = trials.said if status else ""
        wrong = [] if hits else [UNREACHED]
        partial = {k: v for k, v in results(output).items() if not k.startswith(".mlsroad")} if output.exists() else {}
        wrong += [
            f"{name} differs after the fault"
            for name, d in partial.items()
            if expected.get(name) != d and not _hidden(name)
        ]
        status, _, _ = trials.run(output.name)
        if status:
            wrong.append(f"the same command again: {trials.said}")
        found = results(output) if output.exists() else {}
        wrong += [name for name in sorted(expected.keys() | found.keys()) if expected.get(name) != found.get(name)]
        yield {"kind": kind, "at": at, "said": first, "wrong": wrong}
        shutil.rmtree(output, ignore_errors=True)


def _hidden(name: str) -> bool:
    return any(part.startswith(".") for part in name.split("/"))


def _say(row: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(row) + "\n")
    sys.stdout.flush()


def main() -> int:
    """Disturb every distinct operation, or every n-th: ``python -m helpers.faults.trials FOLDER COMMAND [KINDS] [n] [FIRST]``.

    FIRST leaves out the operations before it, to go on with trials that were ended. Return 1 if a trial failed, or if
    no run reached the operation to disturb.
    """
    work, command = Path(sys.argv[1]), sys.argv[2]
    kinds = (sys.argv[3] if len(sys.argv) > 3 else ",".join(KINDS)).split(",")
    step, first = (int((sys.argv[place:] or ["1"])[0]) for place in (4, 5))
    with Trials(work, command) as trials:
        trials.run("warm")  # the first run makes the database of MLflow that later ones copy
        operations = trials.operations("whole")
        expected, places = results(trials.root / "whole"), distinct(operations)
        _say({"operations": len(operations), "distinct": len(places), "files": len(expected)})
        failed = done = 0
        for trial in tries(trials, expected, ((at, kind) for kind in kinds for at in places[::step] if at >= first)):
            if trial["wrong"] == [UNREACHED]:  # MLflow writes less often in some runs
                continue
            done += 1
            failed += bool(trial["wrong"])
            if trial["wrong"]:
                _say({**trial, "operation": operations[trial["at"] - 1]})
            if done % 50 == 0:
                _say({"done": done, "failed": failed, "last": trial})
        _say({"tries": done, "failures": failed})
    return int(failed > 0 or done == 0)


if __name__ == "__main__":
    sys.exit(main())
