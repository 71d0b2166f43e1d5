"""Decisions in ten sessions with one disturbed write, sync, truncation or removal: none that was acknowledged is lost."""

import shutil
import tempfile
from pathlib import Path

import pytest
from helpers.faults.trials import Trials

from mlsroad_pipeline.review.corrections import open_corrections

STEP = 9
"""Every so many operations are disturbed here; all of them by `STEP = 1`, in some minutes."""

pytestmark = pytest.mark.skipif(
    shutil.which("gcc") is None, reason="the library that disturbs files is compiled by gcc"
)


@pytest.fixture(scope="module")
def trials():
    memory = "/dev/shm" if Path("/dev/shm").is_dir() else None
    with tempfile.TemporaryDirectory(dir=memory) as folder, Trials(Path(folder), "corrections") as running:
        yield running


def check(trials, output):
    """Compare what was acknowledged with what the store has."""
    told = trials.root.parent / "acknowledged"
    lines = told.read_text().split("\n")[:-1] if told.exists() else []
    added, undone = ({line.split()[1] for line in lines if line.startswith(what)} for what in ("added", "undone"))
    told.write_text("")
    if not (trials.root / output).is_dir():
        assert not lines
        return 0
    with open_corrections(trials.root / output) as store:
        found = {decision.who: bool(decision.undone) for decision in store.history()}
    assert added <= found.keys()
    assert all(found[who] for who in undone)
    return len(added)


@pytest.mark.parametrize("kind", ["fail", "full", "tear", "kill"])
def test_no_acknowledged_decision_is_lost(trials, kind):
    check(trials, "nothing")
    operations = trials.operations(f"whole_{kind}")
    assert check(trials, f"whole_{kind}") == 30
    assert {line.split()[0] for line in operations} >= {"pwrite64", "fdatasync"} or len(operations) > 100
    first = {"fail": 1, "full": 2, "tear": 3, "kill": 4}[kind]
    reached = 0
    for at in range(first, len(operations) + 1, STEP):
        _, _, hits = trials.run(f"{kind}{at}", at=at, kind=kind)
        reached += bool(hits)
        check(trials, f"{kind}{at}")
    assert reached > len(operations) // STEP // 2
