"""Workers of a Dask scheduler on this machine, with libraries and kernels of `label` loaded once for all of them.

Run on each machine, ``python -m mlsroad_pipeline.label.dask_workers tcp://SCHEDULER:8786 --workers 16``.
"""

from __future__ import annotations

import argparse
import gc
import logging
import tempfile
import time

from mlsroad_pipeline.execution import fork_server

PRELOADED = "mlsroad_pipeline.label.preloaded"
POLL_SECONDS = 1
"""Seconds between two looks at the workers."""


def _load_libraries() -> None:
    """Load what all workers share, with the digest of the installation."""
    import mlsroad_pipeline.execution.worker_processes  # noqa: F401, PLC0415  # after the options are read
    from mlsroad_pipeline.execution.fingerprints import installation  # noqa: PLC0415
    from mlsroad_pipeline.label.warm_up import load_first_kernel  # noqa: PLC0415

    load_first_kernel()
    installation()


def main(arguments: list[str] | None = None) -> None:
    """Start the workers, replace those that are killed, and wait until the scheduler ends."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scheduler", help="address of the scheduler; certificates are read from Dask's configuration")
    parser.add_argument("--workers", type=int, help="number of processes; one per core by default")
    given = parser.parse_args(arguments)
    logging.basicConfig(level=logging.WARNING, format="%(asctime)s %(levelname)s %(message)s")
    gc.disable()  # imports create many objects and no garbage
    fork_server.start(PRELOADED, _load_libraries)
    gc.enable()

    from distributed import Security  # noqa: PLC0415  # after the server has started

    from mlsroad_pipeline.execution.scratch import scratch_folder  # noqa: PLC0415
    from mlsroad_pipeline.execution.settings import Execution  # noqa: PLC0415
    from mlsroad_pipeline.execution.worker_processes import WorkerProcesses  # noqa: PLC0415

    n_workers = Execution(n_workers=given.workers).n_local_workers
    with tempfile.TemporaryDirectory(dir=scratch_folder()) as folder:
        workers = WorkerProcesses(n_workers, given.scheduler, Security(), folder)
        try:
            while not workers.all_left():
                workers.replace_ended(also_left=False)
                time.sleep(POLL_SECONDS)
        except KeyboardInterrupt:
            pass
        finally:
            workers.kill()
            workers.join()


if __name__ == "__main__":
    main()
