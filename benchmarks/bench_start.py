"""Start of the command: `mlsroad label` of a tile, and the commands that label nothing, from begin to end.

    python benchmarks/bench_start.py [--repeats 5] [--tile FILE.laz] [--source FOLDER]

The tile is a simulated street of a million points, made once, unless one is given. With `--source`, the folder
`src` of another version is measured in alternation. Kernels of both must be compiled. Processor time is that of all
processes, sampled every 20 ms; on a busy machine it compares, the elapsed time does not. Prints a JSON line per row.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import psutil
from bench_label import REPOSITORY, make_survey, tree_cpu

COMMANDS = (("--help",), ("inspect", "--help"), ("models",))


def run(arguments: list[str], source: Path) -> tuple[float, float]:
    """Return elapsed and processor seconds of a command with the sources of a version."""
    command = [str(Path(sys.executable).with_name("mlsroad")), *arguments]
    environment = {**os.environ, "PYTHONPATH": str(source)}
    start, used = time.perf_counter(), dict[int, float]()
    process = psutil.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    while process.poll() is None:
        used |= tree_cpu(process)
        time.sleep(0.02)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)}: {process.stderr.read()}")
    return time.perf_counter() - start, sum(used.values())


def main() -> None:
    """Run the commands in alternation and print medians."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--tile", type=Path)
    parser.add_argument("--source", type=Path)
    arguments = parser.parse_args()
    tile = arguments.tile or make_survey(REPOSITORY / "data/08_reporting/benchmarks/label", 1, n_threads=2)
    versions = {"mlsroad": REPOSITORY / "src"} | ({"other version": arguments.source} if arguments.source else {})
    commands = {"label": ["label", str(tile.resolve())]} | {" ".join(words): list(words) for words in COMMANDS}
    found: dict[tuple[str, str], list[tuple[float, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "labelled"
        for _ in range(arguments.repeats):
            for name, words in commands.items():
                for version, source in versions.items():
                    shutil.rmtree(output, ignore_errors=True)
                    given = [*words, "-o", str(output)] if name == "label" else words
                    found.setdefault((name, version), []).append(run(given, source))
    for (name, version), measured in found.items():
        elapsed, used = (round(median(column), 3) for column in zip(*measured, strict=True))
        row = {"kernel": f"mlsroad {name}, processor time", "program": version, "seconds": used, "elapsed": elapsed}
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
