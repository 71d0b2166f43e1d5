"""Results of before each learning: they are kept without their bytes, compared, and put back step by step."""

import json
import os
import time

import laspy
import numpy as np
import pytest
from helpers.page_output import write_laz

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.execution.run_folder import entries_of
from mlsroad_pipeline.execution.run_identity import finished_record
from mlsroad_pipeline.formats.las.header import read_header, with_class_names
from mlsroad_pipeline.review.corrections.kept_results import (
    KEPT,
    STEPS,
    changed_points,
    keep_results,
    kept_folders,
    move_table,
    put_back,
)
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput

XYZ = np.random.default_rng(1).uniform(0, 9, (300, 3))


def write_run(folder, run, codes, *names):
    """Write results and their record, as `label` does: new files replace those of before."""
    write_laz(folder / "new.laz", XYZ, codes, np.zeros(300, int))
    os.replace(folder / "new.laz", folder / "street.laz")
    for name in names:
        (folder / f"{name}.part").write_text(run)
        os.replace(folder / f"{name}.part", folder / name)
    outputs = [
        {**entry, "path": os.path.relpath(entry["path"], folder)}
        for entry in entries_of(str(folder / name) for name in ("street.laz", *names))
    ]
    record = {"format": 1, "state": "finished", "settings": {"label": {"run": run}}, "inputs": [], "outputs": outputs}
    place = folder / ".mlsroad" / run
    place.mkdir(parents=True, exist_ok=True)
    (place / "run.json").write_text(json.dumps({**record, "summary": {"run": run}}))
    time.sleep(0.02)  # the newest record is in force


@pytest.fixture
def folder(tmp_path):
    write_run(tmp_path, "older", np.full(300, 3), "report.html")
    write_run(tmp_path, "one", np.repeat([2, 6, 64], 100), "report.html", "inventory.gpkg")
    (tmp_path / "corrections.sqlite").write_text("decisions")
    keep_results(LabelledOutput.at(tmp_path))
    return tmp_path


def learned(folder):
    write_run(folder, "two", np.repeat([2, 5, 64], [120, 80, 100]), "report.html", "inventory.csv")
    (folder / "inventory.gpkg").unlink()


def test_the_results_and_their_record_come_back(folder):
    before = {name: (folder / name).read_bytes() for name in ("street.laz", "report.html", "inventory.gpkg")}
    learned(folder)
    assert finished_record(folder)["summary"] == {"run": "two"}
    put_back(folder)
    assert {name: (folder / name).read_bytes() for name in before} == before
    assert finished_record(folder)["summary"] == {"run": "one"}
    LabelledOutput.at(folder).check_unedited()
    assert not (folder / "inventory.csv").exists() and not (folder / ".mlsroad/two").exists()
    assert (folder / "corrections.sqlite").read_text() == "decisions"
    with pytest.raises(ReadError, match="no learning to undo"):
        put_back(folder)


def test_learnings_are_undone_one_after_the_other(folder):
    states = [(folder / "street.laz").read_bytes()]
    learned(folder)
    for k in range(STEPS):
        keep_results(LabelledOutput.at(folder))
        states.append((folder / "street.laz").read_bytes())
        write_run(folder, f"later{k}", np.full(300, 11 + k), "report.html")
    names = [f"{KEPT}-{number}" for number in range(2, STEPS + 2)]
    assert [kept.name for kept in kept_folders(folder)] == names  # the first is gone
    assert {path.name for path in (folder / ".mlsroad").glob(f"{KEPT}*")} == set(names)
    for state in states[:0:-1]:
        put_back(folder)
        assert (folder / "street.laz").read_bytes() == state
        LabelledOutput.at(folder).check_unedited()
    assert finished_record(folder)["summary"] == {"run": "two"}
    with pytest.raises(ReadError, match=f"the last {STEPS} learnings"):
        put_back(folder)


def test_a_learning_that_ended_without_results_is_no_step(folder):
    keep_results(LabelledOutput.at(folder))
    assert [kept.name for kept in kept_folders(folder)] == [f"{KEPT}-1"]


def test_what_an_earlier_version_kept_comes_back(folder):
    before = (folder / "street.laz").read_bytes()
    os.replace(folder / f".mlsroad/{KEPT}-1", folder / ".mlsroad" / KEPT)
    learned(folder)
    keep_results(LabelledOutput.at(folder))
    write_run(folder, "three", np.full(300, 9), "report.html")
    put_back(folder)
    put_back(folder)
    assert (folder / "street.laz").read_bytes() == before


def test_an_edited_result_is_not_replaced(folder):
    learned(folder)
    (folder / "report.html").write_text("edited")
    with pytest.raises(DataError, match=r"report\.html was edited since the learning"):
        put_back(folder)
    assert (folder / "report.html").read_text() == "edited" and (folder / ".mlsroad" / f"{KEPT}-1").is_dir()


def test_an_undo_that_was_killed_is_done_again(folder):
    before = (folder / "street.laz").read_bytes()
    learned(folder)
    os.replace(folder / ".mlsroad" / f"{KEPT}-1" / "results/street.laz", folder / "street.laz")
    put_back(folder)
    assert (folder / "street.laz").read_bytes() == before
    assert finished_record(folder)["summary"] == {"run": "one"}


def test_kept_files_share_their_bytes_with_the_results(folder):
    kept = folder / ".mlsroad" / f"{KEPT}-1" / "results/street.laz"
    assert os.path.samefile(kept, folder / "street.laz")
    learned(folder)
    assert not os.path.samefile(kept, folder / "street.laz")


def test_points_that_change_are_counted_by_class(folder):
    learned(folder)
    table = changed_points(folder)
    counts = {row["class"]: (row["before"], row["after"], row["changed"], row["to"]) for _, row in table.iterrows()}
    names = list(counts)
    assert sorted(counts.values()) == sorted(
        [(100, 120, 0, ""), (0, 80, 0, ""), (100, 0, 100, names[1]), (100, 100, 0, "")]
    )


def test_names_of_classes_are_whole(folder):
    learned(folder)
    for path in (folder / "street.laz", folder / ".mlsroad" / f"{KEPT}-1" / "results/street.laz"):
        header = with_class_names(
            read_header(path), {2: "paved ground and kerbs", 64: "Stra\u00dfenbeleuchtung", 5: "tree"}
        )
        las = laspy.read(path)
        las.header.vlrs.extend(laspy.VLR(v.user_id, v.record_id, record_data=v.data) for v in header.vlrs[-1:])
        las.write(path)
    record = folder / ".mlsroad/two/run.json"
    summary = {"classes": {"Stra\u00dfenbeleuchtung": 3, "paved ground and kerbs": 1}}
    record.write_text(json.dumps({**json.loads(record.read_text()), "summary": summary}))
    assert set(changed_points(folder)["class"]) == {"paved ground and kerbs", "tree", "6", "Stra\u00dfenbeleuchtung"}


def test_a_table_of_moves_names_the_class_that_most_points_get():
    counts = np.zeros((256, 256), int)
    counts[2, [2, 5, 6]] = 10, 3, 4
    (row,) = move_table(counts, {2: "ground", 6: "wall"}).query("before > 0").to_dict("records")
    assert row == {"class": "ground", "before": 17, "after": 10, "changed": 7, "to": "wall"}
