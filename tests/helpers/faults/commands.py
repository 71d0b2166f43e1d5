"""Process that loads what a command needs, then forks: ``store``, ``inventory``, ``label`` or ``train`` into a folder per line of input.

No thread may be started before: a forked process would wait for it for ever.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mlsroad_pipeline.datasets.scene_store_dataset import SceneStoreDataset
from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.formats.files import atomic_file

TRAINING = ("simulate", "ingest", "ground_removal", "supervoxelise", "features")
"""Pipelines before the training."""


COPY = """
import pathlib, shutil, sqlite3, sys
project, output = sys.argv[1:]
shutil.copytree(project, output, ignore=shutil.ignore_patterns("mlartifacts"))
with sqlite3.connect(output + "/mlflow.db") as store:
    store.execute("UPDATE experiments SET artifact_location = replace(artifact_location, ?, ?)", (project, output))
pathlib.Path(output, "copied").touch()
"""
"""Program that copies a project, in whose tracking store the artifacts of new runs lie in the copy; it is not disturbed."""


def squares(n: int) -> dict[str, np.ndarray]:
    """Return the first squares."""
    return {"values": np.arange(n) ** 2}


def store(work: Path, output: Path) -> None:
    """Save a scene store, and publish a file for each scene as `label` does."""
    del work
    run = RunFolder(str(output / ".mlsroad/run"))
    output.mkdir(exist_ok=True)
    run.clean()
    run.write({"state": "unfinished", "inputs": [], "outputs": run.read().get("outputs", [])})
    dataset = SceneStoreDataset(filepath=f"{run.path}/results", execution={"backend": "sequential", "progress": False})
    dataset.save({f"s{i}": SceneTask(squares, {}, {"n": 5 + i}) for i in range(2)})
    for key, stored in dataset.load().items():
        staged = run.staged(output / f"{key}.bin")
        with atomic_file(staged) as stream:
            stream.write(stored.load()["values"].tobytes() * 300)
        run.publish(staged)
    run.close({}, [], keep_state=False)


def prepare_label(work: Path) -> None:
    """Make a project and a street, and load the libraries, the kernels and the configuration of `label`."""
    from helpers.wiring import make_project, session_of
    from kedro.framework.project import pipelines

    from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
    from mlsroad_pipeline.formats.base import WriteOptions
    from mlsroad_pipeline.formats.las.format import LasFormat
    from mlsroad_pipeline.label.warm_up import run_stages

    project, rng = make_project(work / "project"), np.random.default_rng(1)
    road = np.column_stack([rng.uniform(0, 12, 1500), rng.uniform(0, 6, 1500), rng.normal(0, 0.01, 1500)])
    pole = rng.normal(0, 0.03, (300, 3)) + np.column_stack([np.full((300, 2), 5.0), np.linspace(0.1, 4.0, 300)])
    cloud = PointCloud(np.concatenate([road, pole]), {}, np.array([389_300.0, 5_819_700.0, 34.0]))
    LasFormat().write(project / "street.laz", cloud, WriteOptions(like="none"))
    run_stages()
    with session_of(project, **_of_label(work, work / "loaded")) as session:
        dict(session.load_context().catalog.items())
        dict(pipelines)


def _of_label(work: Path, output: Path) -> dict[str, Any]:
    survey = str(work / "project/street.laz")
    given = {"survey": survey, "output": str(output), "least_score": 0, "export": "csv"}
    return {"label": given, "execution": {"backend": "sequential"}}


def label(work: Path, output: Path) -> None:
    """Label the street."""
    from helpers.wiring import run

    run(work / "project", "label", **_of_label(work, output))


def prepare_inventory(work: Path) -> None:
    """Load the libraries that write an inventory."""
    inventory(work, work / "loaded")
    shutil.rmtree(work / "loaded")


def inventory(work: Path, output: Path) -> None:
    """Write an inventory of a pole, a vehicle and a kerb in every format."""
    from helpers.inventories import planted_inventory

    from mlsroad_pipeline.inventory_files.exports import EXPORTS
    from mlsroad_pipeline.inventory_files.geopackage import write_geopackage
    from mlsroad_pipeline.inventory_files.geoparquet import write_geoparquet

    del work
    output.mkdir(exist_ok=True)
    given = planted_inventory()
    write_geopackage(given, output / "inventory.gpkg")
    write_geoparquet(given, output / "inventory.parquet")
    for export in EXPORTS.values():
        export.write(given, output)


def prepare_train(work: Path) -> None:
    """Make a project with the features of two tiny streets, in a process of its own, and load the configuration."""
    from helpers.wiring import TINY, make_project, run, session_of
    from kedro.framework.project import pipelines

    project = make_project(work / "project")
    child = os.fork()
    if not child:
        for name in TRAINING:
            run(project, name, **TINY)
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        sys.exit("the pipelines before the training failed")
    with session_of(project, **TINY) as session:
        dict(session.load_context().catalog.items())
        dict(pipelines)


def train(work: Path, output: Path) -> None:
    """Train a forest of ten trees in a copy of the project."""
    from helpers.wiring import TINY, run

    if not (output / "copied").exists():
        shutil.rmtree(output, ignore_errors=True)
        copied = {name: value for name, value in os.environ.items() if name != "LD_PRELOAD"}
        subprocess.run([sys.executable, "-c", COPY, str(work / "project"), str(output)], check=True, env=copied)
    run(output, "detrended_forest", **TINY)


SESSIONS = 10
"""Sessions of `corrections`; each adds three decisions and takes one of them back."""


def prepare_corrections(work: Path) -> None:
    """Load what the store of decisions needs."""
    corrections(work, work / "loaded")


def corrections(work: Path, output: Path) -> None:
    """Decide in ten sessions; what was acknowledged is in ``acknowledged`` in the work folder, a line per decision."""
    from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
    from mlsroad_pipeline.review.corrections import Correction, open_corrections

    output.mkdir(exist_ok=True)
    with (work / "acknowledged").open("a") as told:
        for session in range(SESSIONS):
            try:
                with open_corrections(output) as store:
                    for number in range(3):
                        place = {"x": float(session), "y": float(number), "z": 0.0}
                        identifier = store.add(
                            Correction("add", kind="pole", payload=place), who=f"s{session}n{number}"
                        )
                        told.write(f"added s{session}n{number}\n")
                        told.flush()
                    store.undo(identifier, who="undo")
                    told.write(f"undone s{session}n2\n")
                    told.flush()
            except (MlsRoadError, OSError) as error:
                sys.stderr.write(f"{error}\n")


COMMANDS: dict[str, tuple[Callable[[Path], None], Callable[[Path, Path], None]]] = {
    "store": (lambda work: None, store),
    "label": (prepare_label, label),
    "inventory": (prepare_inventory, inventory),
    "corrections": (prepare_corrections, corrections),
    "train": (prepare_train, train),
}


def main() -> None:
    """Fork for each line; answer with the status of the process, negative for a signal."""
    (prepare, command), work, answers = COMMANDS[sys.argv[1]], Path(sys.argv[2]), int(sys.argv[3])
    prepare(work)
    for line in sys.stdin:
        child = os.fork()
        if not child:
            with (work / "run.log").open("wb") as log:
                os.dup2(log.fileno(), 1)
                os.dup2(log.fileno(), 2)
            try:
                command(work, work / "root" / line.strip())
            except BaseException as error:
                traceback.print_exception(error)
                sys.stderr.flush()
                os._exit(1)
            os._exit(0)
        status = os.waitpid(child, 0)[1]
        os.write(answers, f"{os.waitstatus_to_exitcode(status)}\n".encode())


if __name__ == "__main__":
    main()
