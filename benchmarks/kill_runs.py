"""Kill runs of pipelines at random moments, run them again, and compare their results with undisturbed runs.

    python benchmarks/kill_runs.py FOLDER [--pipelines NAME ...] [--kills N] [--seed N]

Streets are those of `conf/tiny.yml`, studies have their fast scale. Each pipeline is run once whole in one project (its
models are inputs of later pipelines) and, in a second one, killed N times with all its processes and then run to its
end. Every table, model and figure below `data/07_model_output` and `data/08_reporting`, and the output of `label`, must
be the same. Times of a run are not compared: columns and arrays of seconds, figures of them, the reports of studies,
and the names of MLflow runs. Ends with status 1 if anything differs. Single failed, torn and delayed operations on
files are tested by `tests/execution/test_faults.py`.
"""

import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
from _common import REPOSITORY, parser

PIPELINES = {
    "all_methods": "",
    "label": "label.survey=data/01_raw/simulated/test,label.output=labelled",
    "luo2016_study": "luo2016_study.scale=fast",
    "yu2016_study": "yu2016_study.scale=fast",
    "luo2019_study": "luo2019_study.scale=fast,simulated_objects.scale=fast",
    "tomic2019_study": "tomic2019_study.scale=fast",
}
"""Pipelines in the order in which they can run, and the parameters that make them small."""
TIMES = {"node_seconds.csv", "stage_costs.csv", "times.csv", "patch_size.png", "search_radius.png"}
BOOKS = {"record.json", "manifest.json"}
"""Notes of scene stores about the files beside them; those files are compared themselves."""
TIME = re.compile(r"second|_ms(_|$)|_s$")
"""In the names of columns and arrays that hold times."""
LAYERS = ("data/07_model_output", "data/08_reporting", "labelled")


def make_project(folder: Path) -> Path:
    """Copy configuration and layout into a folder, with tiny streets."""
    shutil.copytree(REPOSITORY / "conf", folder / "conf")
    shutil.copy(REPOSITORY / "pyproject.toml", folder)
    (folder / "src").mkdir()
    (folder / "conf/local").mkdir(exist_ok=True)
    shutil.copy(REPOSITORY / "conf/tiny.yml", folder / "conf/local/parameters.yml")
    return folder


def start(project: Path, pipeline: str) -> subprocess.Popen[bytes]:
    """Start a run in a process group of its own."""
    parameters = ",".join(filter(None, [PIPELINES[pipeline], "execution.n_workers=2"]))
    named = [f"--pipelines={pipeline}", f"--params={parameters}"]
    command = [sys.executable, "-W", "ignore", "-m", "kedro", "run", *named]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY / "src"), "MLFLOW_TRACKING_URI": ""}
    with (project / "log.txt").open("ab") as log:
        return subprocess.Popen(command, cwd=project, env=environment, stdout=log, stderr=log, start_new_session=True)


def finish(project: Path, pipeline: str) -> float:
    """Run a pipeline to its end; return the seconds."""
    began = time.monotonic()
    process = start(project, pipeline)
    if process.wait():
        sys.exit(f"{pipeline} failed: {(project / 'log.txt').read_text().strip().splitlines()[-1]}")
    return time.monotonic() - began


def killed_after(project: Path, pipeline: str, seconds: float) -> bool:
    """Kill a run, with all its processes, after some time; return whether it was still running."""
    process = start(project, pipeline)
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return True
    return False


def without_times(path: Path) -> bytes:
    """Return the content of a result less the times that a run took and the names of MLflow runs."""
    if path.suffix in (".csv", ".parquet"):
        table = pd.read_csv(path) if path.suffix == ".csv" else pd.read_parquet(path)
        if timed := [name for name in table.columns if TIME.search(str(name))]:
            return table.drop(columns=timed).to_csv().encode()
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            return b"".join(k.encode() + arrays[k].tobytes() for k in sorted(arrays.files) if not TIME.search(k))
    content = path.read_bytes()
    return re.sub(rb"run_id [0-9a-f]{32}", b"", content) if path.suffix == ".html" else content


def is_result(path: Path) -> bool:
    """Return whether a file must be the same in all runs."""
    of_study = path.name == "report.html" and path.parent.name.endswith("_study")
    state = ".mlsroad" in path.parts  # records of runs, with the paths of this project
    return path.is_file() and path.name not in TIMES | BOOKS and not of_study and not state


def digests(project: Path) -> dict[str, str]:
    """Return the digest of every result."""
    paths = filter(is_result, (path for layer in LAYERS for path in sorted((project / layer).rglob("*"))))
    return {str(path.relative_to(project)): hashlib.blake2b(without_times(path)).hexdigest() for path in paths}


def main() -> int:
    """Compare undisturbed and killed runs."""
    arguments = parser(__doc__)
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("--pipelines", nargs="+", choices=PIPELINES, default=list(PIPELINES))
    arguments.add_argument("--kills", type=int, default=3)
    arguments.add_argument("--seed", type=int, default=2019)
    options = arguments.parse_args()
    options.folder.mkdir(parents=True, exist_ok=False)
    whole, killed = (make_project(options.folder / name) for name in ("whole", "killed"))
    chance = random.Random(options.seed)
    failed = False
    for pipeline in options.pipelines:
        seconds = finish(whole, pipeline)
        moments = [chance.uniform(0.1, 0.9) * seconds for _ in range(options.kills)]
        hit = sum(killed_after(killed, pipeline, moment) for moment in moments)
        finish(killed, pipeline)
        expected, found = digests(whole), digests(killed)
        differing = sorted(name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name))
        failed |= bool(differing)
        row = {"stage": "kill_runs", "pipeline": pipeline, "seconds": round(seconds, 1), "killed": hit}
        print(json.dumps(row | {"files": len(expected), "differing": differing}), flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
