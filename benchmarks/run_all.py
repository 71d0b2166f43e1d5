"""Run every benchmark of speed, print its output, and the ratios to every competing program that was present.

    make bench                      # or: python benchmarks/run_all.py [ground vccs ...]

JSON lines and `ratios.md` are written to data/08_reporting/benchmarks/. Competing programs and clouds are found through
$MLSROAD_RIVALS; what is missing is named and left out. Use a quiet machine: the figures that count are the ratios
within one run. A line of JSON with `kernel`, `program` and `seconds` takes part in a race; the names of this project's
own programs start with `mlsroad`.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import psutil
from _common import REPOSITORY, parser
from _common import RESULTS as REPORTS

HERE = Path(__file__).resolve().parent
RESULTS = REPORTS / "benchmarks"

BENCHMARKS: dict[str, list[str]] = {
    "ground": [],
    "vccs": [],
    "fpfh": [],
    "forest": [],
    "clusters": [],
    "graph_cuts": [],
    "patch_graph": [],
    "formats": [],
    "visibility": ["speed"],
    "simulator": [],
    "store": [],
    "start": [],
    "label": ["--millions", "5", "20"],
}
NEEDS_CLOUDS = {"ground", "vccs", "fpfh", "clusters", "graph_cuts", "formats"}


def json_lines(text: str) -> list[dict[str, Any]]:
    """Return the lines of an output that are JSON objects."""
    return [json.loads(line) for line in text.splitlines() if line.startswith("{")]


def ratios(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Compare each of this project's programs with each other program that did the same work in the same run."""
    races: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in rows:
        if {"kernel", "program", "seconds"} <= set(row):
            races.setdefault((row["kernel"], row.get("points"), row.get("threads")), []).append(row)
    found = []
    for (kernel, points, threads), members in races.items():
        ours = [row for row in members if row["program"].startswith("mlsroad")]
        rivals = [row for row in members if not row["program"].startswith("mlsroad")]
        for mine in ours:
            for rival in rivals:
                what = {"kernel": kernel, "points": points, "threads": threads, "program": mine["program"]}
                pair = {"seconds": mine["seconds"], "rival": rival["program"], "rival_seconds": rival["seconds"]}
                found.append(what | pair | {"ratio": rival["seconds"] / mine["seconds"]})
    return found


def processor() -> str:
    """Return the name of the processor."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def ratio_table(found: list[dict[str, Any]]) -> str:
    """Return the ratios as a table in Markdown, under the date and the machine's size."""
    memory = psutil.virtual_memory().total / 2**30
    lines = [
        f"{datetime.now(UTC):%Y-%m-%d}, {processor()}, {os.cpu_count()} cores, {memory:.0f} GiB; "
        "a ratio above 1 means that this project is faster",
        "",
        "| kernel | points | threads | ours | seconds | compared with | seconds | ratio |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in found:
        points = f"{row['points']:,}" if row["points"] else ""
        ours = row["program"].removeprefix("mlsroad").strip(", ")
        lines.append(
            f"| {row['kernel']} | {points} | {row['threads'] or ''} | {ours} | {row['seconds']:.3g} "
            f"| {row['rival']} | {row['rival_seconds']:.3g} | {row['ratio']:.2f} |"
        )
    return "\n".join(lines) + "\n"


def show_ratios(names: list[str]) -> None:
    """Print the ratios of the named benchmarks and keep them in a file."""
    rows: list[dict[str, Any]] = []
    for name in names:
        rows += json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    found = ratios(rows)
    if not found:
        print("\nno competing program was present: no ratios")
        return
    table = ratio_table(found)
    (RESULTS / "ratios.md").write_text(table, encoding="utf-8")
    print(f"\n== ratios, kept in {RESULTS / 'ratios.md'}\n{table}", end="")


def run(name: str) -> bool:
    """Run one benchmark; return whether it succeeded."""
    print(f"\n== {name}", flush=True)
    command = [sys.executable, str(HERE / f"bench_{name}.py"), *BENCHMARKS[name]]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    print(done.stdout, end="")
    if done.returncode:
        print(f"{name} ended with status {done.returncode}: {done.stderr.strip().splitlines()[-1:]}")
        return False
    RESULTS.mkdir(parents=True, exist_ok=True)
    (RESULTS / f"{name}.json").write_text(json.dumps(json_lines(done.stdout), indent=1) + "\n", encoding="utf-8")
    return True


def main() -> int:
    """Run what the command line names, or everything."""
    arguments = parser(__doc__)
    arguments.add_argument("names", nargs="*", metavar="NAME", help="of " + ", ".join(BENCHMARKS))
    names = arguments.parse_args().names or list(BENCHMARKS)
    unknown = sorted(set(names) - set(BENCHMARKS))
    if unknown:
        arguments.error(f"unknown: {', '.join(unknown)}")
    if not os.environ.get("MLSROAD_RIVALS"):
        left_out = [name for name in names if name in NEEDS_CLOUDS]
        print(
            f"MLSROAD_RIVALS is not set: no competing programs, no clouds; left out: {', '.join(left_out) or 'nothing'}"
        )
        names = [name for name in names if name not in NEEDS_CLOUDS]
    failed = [name for name in names if not run(name)]
    show_ratios([name for name in names if name not in failed])
    if failed:
        print(f"\nnot measured: {', '.join(failed)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
