"""Settings of a stage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import joblib

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError

BACKENDS = ("loky", "threading", "sequential", "dask")
CHECKS = ("checksum", "size")


@dataclass(frozen=True)
class Execution:
    """Settings for running the scenes of a stage."""

    # Processes of this machine, threads, one after the other in this process, or a `dask.distributed` cluster
    backend: str = "loky"
    # Number of scenes processed at the same time; memory grows with it. Default: the number of cores available to this
    # process, or with `scheduler` all threads of the cluster.
    n_workers: int | None = None
    # Address of a Dask scheduler, such as ``tcp://host:8786``; the backend `dask` needs it
    scheduler: str | None = None
    progress: bool = True  # Show a progress bar on a terminal, and write progress lines to the log elsewhere
    # Check of stored results before they are reused. `size` reads no data, which suits remote storage.
    verify: str = "checksum"

    def __post_init__(self) -> None:
        if self.backend not in BACKENDS:
            raise ParameterError(f"execution: backend must be one of {BACKENDS}, got {self.backend!r}")
        n_workers = self.n_workers
        if n_workers is not None and (isinstance(n_workers, bool) or not isinstance(n_workers, int) or n_workers < 1):
            raise ParameterError(f"execution: n_workers must be a whole number > 0 or null, got {n_workers!r}")
        if self.verify not in CHECKS:
            raise ParameterError(f"execution: verify must be one of {CHECKS}, got {self.verify!r}")
        if self.scheduler is not None and self.backend != "dask":
            raise ParameterError(f"execution: scheduler {self.scheduler!r} needs the backend dask, not {self.backend}")
        if self.backend == "dask" and not self.scheduler:
            raise ParameterError(
                "execution: backend dask needs execution.scheduler, the address of a scheduler such as "
                "tcp://host:8786; loky uses all cores of this machine"
            )

    @classmethod
    def from_config(cls, config: Mapping[str, Any] | None) -> Execution:
        """Return the settings of a catalog entry; raise ParameterError for unknown keys and values."""
        known = {f.name for f in fields(cls)}
        unknown = sorted(set(config or {}) - known)
        if unknown:
            raise ParameterError(f"execution: unknown keys {unknown} (known: {sorted(known)})")
        return cls(**(config or {}))

    @property
    def n_local_workers(self) -> int:
        """Number of workers on this machine."""
        return self.n_workers or int(joblib.cpu_count())
