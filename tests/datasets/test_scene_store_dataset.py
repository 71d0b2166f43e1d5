"""Scene store in one process: stored, skipped and invalid results."""

import json
import logging
import subprocess
import sys

import fsspec
import numpy as np
import pandas as pd
import pytest
from helpers.store import (
    HERE,
    count_marks,
    give,
    make_cloud,
    make_points,
    point_tasks,
    read_text,
    square,
    store_at,
    sum_up,
    tree_digest,
)
from kedro.io import DataCatalog, DatasetError
from kedro.pipeline import Pipeline, node
from kedro.runner import SequentialRunner

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.execution import fingerprints
from mlsroad_pipeline.execution.digests import digest_json
from mlsroad_pipeline.execution.task import SceneTask, SourceFile


def test_load_gives_handles_in_the_order_of_names(store, marks):
    assert not store.exists()
    tasks = point_tasks(marks, 12)
    store.save(dict(reversed(tasks.items())))
    assert store.exists()
    scenes = store.load()
    assert list(scenes) == sorted(tasks)
    assert len(scenes) == 12
    np.testing.assert_array_equal(scenes["s3"].load().xyz, make_cloud(50, 3).xyz)
    assert "12 scenes" in repr(scenes)
    with pytest.raises(KeyError, match="stage has no scene 'other'"):
        scenes["other"]


def test_parts_are_read_one_by_one(store):
    value = {"points": make_cloud(3), "arrays": {"a": np.arange(3)}, "table": pd.DataFrame({"v": [1]})}
    store.save({"s": SceneTask(give, parameters={"value": value})})
    scenes = store.load()
    assert list(scenes["s"].load()) == ["points", "arrays", "table"]
    assert scenes.part("arrays")["s"].load()["a"].tolist() == [0, 1, 2]
    assert scenes.load_all("table")["s"].v.tolist() == [1]
    assert scenes.part("arrays")["s"].fingerprint != scenes["s"].fingerprint
    with pytest.raises(DataError, match="scene 's' has no part 'other'"):
        scenes.part("other")


def test_result_with_one_named_part_stays_a_mapping(store):
    store.save({"s": SceneTask(give, parameters={"value": {"only": {"a": np.arange(2)}}})})
    assert list(store.load()["s"].load()) == ["only"]


def test_second_run_computes_nothing_and_touches_nothing(store, marks, tmp_path, caplog):
    caplog.set_level(logging.INFO)
    store.save(point_tasks(marks))
    assert "stage: 3 scenes: 3 computed in" in caplog.messages[-1]
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "stage").rglob("*")}
    store.save(point_tasks(marks))
    assert count_marks(marks) == 3
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "stage").rglob("*")} == before
    assert caplog.messages[-1].endswith("3 already valid")


def test_changed_parameter_computes_its_scene_alone(store, marks):
    store.save(point_tasks(marks))
    changed = point_tasks(marks) | {"s1": SceneTask(make_points, {}, {"n": 9, "seed": 1, "marks": str(marks)})}
    store.save(changed)
    assert [count_marks(marks, f"points-{i}") for i in range(3)] == [1, 2, 1]
    assert len(store.load()["s1"].load()) == 9


def test_changed_source_file_computes_its_scene_alone(store, marks, tmp_path):
    for name, text in [("a", "1"), ("b", "22")]:
        (tmp_path / name).write_text(text)
    tasks = {n: SceneTask(read_text, {"path": SourceFile(str(tmp_path / n))}, {"marks": str(marks)}) for n in "ab"}
    store.save(tasks)
    (tmp_path / "b").write_text("333")
    store.save(tasks)
    assert count_marks(marks) == 3
    assert {key: value["length"][0] for key, value in store.load().load_all().items()} == {"a": 1, "b": 3}


def test_a_stage_is_computed_anew_only_where_its_input_has_other_content(store, marks, tmp_path, monkeypatch):
    second = store_at(tmp_path / "second")

    def run():
        store.save(point_tasks(tmp_path, 2))
        parameters = {"marks": str(marks)}
        second.save({key: SceneTask(square, {"cloud": h}, parameters) for key, h in store.load().items()})

    run()
    np.testing.assert_array_equal(second.load()["s1"].load()["values"], make_cloud(50, 1).xyz ** 2)
    store.save(point_tasks(tmp_path, 2, n=51) | {"s0": point_tasks(tmp_path)["s0"]})
    second.save({k: SceneTask(square, {"cloud": h}, {"marks": str(marks)}) for k, h in store.load().items()})
    assert count_marks(marks) == 3
    assert len(second.load()["s1"].load()["values"]) == 51


def test_changed_sources_compute_everything_anew(store, marks, monkeypatch):
    store.save(point_tasks(marks))
    monkeypatch.setattr(fingerprints, "describe_sources", lambda modules: ["edited"])
    store.save(point_tasks(marks))
    assert count_marks(marks) == 6


def test_edited_function_is_noticed(tmp_path):
    script = """
import sys; sys.path.insert(0, sys.argv[1])
from stage_functions import make
from mlsroad_pipeline.datasets.scene_store_dataset import SceneStoreDataset
from mlsroad_pipeline.execution.task import SceneTask
store = SceneStoreDataset(filepath=sys.argv[1] + "/stage", execution={"backend": "sequential"})
store.save({"s": SceneTask(make)})
print(store.load()["s"].load()["a"][0])
"""
    printed = []
    for value in (1, 1, 22):
        text = f"import numpy as np\ndef make():\n    print('called')\n    return {{'a': np.array([{value}])}}\n"
        (tmp_path / "stage_functions.py").write_text(text)
        command = [sys.executable, "-B", "-c", script, str(tmp_path)]
        printed.append(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())
    assert printed == [["called", "1"], ["1"], ["called", "22"]]


@pytest.mark.parametrize("damage", ["truncate", "flip", "remove", "record"])
def test_damaged_result_is_computed_anew(store, marks, tmp_path, damage):
    store.save(point_tasks(marks))
    good = tree_digest(tmp_path / "stage")
    part = tmp_path / "stage" / "s1" / "result.parquet"
    data = bytearray(part.read_bytes())
    if damage == "truncate":
        part.write_bytes(data[:-1])
    elif damage == "flip":
        data[len(data) // 2] ^= 1
        part.write_bytes(data)
    elif damage == "remove":
        part.unlink()
    else:
        record = part.with_name("record.json")
        record.write_text(record.read_text()[:-20])
    assert store.exists() == (damage in ("flip", "record"))
    store.save(point_tasks(marks))
    assert [count_marks(marks, f"points-{i}") for i in range(3)] == [1, 2, 1]
    assert tree_digest(tmp_path / "stage") == good


def test_only_sizes_are_checked_on_demand(tmp_path, marks):
    store = store_at(tmp_path / "stage", execution={**HERE, "verify": "size"})
    store.save(point_tasks(marks, 1))
    part = tmp_path / "stage" / "s0" / "result.parquet"
    data = bytearray(part.read_bytes())
    data[len(data) // 2] ^= 1
    part.write_bytes(data)
    store.save(point_tasks(marks, 1))
    assert count_marks(marks) == 1
    with pytest.raises(ReadError, match=r"s0/result\.parquet: cannot be read: OSError"):
        store.load()["s0"].load()


def test_scenes_of_an_earlier_set_and_temporary_files_go(store, marks, tmp_path):
    store.save(point_tasks(marks, 4))
    (tmp_path / "stage" / "s1" / ".result.parquet.0123.tmp").write_text("half")
    (tmp_path / "stage" / "empty").mkdir()
    store.save(point_tasks(marks, 2))
    files = {p.relative_to(tmp_path / "stage").as_posix() for p in (tmp_path / "stage").rglob("*") if p.is_file()}
    assert files == {"manifest.json"} | {f"{s}/{f}" for s in ("s0", "s1") for f in ("record.json", "result.parquet")}
    assert not (tmp_path / "stage" / "empty").exists()
    assert list(store.load()) == ["s0", "s1"]
    assert count_marks(marks) == 4


def test_kept_scenes_stay_and_are_computed_again_only_where_they_changed(marks, tmp_path):
    kept = store_at(tmp_path / "stage", keep=True)
    tasks = point_tasks(marks, 4)
    kept.save({name: tasks[name] for name in ("s0", "s1")})
    kept.save({name: tasks[name] for name in ("s1", "s2")})
    assert list(kept.load()) == ["s0", "s1", "s2"]
    assert count_marks(marks) == 3
    np.testing.assert_array_equal(kept.load()["s0"].load().xyz, make_cloud(50, 0).xyz)
    (tmp_path / "stage/s0/record.json").unlink()  # an incomplete scene is no result
    kept.save({"s3": tasks["s3"]})
    assert list(kept.load()) == ["s1", "s2", "s3"]
    kept.save({})
    assert list(kept.load()) == ["s1", "s2", "s3"]


def test_parts_of_an_earlier_result_go(store, tmp_path):
    store.save({"s": SceneTask(give, parameters={"value": {"a": {"x": np.ones(1)}, "b": {"x": np.ones(1)}}})})
    store.save({"s": SceneTask(give, parameters={"value": {"b": {"x": np.ones(1)}}})})
    assert sorted(p.name for p in (tmp_path / "stage" / "s").iterdir()) == ["b.npz", "record.json"]


def test_no_scenes_make_a_complete_store(store):
    store.save({})
    assert store.exists()
    assert dict(store.load()) == {}


def test_store_in_memory(marks, request):
    url = f"memory://{request.node.name}"
    store = store_at(url)
    store.save(point_tasks(marks, 3))
    store.save(point_tasks(marks, 2))
    assert store.exists()
    assert count_marks(marks) == 3
    np.testing.assert_array_equal(store.load()["s1"].load().xyz, make_cloud(50, 1).xyz)
    assert not any(".tmp" in p or "s2" in p for p in fsspec.filesystem("memory").find(f"/{request.node.name}"))
    other = store_at(url, execution={"backend": "loky"})
    with pytest.raises(DatasetError, match="only the backends sequential and threading reach this memory"):
        other.save(point_tasks(marks, 5))


def test_same_bytes_on_every_file_system(tmp_path, marks, request):
    store_at(tmp_path / "stage").save(point_tasks(marks))
    store_at(f"memory://{request.node.name}/stage").save(point_tasks(marks))
    memory = fsspec.filesystem("memory")
    root = f"/{request.node.name}/stage/"
    for path in memory.find(root):
        assert memory.cat_file(path) == (tmp_path / "stage" / path.removeprefix(root)).read_bytes()


def test_inputs_may_be_lists_and_whole_collections(store, tmp_path, marks):
    store.save({k: SceneTask(square, {"cloud": make_cloud(4, i)}) for i, k in enumerate("ab")})
    scenes = store.load()
    expected = 3 * sum(make_cloud(4, i).xyz.__pow__(2).sum() for i in range(2))
    second = store_at(tmp_path / "second")
    second.save({"all": SceneTask(sum_up, {"parts": list(scenes.values())}, {"factor": 3})})
    np.testing.assert_allclose(second.load()["all"].load()["total"], expected)
    second.save({"all": SceneTask(give, {"value": scenes})})
    assert list(second.load()["all"].load()) == ["a", "b"]


def test_manifest_and_record_say_the_same(store, tmp_path, marks):
    store.save(point_tasks(marks, 1))
    manifest = json.loads((tmp_path / "stage" / "manifest.json").read_text())
    assert manifest["scenes"] == {"s0": json.loads((tmp_path / "stage" / "s0" / "record.json").read_text())}


def make_tasks(numbers):
    return {f"s{i}": SceneTask(make_points, {}, {"n": 10, "seed": i}) for i in numbers}


def make_squares(scenes):
    return {key: SceneTask(square, {"cloud": handle}) for key, handle in scenes.items()}


def total(scenes):
    return float(sum(value["values"].sum() for value in scenes.load_all().values()))


def test_in_a_kedro_pipeline_with_a_catalog(tmp_path):
    kind = "mlsroad_pipeline.datasets.scene_store_dataset.SceneStoreDataset"
    entries = {n: {"type": kind, "filepath": str(tmp_path / n), "execution": HERE} for n in ("points", "squares")}
    entries["squares"]["scene_validator"] = "helpers.store.refuse_negative"
    catalog = DataCatalog.from_config({**entries, "total": {"type": "MemoryDataset"}})
    catalog["numbers"] = [0, 1]
    pipeline = Pipeline(
        [
            node(make_tasks, "numbers", "points"),
            node(make_squares, "points", "squares"),
            node(total, "squares", "total"),
        ]
    )
    SequentialRunner().run(pipeline, catalog)
    expected = sum((make_cloud(10, i).xyz ** 2).sum() for i in range(2))
    assert catalog.load("total") == pytest.approx(expected)
    assert catalog.exists("squares")


def test_importing_the_store_is_light():
    script = "import sys, mlsroad_pipeline.datasets.scene_store_dataset; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    heavy = {"torch", "open3d", "mlflow", "matplotlib", "pandas", "sklearn", "dask", "distributed", "numba"}
    assert heavy & set(run.stdout.split()) == set()


def store_of_earlier_code(root, tasks, **changes):
    """Rewrite a store as an earlier release wrote it: another fingerprint, of a function in a module since removed."""
    store_at(root).save(tasks)
    manifest = json.loads((root / "manifest.json").read_text())
    for key, record in manifest["scenes"].items():
        call = {"functions": ["mlsroad_pipeline.datasets.removed_work:make_points"], "inputs": [], "parameters": []}
        record |= {"task": digest_json(call), "function": call["functions"][0], **changes}
        (root / key / "record.json").write_text(json.dumps(record))
    (root / "manifest.json").write_text(json.dumps(manifest))


def test_store_of_earlier_code_is_computed_again(tmp_path, marks, caplog):
    caplog.set_level(logging.INFO)
    root = tmp_path / "stage"
    store_at(root).save(point_tasks(marks))
    expected = tree_digest(root)
    store_of_earlier_code(root, point_tasks(marks))
    store = store_at(root)
    assert list(store.load()) == ["s0", "s1", "s2"]  # its files are read as before
    np.testing.assert_array_equal(store.load()["s1"].load().xyz, make_cloud(50, 1).xyz)
    store.save(point_tasks(marks))
    assert count_marks(marks) == 6
    assert "3 scenes: 3 computed" in caplog.messages[-1]
    assert tree_digest(root) == expected


@pytest.mark.parametrize(
    "changes", [{"format": 0}, {"parts": [{"name": "result", "function": "old"}]}, {"parts": "none"}]
)
def test_store_of_another_format_is_refused_in_one_line_until_it_is_computed_again(tmp_path, marks, changes):
    root = tmp_path / "stage"
    store_of_earlier_code(root, point_tasks(marks), **changes)
    store = store_at(root)
    assert not store.exists()
    with pytest.raises(DatasetError, match=r"stage is not a complete scene store: run the stage that fills it$"):
        store.load()
    store.save(point_tasks(marks))
    assert count_marks(marks) == 6
    assert list(store.load()) == ["s0", "s1", "s2"]
