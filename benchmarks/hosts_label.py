"""`label` on Dask workers on several hosts, compared with loky processes, on the cores of this machine.

Run as root: python benchmarks/hosts_label.py --folder FOLDER --millions 5 [--cases loky first cut ...]

The scheduler and each worker have a host of their own, a network namespace joined to the others by a bridge; all share
FOLDER. Cases, `--rounds` times each: loky; workers of `dask worker` in their first and in their second run (first,
again); a first run with one worker killed after 10 s, with the network of one worker cut for 10 s (cut) or for good
(lost), and with that of the scheduler cut for good (alone). A run that fails is completed by loky. Prints seconds,
processor seconds of driver, scheduler and workers, the error of a failed run, and the digest of the results. Ends with
status 1 if a digest differs.
"""

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from itertools import chain
from pathlib import Path
from typing import Any

import psutil
from _common import Tree, members, parser
from bench_label import digest, make_survey, run_label
from distributed import Client

WORKER = ("distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard")
BRIDGE, ADDRESS = "mlsroad-br", "tcp://10.77.0.2:8786"
CASES = ("loky", "first", "again", "killed", "cut", "lost", "alone")
AFTER, FOR = 10.0, 10.0
"""Seconds after which a fault happens, and for which a network is cut."""


def ip(*words: str) -> None:
    """Run `ip`."""
    subprocess.run(["ip", *words], check=True)


def link(number: int, state: str) -> None:
    """Cut a host off ("down"), or join it again ("up")."""
    ip("link", "set", f"mr{number}", state)


@contextmanager
def network(n_hosts: int) -> Iterator[None]:
    """Make the hosts, numbered from 2, and their network, and remove them."""
    hosts = range(2, 2 + n_hosts)
    try:
        ip("link", "add", BRIDGE, "type", "bridge")
        ip("addr", "add", "10.77.0.1/24", "dev", BRIDGE)
        ip("link", "set", BRIDGE, "up")
        for host in hosts:
            ip("netns", "add", f"mr-{host}")
            ip("link", "add", f"mr{host}", "type", "veth", "peer", "name", "eth0", "netns", f"mr-{host}")
            ip("link", "set", f"mr{host}", "master", BRIDGE, "up")
            ip("-n", f"mr-{host}", "addr", "add", f"10.77.0.{host}/24", "dev", "eth0")
            ip("-n", f"mr-{host}", "link", "set", "eth0", "up")
            ip("-n", f"mr-{host}", "link", "set", "lo", "up")
        yield
    finally:
        for host in hosts:
            subprocess.run(["ip", "netns", "del", f"mr-{host}"], check=False)
        subprocess.run(["ip", "link", "del", BRIDGE], check=False)


def started(host: int, module: str, *words: str) -> psutil.Popen:
    """Start a Python module on a host."""
    places = os.pathsep.join(place for place in sys.path if place)
    command = ["ip", "netns", "exec", f"mr-{host}", sys.executable, "-m", module, *words]
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return psutil.Popen(command, env={**os.environ, "PYTHONPATH": places}, **silent)


def end(process: psutil.Popen) -> None:
    """Kill a process and all below it."""
    for member in reversed(members(process)):
        with suppress(psutil.NoSuchProcess):
            member.kill()
    process.wait()


@contextmanager
def cluster(n_workers: int, case: str) -> Iterator[dict[str, list[psutil.Popen]]]:
    """Start a scheduler and workers, each on its host, and plan the fault of the case; end them."""
    module, *options = WORKER
    processes = {"scheduler": [started(2, "distributed.cli.dask_scheduler", "--host", "10.77.0.2", "--no-dashboard")]}
    try:
        time.sleep(4)
        processes["workers"] = [started(3 + k, module, ADDRESS, *options) for k in range(n_workers)]
        with Client(ADDRESS, set_as_default=False, timeout=60) as client:
            client.wait_for_workers(n_workers, timeout=300)
        yield processes
    finally:
        for process in chain(*processes.values()):
            end(process)


def faults(case: str, processes: dict[str, list[psutil.Popen]]) -> list[threading.Timer]:
    """Return the planned faults of a case."""
    host = 2 if case == "alone" else 3
    planned = [threading.Timer(AFTER, link, [host, "down"])] if case in ("cut", "lost", "alone") else []
    planned += [threading.Timer(AFTER + FOR, link, [host, "up"])] if case == "cut" else []
    planned += [threading.Timer(AFTER, end, [processes["workers"][0]])] if case == "killed" else []
    return planned


def on_hosts(case: str, n_workers: int, label: Any) -> dict[str, Any]:
    """Label on hosts; return the figures, or the error of a failed run."""
    with network(1 + n_workers), cluster(n_workers, case) as processes:
        if case == "again":
            label("dask", ADDRESS)
        timers, error = faults(case, processes), None
        with ExitStack() as stack:
            trees = {
                part: [stack.enter_context(Tree(one, memory=False)) for one in ones] for part, ones in processes.items()
            }
            before = {part: sum(tree.cpu for tree in ones) for part, ones in trees.items()}
            for timer in timers:
                timer.start()
            try:
                found = label("dask", ADDRESS)
            except SystemExit as failure:
                error = str(failure)
            finally:
                for timer in timers:
                    timer.cancel()
        if error is not None:
            return {"error": error}
        used = {part: sum(tree.cpu for tree in ones) - before[part] for part, ones in trees.items()}
        return {"seconds": found["seconds"], "cpu_seconds": found["cpu_seconds"] + sum(used.values()), **used}


def main() -> int:
    """Run all cases."""
    arguments = parser(__doc__)
    arguments.add_argument("--folder", type=Path, required=True)
    arguments.add_argument("--millions", type=int, default=5)
    arguments.add_argument("--workers", type=int, default=4)
    arguments.add_argument("--rounds", type=int, default=1)
    arguments.add_argument("--cases", nargs="+", choices=CASES, default=CASES)
    options = arguments.parse_args()
    survey, output = make_survey(options.folder, options.millions), options.folder / "labelled_hosts"

    def label(backend: str, scheduler: str | None = None) -> dict[str, Any]:
        return run_label(survey, output, "local", "detrended_forest", backend, options.workers, scheduler)

    digests = set()
    for case in list(options.cases) * options.rounds:
        if case == "loky":
            found = label("loky")
            row = {name: found[name] for name in ("seconds", "cpu_seconds")}
        else:
            row = on_hosts(case, options.workers, label)
            if "error" in row:
                label("loky")
        digests.add(found_digest := digest(output))
        rounded = {key: round(value, 1) if isinstance(value, float) else value for key, value in row.items()}
        print(json.dumps({"case": case, "n_workers": options.workers, **rounded, "digest": found_digest}), flush=True)
    return int(len(digests) > 1)


if __name__ == "__main__":
    sys.exit(main())
