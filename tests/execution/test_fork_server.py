"""The server that workers are forked from: it starts with the driver, or leaves the workers to themselves."""

import fcntl
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

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


@pytest.fixture
def short():
    """Return a folder with a short path, as sockets need one."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def test_a_killed_driver_leaves_no_folder_for_ever(short):
    (short / "mlsroad-data").mkdir()
    code = f"{START}; import sys; sys.stdin.read()"
    environment = {"PYTHONPATH": ":".join(sys.path), "TMPDIR": str(short)}
    streams = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-uc", code], env=environment, **streams) as killed:
        assert killed.stdout.readline() == "True True\n"
        killed.kill()
    (left,) = short.glob("mlsroad-????????")
    assert [path.name.partition("-")[0] for path in left.rglob("*") if path.is_socket()] == ["listener"]
    assert started(**environment)[1] == ["True", "True"]
    assert left.exists()  # it may be that of a process that has not locked it yet
    used = short / "mlsroad-used"
    used.mkdir()
    with (used / ".scratch-lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        for folder in (left, used):
            os.utime(folder, (1, 1))
        assert started(**environment)[1] == ["True", "True"]
        assert sorted(short.iterdir()) == [short / "mlsroad-data", used]


FORKED = """
import logging, signal, sys, threading
from multiprocessing import forkserver, get_context
from mlsroad_pipeline.execution import fork_server

def reply(queue):
    forked = "colorsys" in sys.modules  # the server imports it, the worker does not
    state = logging.root.handlers, signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    queue.put((forked, *state))

def main():
    logging.basicConfig()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    event = threading.Event()
    if "thread" in sys.argv:
        threading.Thread(target=event.wait).start()
    fork_server.start("json", lambda: __import__("colorsys"))
    queue = get_context("forkserver").SimpleQueue()
    worker = get_context("forkserver").Process(target=reply, args=(queue,))
    worker.start()
    print(*queue.get(), "colorsys" in sys.modules)
    worker.join()
    fork_server.stop()
    event.set()
"""


@pytest.mark.parametrize("thread", [False, True])
def test_the_server_is_forked_from_a_driver_without_threads_and_leaves_its_set_up_behind(thread, tmp_path):
    script = tmp_path / "forked.py"
    script.write_text(FORKED)
    arguments = [
        sys.executable,
        "-c",
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import forked; forked.main()",
    ]
    done = subprocess.run(arguments + ["thread"] * thread, capture_output=True, text=True, timeout=30, check=False)
    assert done.stdout.split() == [str(not thread), "[]", "True", str(not thread)], done


STOP = f"""{START}
from contextlib import suppress
from multiprocessing import forkserver, get_context
import time
import psutil
worker = get_context("forkserver").Process(target=time.sleep, args=(60,))
worker.start()
server = forkserver._forkserver._forkserver_pid
fork_server.stop()
worker.join(20)
with suppress(psutil.NoSuchProcess):
    psutil.Process(server).wait(20)
print(worker.exitcode, psutil.pid_exists(server))
"""


def test_stopping_ends_the_server_and_its_workers_without_a_word():
    done = subprocess.run([sys.executable, "-c", STOP], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.split()[:2] == ["True", "True"] and done.stdout.split()[3:] == ["False"], done
    assert done.stdout.split()[2] != "0" and done.stderr == "", done
