"""Run every benchmark, print what they print, and keep their JSON lines under data/08_reporting/benchmarks/.

    make bench                      # or: python benchmarks/run_all.py [ground vccs ...]

Rivals and clouds are found through $MLSROAD_RIVALS; what is missing is said and left out. Run it on a quiet machine:
the figures that count are the ratios within one run.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
RESULTS = HERE.parent / "data/08_reporting/benchmarks"

BENCHMARKS: dict[str, list[str]] = {
    "ground": [],
    "vccs": [],
    "fpfh": [],
    "forest": [],
    "clusters": [],
    "graph_cuts": [],
    "patch_graph": [],
    "formats": [],
    "evaluation": [],
    "simulator": [],
    "store": [],
    "label": ["--millions", "5", "20"],
}
NEEDS_CLOUDS = {"ground", "vccs", "fpfh", "clusters", "graph_cuts", "formats", "evaluation"}


def json_lines(text: str) -> list[dict[str, object]]:
    """Return the lines of an output that are JSON objects."""
    found = []
    for line in text.splitlines():
        if line.startswith("{"):
            found.append(json.loads(line))
    return found


def run(name: str) -> bool:
    """Run one benchmark; tell whether it ended well."""
    print(f"\n== {name}", flush=True)
    command = [sys.executable, str(HERE / f"bench_{name}.py"), *BENCHMARKS[name]]
    done = subprocess.run(command, cwd=HERE.parent, capture_output=True, text=True, check=False)
    print(done.stdout, end="")
    if done.returncode:
        print(f"{name} ended with status {done.returncode}: {done.stderr.strip().splitlines()[-1:]}")
        return False
    RESULTS.mkdir(parents=True, exist_ok=True)
    (RESULTS / f"{name}.json").write_text(json.dumps(json_lines(done.stdout), indent=1) + "\n", encoding="utf-8")
    return True


def main() -> int:
    """Run what the command line names, or everything."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="of " + ", ".join(BENCHMARKS))
    names = parser.parse_args().names or list(BENCHMARKS)
    unknown = sorted(set(names) - set(BENCHMARKS))
    if unknown:
        parser.error(f"unknown: {', '.join(unknown)}")
    if not os.environ.get("MLSROAD_RIVALS"):
        left_out = [name for name in names if name in NEEDS_CLOUDS]
        print(f"MLSROAD_RIVALS is not set: no rivals and no clouds; left out: {', '.join(left_out) or 'nothing'}")
        names = [name for name in names if name not in NEEDS_CLOUDS]
    failed = [name for name in names if not run(name)]
    if failed:
        print(f"\nnot measured: {', '.join(failed)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
