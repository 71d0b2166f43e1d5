"""An unusable database of runs gives an error that names it and a remedy."""

import socket
import sqlite3
import threading
import time
from contextlib import closing
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

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
