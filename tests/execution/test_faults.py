"""A disturbed write, sync, rename or removal: an error or a killed process, and the same command again ends as if undisturbed.

The suite disturbs every second operation of a small store whose results are published, each in one of five ways.
``MLSROAD_FAULTS=store`` disturbs each of them in every way; ``label`` or ``train`` each distinct operation of a run of
`label` or of a training instead, which takes hours;
``python -m helpers.faults.trials FOLDER label tear,fail 6``, in the folder of the tests, a sample of them.
"""

import os
import shutil
import tempfile
from pathlib import Path

import pytest
from helpers.faults.trials import KINDS, UNREACHED, Trials, distinct, main, results, tries

SAMPLE = "MLSROAD_FAULTS" not in os.environ
COMMAND = os.environ.get("MLSROAD_FAULTS", "store")

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="the library that disturbs files needs gcc")


@pytest.fixture(scope="module")
def trials():
    memory = "/dev/shm" if Path("/dev/shm").is_dir() else None  # syncing takes most of the time on a disk
    with tempfile.TemporaryDirectory(dir=memory) as folder, Trials(Path(folder) / "work", COMMAND) as running:
        yield running


def test_an_undisturbed_run_has_operations_to_disturb(trials):
    operations = trials.operations("first")
    assert {name.split()[0] for name in operations} >= {"write", "fsync", "rename", "mkdir"}
    assert any(name.startswith("rename /first/s0.bin") for name in operations) or COMMAND != "store"


@pytest.mark.parametrize("kind", KINDS)
def test_every_disturbed_operation_heals(trials, kind):
    operations = trials.operations(f"whole_{kind}")
    expected = results(trials.root / f"whole_{kind}")
    places = distinct(operations)
    if SAMPLE:
        places = places[list(KINDS).index(kind) :: 2 * len(KINDS)]
    found = list(tries(trials, expected, ((at, kind) for at in places)))
    assert [trial for trial in found if trial["wrong"]] == []
    assert len(found) == len(places) > 5


@pytest.mark.parametrize(("wrong", "status"), [([UNREACHED], 1), (["a differs"], 1), ([], 0)])
def test_trials_that_reach_no_operation_fail(tmp_path, monkeypatch, capsys, wrong, status):
    (tmp_path / "whole").mkdir()
    monkeypatch.setattr(Trials, "__init__", lambda self, work, command: setattr(self, "root", work))
    monkeypatch.setattr(Trials, "run", lambda self, output: (0, 1, 0))
    monkeypatch.setattr(Trials, "operations", lambda self, output: ["write /whole/a"])
    monkeypatch.setattr(Trials, "close", lambda self: None)
    monkeypatch.setattr("helpers.faults.trials.tries", lambda *_: iter([{"kind": "fail", "at": 1, "wrong": wrong}]))
    monkeypatch.setattr("sys.argv", ["trials", str(tmp_path), "store"])
    assert main() == status
    assert '"tries"' in capsys.readouterr().out
