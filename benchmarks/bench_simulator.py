"""Time and memory of the survey simulator: whole surveys with images, and long ones piece by piece.

Run as ``python benchmarks/bench_simulator.py [demo|long] [--preset P] [--seed N] [--points N] [--threads N]``; prints a
table and one JSON line per run. Nobody else is known to make coloured, labelled mobile surveys with images, so there
is no rival to race. `long` also gives the rate after the first block of street, with all in sight built. Memory is PSS
summed over all processes, sampled every half second; the first of several repeats starts the other processes.
"""

import argparse
import json
import statistics
import threading
import time
from dataclasses import replace

import numpy as np
import psutil
from bench_label import tree_pss

from mlsroad_pipeline.simulation import PRESETS, long_survey, simulate_survey, stream_points
from mlsroad_pipeline.simulation.street.street import BLOCK


def whole(seed: int, threads: int) -> int:
    """Simulate the demo survey with images and return its number of points."""
    return len(simulate_survey(replace(PRESETS["demo"], seed=seed), n_threads=threads).cloud)


def piecewise(preset: str, seed: int, threads: int, points: int) -> tuple[int, float]:
    """Make a long survey, keep nothing, and return its number of points and the steady rate."""
    stream = long_survey(replace(PRESETS[preset], seed=seed), n_points=points, n_threads=threads)
    made, started, before = 0, time.perf_counter(), 0
    after_first_block = stream.drive.start + stream.drive.time_at(BLOCK)
    for chunk in stream_points(stream, n_points=points):
        made += len(chunk)
        if before == 0 and chunk["gps_time"][-1] > after_first_block:
            before, started = made, time.perf_counter()
    return made, (made - before) / (time.perf_counter() - started)


class PeakMemory:
    """The largest PSS of this process and all below it while it is open, bytes."""

    def __init__(self) -> None:
        self.bytes = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def _watch(self) -> None:
        while not self._stop.wait(0.5):
            self.bytes = max(self.bytes, sum(tree_pss(psutil.Process()).values()))

    def __enter__(self) -> "PeakMemory":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", nargs="?", choices=["demo", "long"], default="demo")
    parser.add_argument("--preset", choices=list(PRESETS), default="demo")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--points", type=int, default=5_000_000)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    simulate_survey(PRESETS["tiny"])  # compiles
    list(stream_points(long_survey(PRESETS["tiny"], n_points=1000), n_points=1000))
    seconds, cpu, steady, points = [], [], [], 0
    with PeakMemory() as peak:
        for _ in range(options.repeats):
            start, busy = time.perf_counter(), _cpu()
            if options.what == "demo":
                points = whole(options.seed, options.threads)
            else:
                points, rate = piecewise(options.preset, options.seed, options.threads, options.points)
                steady.append(rate)
            seconds.append(time.perf_counter() - start)
            cpu.append(_cpu() - busy)
    median = statistics.median(seconds)
    row = {
        "stage": f"simulate_{options.what}", "preset": options.preset, "threads": options.threads,
        "points": points, "seconds": median,
        "cpu_seconds": statistics.median(cpu), "points_per_second": points / median,
        "steady_points_per_second": statistics.median(steady) if steady else None,
        "spread": float(np.ptp(seconds)), "peak_mib": peak.bytes / 2**20,
    }  # fmt: skip
    widths = {"stage": 16, "threads": 8, "points": 10, "seconds": 9, "cpu_seconds": 12, "points_per_second": 18,
              "steady_points_per_second": 26}  # fmt: skip
    print("".join(f"{name:>{width}}" for name, width in widths.items()))
    cells = {name: f"{value:.1f}" if isinstance(value, float) else str(value) for name, value in row.items()}
    print("".join(f"{cells[name]:>{width}}" for name, width in widths.items()))
    print(json.dumps(row))


def _cpu() -> float:
    """Return the CPU time of this process and its children, seconds."""
    me = psutil.Process()
    times = [process.cpu_times() for process in (me, *me.children(recursive=True))]
    return sum(used.user + used.system for used in times)


if __name__ == "__main__":
    main()
