"""An unusable database of runs gives an error that names it and a remedy."""

import os
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import closing
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import mlflow
import pytest
from helpers.wiring import REPOSITORY, empty_store
from mlflow.entities import ViewType

from mlsroad_pipeline.hooks import mlflow_run as tracking_store
from mlsroad_pipeline.hooks.mlflow_run import TrackingStoreError, check_tracking_store


@pytest.fixture
def store(tmp_path):
    path = tmp_path / "mlflow.db"
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE runs (id INTEGER)")
    return path


def test_a_store_that_works_is_left_as_it_is(store):
    before = store.read_bytes()
    check_tracking_store(f"sqlite:///{store}")
    assert store.read_bytes() == before


def test_deleted_runs_are_removed_for_good_by_the_documented_command(tmp_path, monkeypatch):
    (tmp_path / "mlflow.db").write_bytes(empty_store())
    page = (REPOSITORY / "docs/mlflow.md").read_text(encoding="utf-8")
    address, *command = next(line for line in page.splitlines() if " mlflow gc " in line).split()
    assert command[-2:] == ["--older-than", "30d"]
    monkeypatch.chdir(tmp_path)
    client = mlflow.MlflowClient("sqlite:///mlflow.db")
    experiment = client.create_experiment("mlsroad", artifact_location=(tmp_path / "mlartifacts").as_uri())
    kept, gone = (client.create_run(experiment).info.run_id for _ in range(2))
    for run in (kept, gone):
        client.log_text(run, "text", "report.html")
    client.delete_run(gone)
    program = [sys.executable, "-m", *command[:-2]]
    environment = {**os.environ, **dict([address.split("=", 1)])}
    subprocess.run(program, env=environment, check=True, capture_output=True)
    assert [run.info.run_id for run in client.search_runs([experiment], run_view_type=ViewType.ALL)] == [kept]
    files = [path for path in (tmp_path / "mlartifacts").rglob("*") if path.is_file()]
    assert [path.relative_to(tmp_path / "mlartifacts").parts[0] for path in files] == [kept]


@pytest.mark.parametrize("uri", ["", "databricks", "sqlite:///:memory:"])
def test_other_addresses_are_not_asked(uri):
    check_tracking_store(uri)


def test_a_store_that_is_not_there_yet_is_not_made(tmp_path):
    check_tracking_store(f"sqlite:///{tmp_path / 'mlflow.db'}")
    assert not list(tmp_path.iterdir())


def test_a_locked_store_is_named(store):
    with closing(sqlite3.connect(store, isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(TrackingStoreError, match=rf"{store}: database is locked: another program holds it"):
            check_tracking_store(f"sqlite:///{store}", wait=0.1)
    check_tracking_store(f"sqlite:///{store}", wait=0.1)


def test_another_file_is_named(store):
    store.write_bytes(b"no database at all, but long enough to be taken for one" * 50)
    with pytest.raises(TrackingStoreError, match=rf"{store}: file is not a database: it is damaged"):
        check_tracking_store(f"sqlite:///{store}")


def test_a_store_that_cannot_be_written_is_named(store, monkeypatch):
    class ReadOnly(sqlite3.Connection):
        def execute(self, *arguments):
            raise sqlite3.OperationalError("attempt to write a readonly database")

    connect = sqlite3.connect
    monkeypatch.setattr(tracking_store.sqlite3, "connect", lambda *a, **k: connect(*a, factory=ReadOnly, **k))
    with pytest.raises(TrackingStoreError, match="readonly database: it cannot be written"):
        check_tracking_store(f"sqlite:///{store}")


def test_a_server_that_does_not_answer_is_named_within_the_time_to_wait():
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen(1)  # it accepts and never answers
        port = listening.getsockname()[1]
        start = time.monotonic()
        with pytest.raises(TrackingStoreError, match=rf"127\.0\.0\.1:{port} .*MLFLOW_TRACKING_URI"):
            check_tracking_store(f"http://user:secret@127.0.0.1:{port}", wait=0.3)
        assert time.monotonic() - start < 5
    with pytest.raises(TrackingStoreError) as refused:
        check_tracking_store(f"http://user:secret@127.0.0.1:{port}", wait=0.3)
    assert "secret" not in str(refused.value)


def test_a_server_that_answers_anything_is_taken():
    with ThreadingHTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as server:  # 501 to every request
        threading.Thread(target=server.serve_forever, daemon=True).start()
        check_tracking_store(f"http://127.0.0.1:{server.server_port}")
        server.shutdown()
