"""The store of corrections: durability, undo, objects that are found again, damaged and foreign files."""

import os
import signal
import sqlite3
import subprocess
import sys
import textwrap
from contextlib import closing

import pytest
from helpers.corrected import PLACES, object_rows, write_inventory

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.review.corrections import Correction, has_corrections, open_corrections
from mlsroad_pipeline.review.corrections.store import NAME
from mlsroad_pipeline.review.corrections.store_file import FIELDS, TABLES, CorrectionsInUseError


@pytest.fixture
def folder(tmp_path):
    write_inventory(tmp_path, object_rows())
    return tmp_path


def test_states_after_each_action(folder):
    with open_corrections(folder) as store:
        store.add(Correction("accept", 1), who="ann")
        store.add(Correction("reject", 2, payload={"class": "wall"}), who="ann")
        store.add(Correction("other_kind", 3, kind="pole"), who="bob")
        store.add(Correction("move_base", 4, payload={"x": 521, "y": 906.5, "z": 3}), who="bob")
        states = store.object_states()
    kept = {n: (s["status"], s["checked_class"], s["checked_kind"], s["who"]) for n, s in states.items()}
    assert kept == {
        1: ("accepted", "pole", "pole", "ann"),
        2: ("rejected", "wall", "pole", "ann"),
        3: ("changed", "pole", "pole", "bob"),
        4: ("moved", "tree", "tree", "bob"),
    }
    assert (states[4]["x"], states[4]["y"], states[4]["z"]) == (521.0, 906.5, 3.0)


def test_merge_marks_both_objects_and_a_move_survives_accept(folder):
    with open_corrections(folder) as store:
        store.add(Correction("merge", 1, payload={"objects": [2]}), who="a")
        store.add(Correction("move_base", 5, payload={"x": 531, "y": 902, "z": 3}), who="a")
        store.add(Correction("accept", 5), who="a")
        states = store.object_states()
    assert (states[1]["status"], states[2]["status"], states[2]["merged_into"]) == ("merged", "merged", 1)
    assert (states[5]["status"], states[5]["x"]) == ("accepted", 531.0)


def test_undo_restores_the_state_of_before_and_keeps_the_decision(folder):
    with open_corrections(folder) as store:
        store.add(Correction("accept", 1), who="a")
        last = store.add(Correction("reject", 1), who="a")
        store.undo(last, who="b")
        assert store.object_states()[1]["status"] == "accepted"
        assert [(d.identifier, bool(d.undone)) for d in store.history()] == [(1, False), (2, True)]
        with pytest.raises(ParameterError, match="no decision 2 is in force"):
            store.undo(last)


@pytest.mark.parametrize("moved", [0.0, 0.4])
def test_decisions_find_their_objects_in_another_inventory(folder, moved):
    with open_corrections(folder) as store:
        for number, action in ((1, "accept"), (2, "reject"), (3, "accept"), (5, "accept")):
            store.add(Correction(action, number), who="a")
    others = [("pole", -50.0, 0.0), *((kind, x + moved, y) for kind, x, y in PLACES[:4])]
    write_inventory(folder, object_rows(others, [0.5] * 5))
    with open_corrections(folder) as store:
        states = store.states()
    assert {number: state["status"] for number, state in states.of_objects.items()} == {
        2: "accepted", 3: "rejected", 4: "accepted",
    }  # fmt: skip
    assert states.unmatched == []
    (missing,) = states.added  # accepted, and not listed any more
    assert (missing.identifier, missing.correction.action, missing.correction.kind) == (4, "add", "vehicle")
    assert missing.correction.payload == {"x": 530.0, "y": 897.0, "z": 12.0, "class": "vehicle"}


def test_an_accepted_object_that_is_listed_as_another_kind_keeps_its_kind(folder):
    with open_corrections(folder) as store:
        store.add(Correction("accept", 4), who="a")
        store.add(Correction("reject", 5), who="a")
        store.add(Correction("other_kind", 1, kind="sign"), who="a")
    kinds = [("pole", 20.2, 5.0), ("pole", 30.0, -3.0), ("vehicle", 0.1, 0.0)]  # the tree, the vehicle, the pole
    write_inventory(folder, object_rows(kinds, [0.5] * 3))
    with open_corrections(folder) as store:
        states = store.states()
    found = {n: (state["status"], state["checked_kind"]) for n, state in states.of_objects.items()}
    assert found == {1: ("changed", "tree"), 3: ("changed", "sign")}
    assert states.added == []
    assert [decision.correction.action for decision in states.unmatched] == ["reject"]  # of a vehicle, not of a pole


def test_the_last_decision_about_an_object_that_is_not_listed_counts(folder):
    with open_corrections(folder) as store:
        store.add(Correction("accept", 4), who="a")
        store.add(Correction("move_base", 4, payload={"x": 521.0, "y": 905.0, "z": 11.0}), who="a")
        store.add(Correction("accept", 5), who="a")
        last = store.add(Correction("reject", 5), who="a")
        store.add(Correction("other_kind", 3, payload={"class": "building"}), who="a")
    write_inventory(folder, object_rows(PLACES[:1], [0.5]))
    with open_corrections(folder) as store:
        states = store.states()
        assert [(d.correction.kind, d.correction.payload["x"]) for d in states.added] == [("tree", 521.0)]
        assert [decision.identifier for decision in states.unmatched] == [3, 4, 5]
        store.undo(last)
        assert [d.correction.kind for d in store.states().added] == ["tree", "vehicle"]


def test_a_decision_does_not_go_to_the_neighbour_of_its_object(folder):
    """Two poles 1.2 m apart, of which one is gone: the other one is another object."""
    write_inventory(folder, object_rows([("pole", 0.0, 0.0), ("pole", 1.2, 0.0)], [0.5] * 2))
    with open_corrections(folder) as store:
        store.add(Correction("reject", 1), who="a")
    write_inventory(folder, object_rows([("pole", 0.9, 0.0)], [0.5]))
    with open_corrections(folder) as store:
        assert store.object_states() == {} and len(store.states().unmatched) == 1
    write_inventory(folder, object_rows([("pole", 0.3, 0.0)], [0.5]))
    with open_corrections(folder) as store:
        assert store.object_states()[1]["status"] == "rejected"


def test_an_object_of_the_kind_that_the_user_gave_is_found(folder):
    with open_corrections(folder) as store:
        store.add(Correction("other_kind", 5, kind="tree"), who="a")
    write_inventory(folder, object_rows([("tree", 30.2, -3.0)], [0.5]))
    with open_corrections(folder) as store:
        assert store.object_states()[1]["status"] == "changed"


def test_two_inventories_may_be_about_one_object(folder):
    with open_corrections(folder) as store:
        store.add(Correction("accept", 4), who="a")
        write_inventory(folder, object_rows([PLACES[3]], [0.5]))
        store.add(Correction("reject", 1), who="a")
        assert store.object_states()[1]["status"] == "rejected"


def test_a_killed_process_loses_no_decision(folder):
    program = textwrap.dedent(f"""
        from mlsroad_pipeline.review.corrections import Correction, open_corrections
        store = open_corrections({str(folder)!r})
        while True:
            print(store.add(Correction("accept", 1), who="a"), flush=True)
    """)
    worker = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    told = [worker.stdout.readline() for _ in range(20)]
    os.kill(worker.pid, signal.SIGKILL)
    told += worker.stdout.readlines()
    worker.stdout.close()
    worker.wait()
    last = max(int(line) for line in told if line.endswith("\n"))
    with open_corrections(folder) as store:
        assert len(store.current()) in (last, last + 1)


def test_another_process_that_writes_is_told(folder, monkeypatch):
    monkeypatch.setattr("mlsroad_pipeline.review.corrections.store_file.WAIT", 0.05)
    with (
        open_corrections(folder) as store,
        closing(sqlite3.connect(folder / NAME, isolation_level=None)) as other,
    ):
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(CorrectionsInUseError, match="locked by another program: close it there"):
            store.add(Correction("accept", 1), who="a")


def test_damaged_and_foreign_files_are_one_line(folder):
    path = folder / NAME
    path.write_bytes(b"no database" * 500)
    with pytest.raises(ReadError, match=f"{NAME} is damaged or not a store"):
        open_corrections(folder)
    path.unlink()
    with closing(sqlite3.connect(path)) as base:
        base.execute("CREATE TABLE decisions (x)")
    with pytest.raises(ReadError, match="was not written by mlsroad: rename it"):
        open_corrections(folder)
    path.unlink()
    with open_corrections(folder) as store:
        store.add(Correction("accept", 1), who="a")
        with closing(sqlite3.connect(path)) as base, base:
            base.execute("UPDATE decisions SET anchors = 'no'")
        with pytest.raises(ReadError, match="is damaged"):
            store.current()
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("PRAGMA user_version = 9")
    with pytest.raises(ReadError, match="has version 9 of the corrections"):
        open_corrections(folder)
    with pytest.raises(ReadError, match="no such folder: label the survey first"):
        open_corrections(folder / "none")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("CREATE TRIGGER t AFTER INSERT ON decisions BEGIN DELETE FROM decisions; END", "has trigger t, which no"),
        ("CREATE VIEW v AS SELECT * FROM decisions", "has view v, which no"),
        ("CREATE INDEX i ON decisions (who)", "has index i, which no"),
        ("CREATE TABLE more (x)", "has table more, which no"),
        ("ALTER TABLE decisions ADD COLUMN more TEXT", "has other columns"),
        ("UPDATE decisions SET kind = 'role'", "decision 1 has another checksum"),
        ("UPDATE decisions SET undone = 'x'", "decision 1 has another checksum"),
        ("UPDATE decisions SET who = CAST(x'ff41' AS TEXT)", "is damaged"),
    ],
)
def test_changed_tables_and_values_are_one_line(folder, change, message):
    with open_corrections(folder) as store:
        store.add(Correction("other_kind", 3, kind="pole"), who="ann")
    with closing(sqlite3.connect(folder / NAME)) as base, base:
        base.execute(change)
    with pytest.raises(ReadError, match=message), open_corrections(folder) as store:
        store.history()


def test_damage_in_the_schema_is_one_line(folder):
    with open_corrections(folder) as store:
        store.add(Correction("accept", 1), who="ann")
    path = folder / NAME
    whole = path.read_bytes()
    first = whole.index(b"CREATE TABLE decisions")
    for place in range(first - 20, first + 60):
        for mask in (0x80, 0xFF, 0x01):
            path.write_bytes(whole[:place] + bytes([whole[place] ^ mask]) + whole[place + 1 :])
            try:
                with open_corrections(folder) as store:
                    assert [d.correction.object_id for d in store.history()] == [1]
            except ReadError as error:
                assert str(path) in str(error) and "\n" not in str(error)


def test_a_flipped_bit_of_a_decision_is_found(folder):
    with open_corrections(folder) as store:
        store.add(Correction("other_kind", 3, kind="pole", payload={"class": "lamp"}), who="ann")
    path = folder / NAME
    whole = path.read_bytes()
    for text in (b"other_kind", b"polelamp"[:4] + b'{"class"', b'"lamp"', b"ann"):
        place = whole.index(text)
        for bit in range(8):
            path.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << bit]) + whole[place + 1 :])
            with pytest.raises(ReadError, match="is damaged"), open_corrections(folder) as store:
                store.history()


def test_empty_files_links_and_folders_in_place_of_the_store_are_refused(folder, tmp_path_factory):
    path, outside = folder / NAME, tmp_path_factory.mktemp("outside") / "store.sqlite"
    path.write_bytes(b"")
    with pytest.raises(ReadError, match=r"is empty \(0 bytes\): restore it from a backup"):
        open_corrections(folder)
    path.unlink()
    path.symlink_to(outside)
    assert has_corrections(folder)
    with pytest.raises(ReadError, match="is a link, or not a file"):
        open_corrections(folder)
    assert not outside.exists()
    path.unlink()
    path.mkdir()
    with pytest.raises(ReadError, match="is a link, or not a file"):
        open_corrections(folder)
    path.rmdir()
    open_corrections(folder).close()
    path.with_name(f"{NAME}-wal").symlink_to(outside)
    with pytest.raises(ReadError, match="-wal is a link, or not a file"):
        open_corrections(folder)
    assert not outside.exists()


def test_a_store_of_version_1_is_read_and_gets_checksums(folder):
    with open_corrections(folder) as store:
        store.add(Correction("accept", 1), who="ann")
        store.undo(store.add(Correction("reject", 2), who="ann"))
    with closing(sqlite3.connect(folder / NAME)) as base, base:
        rows = base.execute(f"SELECT id, {FIELDS} FROM decisions").fetchall()
        base.execute("DROP TABLE decisions")
        base.execute(TABLES[1])
        base.executemany(f"INSERT INTO decisions (id, {FIELDS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", rows)
        base.execute("PRAGMA user_version = 1")
    for _ in range(2):
        with open_corrections(folder) as store:
            found = [(d.correction.action, bool(d.undone)) for d in store.history()]
        assert found == [("accept", False), ("reject", True)]


def test_a_folder_that_cannot_be_written_is_read_with_its_log(folder, monkeypatch):
    store = open_corrections(folder)
    store.add(Correction("accept", 1), who="ann")  # in the write-ahead log
    before = sorted((path.name, path.stat().st_mtime_ns) for path in folder.iterdir())
    monkeypatch.setattr(os, "access", lambda path, mode: not str(path).startswith(str(folder)))
    with open_corrections(folder, write=False) as copy:
        assert [decision.correction.object_id for decision in copy.current()] == [1]
        with pytest.raises(ReadError, match="cannot be written: change its permissions"):
            copy.add(Correction("accept", 2), who="ann")
    with pytest.raises(ReadError, match="cannot be written: change its permissions"):
        open_corrections(folder)
    assert sorted((path.name, path.stat().st_mtime_ns) for path in folder.iterdir()) == before
    store.close()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("praise", 1), "unknown action 'praise'"),
        (("accept", 0), "object_id must be a number from 1, got 0"),
        (("accept", True), "object_id must be a number"),
        (("accept", 1, None, {"class": 3}), "class must be a name"),
        (("accept", 1, None, {"note": float("nan")}), "not JSON"),
        (("other_kind", 1), "must name what it is"),
        (("merge", 1, None, {"objects": [1]}), "numbers of others"),
        (("merge", 1, None, {"objects": "2"}), "numbers of others"),
        (("split", 1, None, {"bases": [[1, 2, 3]]}), "two or more places"),
        (("move_base", 1, None, {"x": 1, "y": "2", "z": 3}), "x, y, z must be numbers"),
        (("paint", 1, None, {}), "object_id must be left out"),
        (("paint", None, None, {"file": "a.laz", "points": [-1], "class": "c"}), "numbers of points from 0"),
        (("paint", None, None, {"file": "a.laz", "points": [0]}), "class must be given"),
        (("add", None, None, {"x": 1, "y": 2, "z": 3}), "kind must be given"),
        (("reject_line", 1, "kerb", {"line": 1, "x": 1, "y": 2}), "object_id must be left out"),
        (("reject_line", None, "kerb", {"line": 0, "x": 1, "y": 2}), "line, x, y must be numbers"),
        (("accept_line", None, None, {"line": 1, "x": 1, "y": 2}), "kind must be given"),
        (("kind_line", None, "kerb", {"line": 1, "x": 1, "y": 2}), "to must be the right kind, got None"),
    ],
)
def test_wrong_corrections_are_refused(given, message):
    with pytest.raises(ParameterError, match=message):
        Correction(*given)


def test_unknown_objects_and_users_without_a_name_are_refused(folder):
    with open_corrections(folder) as store:
        with pytest.raises(ParameterError, match="the inventory has no object 77"):
            store.add(Correction("accept", 77), who="a")
        with pytest.raises(ParameterError, match="name of the user"):
            store.add(Correction("accept", 1), who=" ")
        assert store.current() == []
