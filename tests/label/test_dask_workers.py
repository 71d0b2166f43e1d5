"""Warm workers of a scheduler: they compute scenes, a killed one is replaced, and they end with the scheduler."""

import os
import signal
import subprocess
import sys
import time

import psutil
from distributed import Client

from mlsroad_pipeline.execution import fork_server


def state():
    return os.getpid(), fork_server.is_loaded()


def started(*words):
    places = os.pathsep.join(place for place in sys.path if place)
    environment = {**os.environ, "PYTHONPATH": places}
    return subprocess.Popen([sys.executable, "-m", *words], env=environment, stderr=subprocess.PIPE, text=True)


def test_workers_are_warm_replaced_when_killed_and_end_with_their_scheduler(tmp_path):
    file = tmp_path / "scheduler.json"
    address = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--no-show")
    with started("distributed.cli.dask_scheduler", *address, "--scheduler-file", str(file)) as scheduler:
        try:
            deadline = time.monotonic() + 60
            while not file.exists():
                assert time.monotonic() < deadline
                time.sleep(0.05)
            with Client(scheduler_file=str(file), set_as_default=False) as client:
                url = client.scheduler.address
                with started("mlsroad_pipeline.label.dask_workers", url, "--workers", "2") as command:
                    client.wait_for_workers(2, timeout=120)
                    found = dict(client.run(state).values())
                    assert len(found) == 2 and all(found.values())
                    killed = min(found)
                    os.kill(killed, signal.SIGKILL)
                    while len(now := dict(client.run(state, on_error="ignore").values())) < 2 or killed in now:
                        assert time.monotonic() < deadline + 120
                        time.sleep(0.1)
                    assert len(now.keys() & found.keys()) == 1
                    below = psutil.Process(command.pid).children(recursive=True)
                    client.shutdown()
                    assert command.wait(60) == 0
                    assert "another one is started" in command.stderr.read()
            assert psutil.wait_procs(below, timeout=20)[1] == []
        finally:
            scheduler.kill()
