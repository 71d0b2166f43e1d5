"""The server that workers are forked from: it starts with the driver, or leaves the workers to themselves."""

import fcntl
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil
import pytest

START = """
from multiprocessing import forkserver
from mlsroad_pipeline.execution import fork_server
load = lambda: __import__("numba")
print(fork_server.start(load, lambda: None), fork_server.is_started(), forkserver._forkserver._forkserver_pid)
"""


def started(**environment):
    done = subprocess.run(
        [sys.executable, "-c", START], capture_output=True, text=True, timeout=60, check=False, env=environment
    )
    return done.returncode, done.stdout.split()[:2], done.stderr


def test_a_folder_too_long_for_a_socket_is_no_error(tmp_path):
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


def test_a_killed_driver_leaves_no_process_and_no_folder_for_ever(short):
    (short / "mlsroad-data").mkdir()
    slow = START.replace("lambda: None", "lambda: __import__('time').sleep(100)")
    environment = {"PYTHONPATH": ":".join(sys.path), "TMPDIR": str(short)}
    streams = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    command = [sys.executable, "-uc", f"{slow}import sys; sys.stdin.read()"]
    with subprocess.Popen(command, env=environment, **streams) as killed:
        *said, server = killed.stdout.readline().split()
        assert said == ["True", "True"]
        killed.kill()
    assert psutil.wait_procs([psutil.Process(int(server))] if psutil.pid_exists(int(server)) else [], 10)[1] == []
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
import gc, logging, os, signal, sys, threading
from multiprocessing import get_context
from mlsroad_pipeline.execution import fork_server

def reply(queue):
    import numba
    loaded = "colorsys" in sys.modules, "this" in sys.modules, numba.config.NUMBA_NUM_THREADS == 1
    blocked = signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    queue.put((*loaded, blocked, not logging.root.handlers, signal.getsignal(signal.SIGTERM) == signal.SIG_DFL))

def main():
    logging.basicConfig()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    event = threading.Event()
    if "thread" in sys.argv:
        threading.Thread(target=event.wait).start()
    has_server = fork_server.start(lambda: __import__("numba") and __import__("colorsys"), lambda: __import__("this"))
    if has_server:
        queue = get_context("forkserver").SimpleQueue()
        worker = get_context("forkserver").Process(target=reply, args=(queue,))
        worker.start()
        print(has_server, *queue.get(), "this" not in sys.modules, file=sys.stderr)
        worker.join()
    else:
        print(has_server, file=sys.stderr)
    event.set()
"""


@pytest.mark.parametrize("thread", [False, True])
def test_the_server_is_forked_from_a_driver_without_threads_and_leaves_its_set_up_behind(thread, tmp_path):
    (tmp_path / "forked.py").write_text(FORKED)
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import forked; forked.main()"
    command = [sys.executable, "-c", code, *["thread"] * thread]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.stderr.split() == (["False"] if thread else ["True"] * 8), done


def test_the_server_ends_with_its_driver_while_it_loads():
    slow = START.replace("lambda: None", "lambda: __import__('time').sleep(100)")
    done = subprocess.run([sys.executable, "-c", slow], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.split()[:2] == ["True", "True"] and done.stderr == "", done
    deadline, server = time.monotonic() + 10, int(done.stdout.split()[2])
    while psutil.pid_exists(server) and psutil.Process(server).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < deadline
        time.sleep(0.05)


BESIDE = """
import os, sys
from pathlib import Path
from mlsroad_pipeline.execution.fork_server import beside
place = Path(sys.argv[1])
with beside(lambda: place.write_text(str(os.getpid()))):
    pass
with beside(lambda: 1 / 0):
    print(int(place.read_text()) != os.getpid())
"""


def test_a_function_runs_in_a_process_beside_the_server_which_waits_for_it(tmp_path):
    command = [sys.executable, "-c", BESIDE, str(tmp_path / "pid")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.stdout.split(), done.returncode) == (["True"], 0)
    assert done.stderr.count("Traceback") == 1
    assert done.stderr.endswith("ZeroDivisionError: division by zero\n")
