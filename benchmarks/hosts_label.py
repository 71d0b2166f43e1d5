"""`label` on Dask workers on several hosts beside processes of loky, on the cores of this machine.

Run as root, ``python benchmarks/hosts_label.py --folder FOLDER --millions 5``. Each worker has a host of its own, a
network namespace joined to the others by a bridge; all share FOLDER. The backends alternate, ``--rounds`` times: loky;
workers of ``mlsroad_pipeline.label.dask_workers``; the same with one killed after 10 s, which nothing replaces; workers
of ``dask worker`` in their first and in their second run. Prints seconds, processor seconds of driver, scheduler and
workers during the run, and the digest of the results.
"""

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import psutil
import three_hosts
from bench_label import digest, make_survey, run_label, tree_cpu
from distributed import Client

PLAIN = ("distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard")
OWN = ("mlsroad_pipeline.label.dask_workers", "--workers", "1")


def used(processes: list[psutil.Popen]) -> float:
    """Return the processor seconds of processes and of all below them so far."""
    return sum(sum(tree_cpu(process).values()) for process in processes)


def started(host: str, module: str, *words: str) -> psutil.Popen:
    """Start a Python module on a host."""
    places = os.pathsep.join(place for place in sys.path if place)
    command = ["ip", "netns", "exec", f"mr-{host}", sys.executable, "-m", module, *words]
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return psutil.Popen(command, env={**os.environ, "PYTHONPATH": places}, **silent)


def end(process: psutil.Popen) -> None:
    """Kill a process and all below it."""
    with suppress(psutil.NoSuchProcess):
        for member in [*process.children(recursive=True), process]:
            member.kill()
    process.wait()


class Hosts:
    """A scheduler and workers, each on its host, all ready."""

    def __init__(self, n_workers: int, module: str, *options: str) -> None:
        address = ["--host", "10.77.0.2", "--no-dashboard", "--no-show"]
        self.scheduler = started(three_hosts.HOSTS[0], "distributed.cli.dask_scheduler", *address)
        time.sleep(4)
        hosts = three_hosts.HOSTS[1 : 1 + n_workers]
        self.workers = [started(host, module, three_hosts.ADDRESS, *options) for host in hosts]
        with Client(three_hosts.ADDRESS, set_as_default=False, timeout=60) as client:
            client.wait_for_workers(n_workers, timeout=300)

    def close(self) -> None:
        """End them."""
        for process in [*self.workers, self.scheduler]:
            end(process)


def main() -> None:
    """Run all cases."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--millions", type=int, default=5)
    parser.add_argument("--workers", type=int, default=4)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--cases", nargs="+", default=["loky", "warm", "killed", "plain", "again"])
    arguments = parser.parse_args()
    three_hosts.HOSTS = ("scheduler", *(f"w{number}" for number in range(arguments.workers)))
    survey = make_survey(arguments.folder, arguments.millions, n_threads=2)
    output = arguments.folder / "labelled_hosts"

    def trial(name: str, hosts: Hosts | None) -> None:
        workers, schedulers = (hosts.workers, [hosts.scheduler]) if hosts else ([], [])
        before, scheduler = (used(workers), used(schedulers)), three_hosts.ADDRESS if hosts else None
        backend = "dask" if hosts else "loky"
        found = run_label(survey, output, "local", "detrended_forest", backend, arguments.workers, scheduler)
        parts = {"workers": used(workers) - before[0], "scheduler": used(schedulers) - before[1]}
        row = {"seconds": found["seconds"], "cpu_seconds": found["cpu_seconds"] + sum(parts.values()), **parts}
        rounded = {key: round(value, 1) for key, value in row.items()}
        print(
            json.dumps({"case": name, "n_workers": arguments.workers, **rounded, "digest": digest(output)}), flush=True
        )

    for _ in range(arguments.rounds):
        for case in arguments.cases:
            if case == "loky":
                trial(case, None)
                continue
            start = PLAIN if case in ("plain", "again") else OWN
            with three_hosts.network():
                hosts = Hosts(arguments.workers, *start)
                try:
                    if case == "again":
                        run_label(survey, output, "local", "detrended_forest", "dask", 4, three_hosts.ADDRESS)
                    if case == "killed":
                        threading.Timer(10, end, [hosts.workers.pop()]).start()
                    trial(case, hosts)
                finally:
                    hosts.close()


if __name__ == "__main__":
    main()
