"""Time and memory of the survey simulator: whole surveys with images, and long ones piece by piece.

    python benchmarks/bench_simulator.py [demo|long] [--preset P] [--seed N] [--points N] [--threads N]

No competing tool makes coloured, labelled mobile surveys with images. `long` also gives the rate after the first block
of street, when everything in sight is built. Memory is PSS summed over all processes, sampled every half second; the
first of several repeats starts the other processes.
"""

import json
import time
from dataclasses import replace

import psutil
from _common import Timed, Tree, members, parser, race

from mlsroad_pipeline.simulation import PRESETS, long_survey, simulate_survey, stream_points
from mlsroad_pipeline.simulation.street.street import BLOCK


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


def used() -> float:
    """Return the CPU time of this process and its children, seconds."""
    times = [process.cpu_times() for process in members(psutil.Process())]
    return sum(found.user + found.system for found in times)


def main() -> None:
    """Run the benchmark."""
    arguments = parser(__doc__)
    arguments.add_argument("what", nargs="?", choices=["demo", "long"], default="demo")
    arguments.add_argument("--preset", choices=list(PRESETS), default="demo")
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--points", type=int, default=5_000_000)
    arguments.add_argument("--threads", type=int, default=2)
    arguments.add_argument("--repeats", type=int, default=3)
    options = arguments.parse_args()
    simulate_survey(PRESETS["tiny"])  # compiles
    list(stream_points(long_survey(PRESETS["tiny"], n_points=1000), n_points=1000))

    def work() -> Timed:
        start, busy = time.perf_counter(), used()
        if options.what == "demo":
            parameters = replace(PRESETS["demo"], seed=options.seed)
            made = len(simulate_survey(parameters, n_threads=options.threads).cloud), None
        else:
            made = piecewise(options.preset, options.seed, options.threads, options.points)
        return Timed(time.perf_counter() - start, used() - busy, made)

    with Tree(psutil.Process()) as tree:
        found = race({options.what: work}, repeats=options.repeats)[options.what]
    points, steady = found.result
    row = {"stage": f"simulate_{options.what}", "preset": options.preset, "threads": options.threads, "points": points}
    row |= {"seconds": found.seconds, "cpu_seconds": found.cpu, "points_per_second": points / found.seconds}
    row |= {"steady_points_per_second": steady, "peak_mib": tree.peak_bytes / 2**20}
    print(
        "  ".join(
            f"{name} {value:.1f}" if isinstance(value, float) else f"{name} {value}" for name, value in row.items()
        )
    )
    print(json.dumps(row))


if __name__ == "__main__":
    main()
