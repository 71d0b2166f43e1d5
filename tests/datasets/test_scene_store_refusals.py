"""Scene store: invalid input, failures and interruptions."""

import os

import numpy as np
import pytest
from helpers.store import (
    count_marks,
    fail_on,
    give,
    make_cloud,
    make_points,
    point_tasks,
    read_text,
    store_at,
    tree_digest,
)
from kedro.io import DatasetError

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.execution.task import SceneError, SceneTask, SourceFile, StoredResult


def test_failures_are_told_together_after_the_others_have_finished(store, marks, tmp_path):
    for name, text in [("a", "1"), ("b", "bad"), ("c", "bad"), ("d", "4")]:
        (tmp_path / name).write_text(text)
    tasks = {n: SceneTask(read_text, {"path": SourceFile(str(tmp_path / n))}) for n in "abcd"}
    tasks["e"] = SceneTask(read_text, {"path": SourceFile(str(tmp_path / "gone"))})
    with pytest.raises(DatasetError, match="stage 'stage': 3 of 5 scenes failed") as caught:
        store.save(tasks)
    error = caught.value.__cause__
    assert isinstance(error, SceneError)
    assert [f.scene for f in error.failures] == ["b", "c", "e"]
    assert f"scene 'b' ({tmp_path / 'b'}): DataError: {tmp_path / 'b'}: bad text" in str(error)
    assert "gone: cannot be read" in str(error)
    assert "in read_text" in error.failures[0].traceback
    assert not store.exists()
    with pytest.raises(DatasetError, match="is not a complete scene store"):
        store.load()
    for name in "bce":
        tasks.pop(name)
    tasks["a"], tasks["d"] = (SceneTask(read_text, {"path": SourceFile(str(tmp_path / n))}) for n in "ad")
    store.save(tasks)
    assert list(store.load()) == ["a", "d"]


def test_failure_names_the_survey_that_a_stored_cloud_came_from(store, tmp_path):
    store.save({"s": SceneTask(make_points, {}, {"n": 7, "seed": 1})})
    second = store_at(tmp_path / "second")
    with pytest.raises(DatasetError, match=r"scene 's' \(survey\.laz\): ZeroDivisionError: no 7 \(store"):
        second.save({"s": SceneTask(fail_on, {"cloud": store.load()["s"]})})


def test_validator_keeps_wrong_results_out(tmp_path):
    store = store_at(tmp_path / "stage", scene_validator="helpers.store.refuse_negative")
    tasks = {n: SceneTask(give, parameters={"value": {"values": np.array([v])}}) for n, v in [("a", 1), ("b", -1)]}
    with pytest.raises(DatasetError, match="scene 'b': DataError: values must not be negative"):
        store.save(tasks)
    assert (tmp_path / "stage" / "a" / "record.json").exists()
    assert not (tmp_path / "stage" / "b").exists()


def test_interrupt_stops_at_once_and_leaves_a_resumable_store(store, marks, monkeypatch):
    from mlsroad_pipeline.execution import backends

    calls = []

    def stopped(job):
        calls.append(job.key)
        if job.key == "s2":
            raise KeyboardInterrupt
        return real(job)

    real = backends.run_scene
    monkeypatch.setattr(backends, "run_scene", stopped)
    with pytest.raises(KeyboardInterrupt):
        store.save(point_tasks(marks, 5))
    assert calls == ["s0", "s1", "s2"]
    assert not store.exists()
    monkeypatch.undo()
    store.save(point_tasks(marks, 5))
    assert count_marks(marks) == 5


def test_handle_of_a_replaced_result_is_refused(store, marks):
    store.save(point_tasks(marks))
    old = store.load()["s1"]
    store.save(point_tasks(marks, n=51))
    with pytest.raises(ReadError, match="scene 's1' has been computed anew"):
        old.load()
    with pytest.raises(ReadError, match="scene 'nowhere' is not stored"):
        StoredResult(old.url, "nowhere", old.fingerprint).load()


def test_a_run_that_lost_its_store_writes_nothing_more(store, marks):
    storage = store._store
    first = storage.begin()
    second = storage.begin()
    with pytest.raises(DataError.__mro__[1], match="another run has taken this store over"):
        storage.commit("s", "task", make_cloud(1), token=first)
    with pytest.raises(DataError.__mro__[1], match="another run has taken this store over"):
        storage.finish({}, token=first)
    storage.release(first)
    assert storage.is_held(second)
    assert storage.read_record("s") is None


def test_folder_with_other_things_is_left_alone(tmp_path, marks):
    (tmp_path / "survey.laz").write_text("precious")
    with pytest.raises(DatasetError, match=r"is not a scene store but holds \d+ files, such as"):
        store_at(tmp_path).save({})
    assert (tmp_path / "survey.laz").read_text() == "precious"


@pytest.mark.parametrize("key", ["a/b", "", ".", "..", ".hidden", "a b", "manifest.json", "ä", 3])
def test_scene_name_that_cannot_name_a_folder_is_refused(store, key):
    with pytest.raises(DatasetError, match="scene key .* is invalid or reserved"):
        store.save({key: SceneTask(give, parameters={"value": 1})})


@pytest.mark.parametrize(("data", "message"), [([1], "got list"), ({"s": print}, "scene 's': .* got builtin")])
def test_something_else_than_tasks_is_refused(store, data, message):
    with pytest.raises(DatasetError, match=message):
        store.save(data)


@pytest.mark.parametrize(
    ("execution", "message"),
    [
        ({"backend": "spark"}, "backend must be one of .* got 'spark'"),
        ({"n_workers": 0}, "n_workers must be a whole number > 0 or null, got 0"),
        ({"n_workers": True}, "got True"),
        ({"verify": "never"}, "verify must be one of"),
        ({"workers": 2}, r"unknown keys \['workers'\]"),
        ({"scheduler": "tcp://h:1"}, "needs the backend dask, not loky"),
        ({"backend": "dask"}, "dask needs execution.scheduler"),
    ],
)
def test_wrong_settings_are_refused(tmp_path, execution, message):
    with pytest.raises(ParameterError, match=message):
        store_at(tmp_path, execution=execution)


@pytest.mark.parametrize("name", ["nowhere.check", "helpers.store.nothing", "nodots", "helpers.store.DTYPES"])
def test_unknown_validator_is_refused(tmp_path, name):
    with pytest.raises(ParameterError, match="cannot be imported"):
        store_at(tmp_path, scene_validator=name)


@pytest.mark.parametrize("content", [b"", b"\0" * 40, b'{"format": 1, "sce'])
def test_a_damaged_manifest_marks_a_store_that_heals(tmp_path, marks, content):
    root = tmp_path / "stage"
    store_at(root).save(point_tasks(marks))
    expected, before = tree_digest(root), count_marks(marks)
    (root / "manifest.json").write_bytes(content)
    store_at(root).save(point_tasks(marks))
    assert tree_digest(root) == expected
    assert count_marks(marks) == before  # scenes with a record were not computed again


@pytest.mark.parametrize(
    ("name", "manifest"), [("notes.txt", b""), ("s/deep/survey.laz", b""), ("a.png", b'{"icons": []}')]
)
def test_a_manifest_of_others_is_no_store(tmp_path, name, manifest):
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / name).write_text("precious")
    (tmp_path / "manifest.json").write_bytes(manifest)
    with pytest.raises(DatasetError, match="is not a scene store but holds"):
        store_at(tmp_path).save({})
    assert (tmp_path / name).read_text() == "precious"


def test_every_file_is_on_the_disk_before_it_has_its_name(tmp_path, marks, monkeypatch):
    calls = []
    replace, fsync = os.replace, os.fsync

    def traced_replace(source, target):
        calls.append(("replace", os.path.dirname(target), str(source)))
        replace(source, target)

    def traced_fsync(descriptor):
        calls.append(("sync", os.readlink(f"/proc/self/fd/{descriptor}"), ""))
        fsync(descriptor)

    monkeypatch.setattr(os, "replace", traced_replace)
    monkeypatch.setattr(os, "fsync", traced_fsync)
    store_at(tmp_path / "stage").save(point_tasks(marks, 1))
    renamed = [i for i, call in enumerate(calls) if call[0] == "replace"]
    assert len(renamed) == 4  # the run's manifest, the part, its record, the manifest
    for i in renamed:
        _, folder, source = calls[i]
        assert calls[i - 1][:2] == ("sync", source)
        assert calls[i + 1][:2] == ("sync", folder)
