"""A finished run is repeated if one of its results is damaged or missing; copies and exports alone are written again."""

import pytest

from mlsroad_pipeline.execution.fingerprints import code_digest
from mlsroad_pipeline.execution.run_folder import RunFolder, entries_of
from mlsroad_pipeline.execution.run_identity import FINISHED, STATE
from mlsroad_pipeline.label import runs
from mlsroad_pipeline.label.runs import FOR_ALL, missing_outputs
from mlsroad_pipeline.surveys.parameters import LabelParameters

PART = "inventory_shp/lines.dbf"
"""File of an export that is written only where the survey has lines."""


class Plan:
    files = ()


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A finished run with all results of a survey, and one part of an export."""
    monkeypatch.setattr(runs, "plan_inputs", lambda _: [])
    run = RunFolder(str(tmp_path / "out" / STATE / "one"))
    for name in (*FOR_ALL, PART):
        (run.output / name).parent.mkdir(parents=True, exist_ok=True)
        (run.output / name).write_bytes(b"result")
    outputs = [{**e, "path": e["path"][len(f"{run.output}/") :]} for e in entries_of(map(str, run.output.rglob("*.*")))
               if "run.json" not in e["path"]]  # fmt: skip
    run.write({"state": FINISHED, "code": code_digest(), "inputs": [], "outputs": outputs})
    return run


def missing(run, **changes):
    found = missing_outputs(run, run.read(), Plan, LabelParameters("survey.laz", str(run.output), **changes))
    return None if found is None else [path[len(f"{run.output}/") :] for path in found]


def test_what_is_ordered_later_is_missing(run):
    assert missing(run) == []
    assert missing(run, export="csv") == ["inventory.csv", "inventory.csvt"]
    assert missing(run, photos=True) == ["photos/photos.csv"]


@pytest.mark.parametrize("content", [None, b"", b"resulT", b"result "])
def test_damaged_results_run_again_and_damaged_parts_of_exports_are_missing(run, content):
    def damage(name):
        (run.output / name).unlink() if content is None else (run.output / name).write_bytes(content)

    damage(PART)
    assert missing(run) == []  # it is not ordered
    assert PART in missing(run, export="shapefile")
    damage(FOR_ALL[0])
    assert missing(run) is missing(run, export="shapefile") is None
