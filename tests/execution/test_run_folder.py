"""Folder of a run: which files it may replace, also after a kill at any moment, and what remains at its end."""

import inspect
import json
import subprocess
import sys
import time

import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.execution.output_lock import OutputInUseError, lock_output, release_output
from mlsroad_pipeline.execution.run_folder import OutputExistsError, RunFolder, check_closed, entries_of
from mlsroad_pipeline.execution.run_identity import STATE, run_folder, run_settings
from mlsroad_pipeline.label.written_file import write_file
from mlsroad_pipeline.surveys.files import RESULTS


@pytest.fixture
def run(tmp_path):
    return begun(tmp_path / "out", "one", scheme="asprs")


def begun(output, name, overwrite=False, **settings):
    run = RunFolder(str(output / STATE / name), {"label": settings})
    run.write({"settings": run.settings, "state": "unfinished", "inputs": [], "overwrite": overwrite})
    return run


def written(run, name="a.laz", content=b"result"):
    staged = run.staged(run.output / name)
    staged.parent.mkdir(parents=True, exist_ok=True)
    staged.write_bytes(content)
    return staged


def test_the_folder_follows_from_survey_and_settings_alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = {"label": {"survey": "a.laz", "output": "out", "scheme": "asprs"}, "ingest": {"cut": "along"}}
    folder = run_folder(given)
    assert folder.parent == tmp_path / "out" / RESULTS

    def changed(**label):
        return run_folder({**given, "label": {**given["label"], **label}})

    assert changed(survey=[str(tmp_path / "a.laz")]) == folder
    assert changed(overwrite=True, keep_state=True, copc=True) == folder
    assert run_folder({**given, "execution": {"n_workers": 3}}) == folder
    assert len({folder, changed(scheme="tomic2019"), changed(survey="b.laz"), changed(survey=["a.laz", "b.laz"])}) == 4
    assert run_folder({**given, "ingest": {"cut": "file"}}) != folder
    assert changed(output="") is None
    assert run_settings(given)["label"] == {"survey": [str(tmp_path / "a.laz")], "scheme": "asprs"}


def test_masks_and_weights_are_settings_of_the_methods_that_use_images_alone(tmp_path):
    weights = tmp_path / "net.onnx"
    weights.write_bytes(b"one")
    plain = {"label": {"survey": "a.laz", "output": "out", "method": "image_labels"}}
    masks = {"image_labels": {"masks": "train_ids", "weights": None, "classes": "cityscapes", "labels": "labels"}}
    other = {"image_labels": {**masks["image_labels"], "masks": "others"}}
    network = {"image_labels": {"masks": None, "weights": str(weights), "classes": "cityscapes"}}
    found = [run_folder({**plain, **given}) for given in ({}, masks, other, network)]
    weights.write_bytes(b"other network")
    assert len({*found, run_folder({**plain, **network})}) == 5
    trees = {"label": {**plain["label"], "method": "boosted_trees"}}
    assert run_folder({**trees, **masks}) == run_folder(trees) and "image_labels" not in run_settings(
        {**trees, **masks}
    )
    assert "labels" not in run_settings({**plain, **masks})["image_labels"]


def test_a_published_file_is_its_own_and_an_edited_one_is_not(run):
    target = run.publish(written(run))
    assert target == run.output / "a.laz" and target.read_bytes() == b"result"
    assert run.refusal(target) is None
    assert run.publish(written(run, content=b"again")).read_bytes() == b"again"
    target.write_bytes(b"edited")
    assert run.refusal(target) == f"{target} has been edited since it was written"
    with pytest.raises(OutputExistsError, match=r"a\.laz was written by something else during this run; --overwrite"):
        run.publish(written(run))
    assert target.read_bytes() == b"edited"


def test_a_file_of_unknown_origin_and_one_of_another_run_are_named_with_the_reason(run):
    (run.output / "mine.laz").write_bytes(b"mine")
    assert run.refusal(run.output / "mine.laz") == f"{run.output}/mine.laz exists and was not written by label"
    other = begun(run.output, "two", scheme="tomic2019")
    target = other.publish(written(other))
    other.close({}, [], keep_state=False)
    assert run.refusal(target) == (
        f"{target} is a result of another run: label.scheme is 'tomic2019' there and 'asprs' here"
    )
    target.write_bytes(b"edited")
    assert run.refusal(target) == f"{target} has been edited since it was written"


@pytest.mark.parametrize("moved", [False, True])
def test_a_kill_between_journal_and_move_leaves_no_file_of_unknown_origin(run, monkeypatch, moved):
    run.publish(written(run, content=b"first"))
    target = run.output / "a.laz"
    move = __import__("os").replace

    def killed(source, place):
        if str(place) == str(target):
            if moved:
                move(source, place)
            raise KeyboardInterrupt
        move(source, place)

    monkeypatch.setattr("os.replace", killed)
    with pytest.raises(KeyboardInterrupt):
        run.publish(written(run, content=b"second"))
    monkeypatch.undo()
    assert target.read_bytes() == (b"second" if moved else b"first")
    assert run.refusal(target) is None
    assert run.publish(written(run, content=b"third")).read_bytes() == b"third"


def test_with_overwrite_the_old_file_is_whole_until_the_new_one_is(tmp_path):
    run = begun(tmp_path / "out", "one", overwrite=True)
    (run.output / "a.laz").write_bytes(b"old")
    staged = written(run, content=b"new")
    assert (run.output / "a.laz").read_bytes() == b"old"
    assert run.publish(staged).read_bytes() == b"new"
    assert not staged.exists()


def test_the_end_of_a_run_removes_its_stores_and_nothing_else(run, tmp_path):
    run.publish(written(run, "west/a.laz"))
    image = tmp_path / "picture.png"
    image.write_bytes(b"picture")
    for name, marker in (("results", "manifest.json"), ("pieces", "notes.txt"), ("model", "model.json")):
        (run.output / STATE / "one" / name).mkdir()
        (run.output / STATE / "one" / name / marker).write_text("{}")
    (run.output / STATE / "other").mkdir()
    run.close({"n_points": 3}, [str(image), f"{run.path}/model"], keep_state=False)
    left = sorted(p.relative_to(run.path).as_posix() for p in (run.output / STATE / "one").rglob("*") if p.is_file())
    assert left == ["pieces/notes.txt", "run.json"]
    assert (run.output / STATE / "other").is_dir()
    record = json.loads((run.output / STATE / "one" / "run.json").read_text())
    assert record["state"] == "finished" and record["summary"] == {"n_points": 3}
    assert [entry["path"] for entry in record["outputs"]] == ["west/a.laz"]
    assert record["other_inputs"] == entries_of([str(image)])
    assert run.refusal(run.output / "west/a.laz") is None


def test_a_kill_while_stores_are_removed_leaves_none_incomplete(run, monkeypatch):
    results = run.output / STATE / "one" / "results"
    (results / "scene").mkdir(parents=True)
    (results / "manifest.json").write_text("{}")

    def killed(path, **_):
        if "removed" in str(path) and (path / "results" / "manifest.json").exists():
            (path / "results" / "manifest.json").unlink()
            raise KeyboardInterrupt

    monkeypatch.setattr("shutil.rmtree", killed)
    with pytest.raises(KeyboardInterrupt):
        run.close({}, [], keep_state=False)
    monkeypatch.undo()
    assert not results.exists()
    run.remove_state(keep=False)
    assert [path.name for path in (run.output / STATE / "one").iterdir()] == ["run.json"]


@pytest.mark.parametrize("ending", ["-wal", "-shm", "-journal"])
def test_a_geopackage_that_is_open_elsewhere_is_an_error(tmp_path, ending):
    check_closed(tmp_path / "inventory.gpkg")
    (tmp_path / f"inventory.gpkg{ending}").touch()
    with pytest.raises(OutputExistsError, match=rf"is open in another program \(inventory\.gpkg{ending} lies beside"):
        check_closed(tmp_path / "inventory.gpkg")


def test_a_folder_in_the_place_of_a_result_is_an_error(tmp_path):
    (tmp_path / "a.laz").mkdir()
    with pytest.raises(OutputExistsError, match=r"a\.laz is a folder, where a file is to be written: move it away"):
        check_closed(tmp_path / "a.laz")


HOLDER = "import sys, time; from mlsroad_pipeline.execution.output_lock import lock_output; lock_output(sys.argv[1]); "


def test_a_lock_names_its_process_and_ends_with_it(tmp_path):
    command = [sys.executable, "-c", HOLDER + "print('held', flush=True); time.sleep(60)", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(OutputInUseError, match=rf"{tmp_path} is in use by process {holder.pid} on \S+"):
            lock_output(tmp_path)
        holder.kill()
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        try:
            lock_output(tmp_path)
            break
        except OutputInUseError:
            time.sleep(0.05)
    else:
        pytest.fail("the lock outlives its process")
    release_output(tmp_path)
    lock_output(tmp_path)
    release_output(tmp_path)


@pytest.mark.parametrize(("content", "what"), [(b"others", "has changed"), (None, "is gone")])
def test_an_input_that_changes_during_the_run_is_refused(run, tmp_path, content, what):
    survey = tmp_path / "survey.laz"
    survey.write_bytes(b"points")
    run.write({**run.read(), "inputs": entries_of([str(survey)])})
    run.check_input(survey)
    run.check_input(tmp_path / "not_an_input.laz")
    survey.unlink()
    if content is not None:
        survey.write_bytes(content)
    with pytest.raises(ReadError, match=rf"survey\.laz {what} since this run began: nothing is written for it"):
        run.check_input(survey)


def test_nothing_is_written_for_a_file_that_changed_after_it_was_cut(run, tmp_path):
    survey = tmp_path / "survey.laz"
    survey.write_bytes(b"points")
    run.write({**run.read(), "inputs": entries_of([str(survey)])})
    survey.write_bytes(b"others")
    target = run.output / "survey.laz"
    given = {"codes": None, "rows": None, "file": 0, "run": run, "options": None, "n_threads": 1, "had_classes": None}
    parts = inspect.signature(write_file).parameters
    needed = {
        name: None for name, p in parts.items() if p.default is p.empty and name not in (*given, "path", "target")
    }
    with pytest.raises(ReadError, match="has changed since this run began"):
        write_file(str(survey), target=str(target), **needed, **given)
    assert not target.exists() and not run.staged(target).exists()
