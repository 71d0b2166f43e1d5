"""The server that workers are forked from: it starts with the driver, or leaves the workers to themselves."""

import subprocess
import sys

START = "from mlsroad_pipeline.execution import fork_server; print(fork_server.start('json'), fork_server.is_started())"


def started(**environment):
    done = subprocess.run(
        [sys.executable, "-c", START], capture_output=True, text=True, timeout=60, check=False, env=environment
    )
    return done.returncode, done.stdout.split(), done.stderr


def test_a_folder_too_long_for_a_socket_is_no_error(tmp_path, monkeypatch):
    long = tmp_path / ("x" * 110)
    long.mkdir()
    path = ":".join(sys.path)
    assert started(PYTHONPATH=path) == (0, ["True", "True"], "")
    assert started(PYTHONPATH=path, TMPDIR=str(long)) == (0, ["False", "False"], "")
