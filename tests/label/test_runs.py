"""A finished run is repeated if any file that it has written is damaged or missing."""

import pytest

from mlsroad_pipeline.execution.fingerprints import code_digest
from mlsroad_pipeline.execution.run_folder import RunFolder, entries_of
from mlsroad_pipeline.execution.run_identity import FINISHED, STATE
from mlsroad_pipeline.label import runs
from mlsroad_pipeline.label.runs import finished_record


@pytest.mark.parametrize("content", [None, b"", b"resulT", b"result "])
def test_parts_of_exports_and_photos_are_compared_too(tmp_path, monkeypatch, content):
    monkeypatch.setattr(runs, "planned_paths", lambda *_, **__: {})  # names these files only if they exist
    monkeypatch.setattr(runs, "plan_inputs", lambda _: [])
    part = tmp_path / "out" / "inventory_shp" / "lines.dbf"
    part.parent.mkdir(parents=True)
    part.write_bytes(b"result")
    run = RunFolder(str(tmp_path / "out" / STATE / "one"))
    outputs = [{**entry, "path": "inventory_shp/lines.dbf"} for entry in entries_of([str(part)])]
    run.write({"state": FINISHED, "code": code_digest(), "inputs": [], "outputs": outputs})
    assert finished_record(run, run.read(), None, None)
    if content is None:
        part.unlink()
    else:
        part.write_bytes(content)
    assert not finished_record(run, run.read(), None, None)
