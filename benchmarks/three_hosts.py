"""A Dask cluster of three hosts whose network is cut: a stage of twelve scenes on a scheduler and two workers.

Run as root, ``python benchmarks/three_hosts.py FOLDER``. Each host is a network namespace, joined by a bridge; they
share FOLDER. Per case, prints the seconds until the stage ended, what it said, and whether its store, completed by the
same call on this machine, has the bytes of an undisturbed one. Ends with status 1 if a store differs.
"""

import hashlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1] / "tests"
sys.path.insert(0, str(TESTS))

from helpers.store import make_points  # noqa: E402

from mlsroad_pipeline.datasets.scene_store_dataset import SceneStoreDataset  # noqa: E402
from mlsroad_pipeline.execution.task import SceneTask  # noqa: E402

BRIDGE, HOSTS = "mlsroad-br", ("scheduler", "one", "two")
ADDRESS = "tcp://10.77.0.2:8786"
TASKS = {f"s{i:02d}": SceneTask(make_points, {}, {"n": 500, "seed": i, "pause": 1.0}) for i in range(12)}
CASES = {
    "undisturbed": (),
    "a worker is cut off for 10 s": (("one", 3, 13),),
    "a worker is cut off for good": (("one", 3, None),),
    "both workers are cut off": (("one", 3, None), ("two", 3, None)),
    "the scheduler is cut off": (("scheduler", 3, None),),
}
"""Case to the hosts that are cut off, from a second to another."""


def ip(*words: str) -> None:
    """Run ``ip``."""
    subprocess.run(["ip", *words], check=True)


@contextmanager
def network() -> Iterator[None]:
    """Make the hosts and their network, and remove them."""
    try:
        ip("link", "add", BRIDGE, "type", "bridge")
        ip("addr", "add", "10.77.0.1/24", "dev", BRIDGE)
        ip("link", "set", BRIDGE, "up")
        for number, host in enumerate(HOSTS, start=2):
            ip("netns", "add", f"mr-{host}")
            ip("link", "add", f"mr{number}", "type", "veth", "peer", "name", "eth0", "netns", f"mr-{host}")
            ip("link", "set", f"mr{number}", "master", BRIDGE, "up")
            ip("-n", f"mr-{host}", "addr", "add", f"10.77.0.{number}/24", "dev", "eth0")
            ip("-n", f"mr-{host}", "link", "set", "eth0", "up")
            ip("-n", f"mr-{host}", "link", "set", "lo", "up")
        yield
    finally:
        for host in HOSTS:
            subprocess.run(["ip", "netns", "del", f"mr-{host}"], check=False)
        subprocess.run(["ip", "link", "del", BRIDGE], check=False)


def started(host: str, *words: str) -> subprocess.Popen[bytes]:
    """Start a process of Dask on a host."""
    places = os.pathsep.join([str(TESTS), *(place for place in sys.path if place)])
    command = ["ip", "netns", "exec", f"mr-{host}", sys.executable, "-m", f"distributed.cli.{words[0]}", *words[1:]]
    with Path(os.devnull).open("wb") as nowhere:
        return subprocess.Popen(command, env={**os.environ, "PYTHONPATH": places}, stdout=nowhere, stderr=nowhere)


def link(host: str, state: str) -> None:
    """Cut a host off, or join it again."""
    ip("link", "set", f"mr{HOSTS.index(host) + 2}", state)


def store(folder: Path, **execution: object) -> SceneStoreDataset:
    """Return a store."""
    return SceneStoreDataset(filepath=str(folder), execution={"progress": False, **execution})


def digest(folder: Path) -> str:
    """Return the digest of a store."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return hashlib.blake2b(b"".join(str(p.relative_to(folder)).encode() + p.read_bytes() for p in files)).hexdigest()


def trial(folder: Path, cuts: tuple[tuple[str, float, float | None], ...]) -> tuple[float, str]:
    """Run the stage while hosts are cut off; return the seconds it took and the last line of its error."""
    with network():
        processes = [started("scheduler", "dask_scheduler", "--host", "10.77.0.2", "--no-dashboard", "--no-show")]
        timers: list[threading.Timer] = []
        try:
            time.sleep(4)
            for host in HOSTS[1:]:
                worker = started(host, "dask_worker", ADDRESS, "--nthreads", "1", "--no-dashboard", "--no-nanny")
                processes.append(worker)
            time.sleep(5)
            timers += [threading.Timer(begin, link, [host, "down"]) for host, begin, _ in cuts]
            timers += [threading.Timer(end, link, [host, "up"]) for host, _, end in cuts if end is not None]
            for timer in timers:
                timer.start()
            began, said = time.monotonic(), ""
            try:
                store(folder, backend="dask", scheduler=ADDRESS).save(TASKS)
            except Exception as error:
                said = str(error.__cause__ or error).strip().splitlines()[-1]
            seconds = time.monotonic() - began
        finally:
            for timer in timers:
                timer.cancel()
            for process in processes:
                process.kill()
                process.wait()
    return seconds, said


def main() -> int:
    """Run all cases."""
    folder, failed = Path(sys.argv[1]), False
    store(folder / "here", backend="sequential").save(TASKS)
    for name, cuts in CASES.items():
        place = folder / name.replace(" ", "_")
        seconds, said = trial(place, cuts)
        store(place, backend="sequential").save(TASKS)
        same = digest(place) == digest(folder / "here")
        failed |= not same
        row = {"stage": "three_hosts", "case": name, "seconds": round(seconds, 1), "said": said, "same": same}
        print(json.dumps(row), flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
