"""Process that loads all libraries, then forks: ``label`` or ``train`` into the folder of each line of its input."""

from __future__ import annotations

import os
import sys
import traceback
from pathlib import Path
from typing import Any

import numpy as np
from helpers.wiring import make_project, run, session_of
from kedro.framework.project import pipelines

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.options import WriteOptions
from mlsroad_pipeline.label.warm_up import run_stages


def street(path: Path) -> Path:
    """Write 12 m of a road with a pole."""
    rng = np.random.default_rng(1)
    road = np.column_stack([rng.uniform(0, 12, 1500), rng.uniform(0, 6, 1500), rng.normal(0, 0.01, 1500)])
    pole = rng.normal(0, 0.03, (300, 3)) + np.column_stack([np.full((300, 2), 5.0), np.linspace(0.1, 4.0, 300)])
    cloud = PointCloud(np.concatenate([road, pole]), {}, np.array([389_300.0, 5_819_700.0, 34.0]), source=str(path))
    LasFormat().write(path, cloud, WriteOptions(like="none"))
    return path


def parameters_of(project: Path, output: Path) -> dict[str, Any]:
    """Return the parameters of a run."""
    given = {"survey": str(project / "street.laz"), "output": str(output), "least_score": 0, "export": "csv"}
    return {"label": given, "execution": {"backend": "sequential"}}


def label(project: Path, output: Path) -> None:
    """Label the street."""
    run(project, "label", **parameters_of(project, output))


def load(project: Path) -> None:
    """Load libraries, kernels and the configuration, but start no thread: a forked process would wait for it."""
    run_stages()
    with session_of(project, **parameters_of(project, project / "loaded")) as session:
        dict(session.load_context().catalog.items())
        dict(pipelines)


def main() -> None:
    """Fork for each line; answer with the status of the process, negative for a signal."""
    command, work, answers = {"label": label}[sys.argv[1]], Path(sys.argv[2]), int(sys.argv[3])
    project = make_project(work / "project")
    street(project / "street.laz")
    load(project)
    for line in sys.stdin:
        child = os.fork()
        if not child:
            with (work / "run.log").open("wb") as log:
                os.dup2(log.fileno(), 1)
                os.dup2(log.fileno(), 2)
            try:
                command(project, work / "root" / line.strip())
            except BaseException as error:
                traceback.print_exception(error)
                sys.stderr.flush()
                os._exit(1)
            os._exit(0)
        status = os.waitpid(child, 0)[1]
        os.write(answers, f"{os.waitstatus_to_exitcode(status)}\n".encode())


if __name__ == "__main__":
    main()
