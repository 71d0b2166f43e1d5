"""How a stage is run: its settings, and what is told about it meanwhile."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import joblib
from tqdm import tqdm

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError

BACKENDS = ("loky", "threading", "sequential", "dask")
CHECKS = ("checksum", "size")
LOG_INTERVAL = 15.0
"""Seconds between two lines of the log where there is no terminal for a progress bar."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Execution:
    """How the scenes of a stage are run.

    Parameters
    ----------
    backend : {"loky", "threading", "sequential", "dask"}, default "loky"
        Processes of this machine, threads, one after the other in this process, or a `dask.distributed` cluster.
    n_workers : int, optional
        How many scenes are in work at the same time; memory grows with it. By default the number of cores that this
        process may use, or with `scheduler` all threads of the cluster.
    scheduler : str, optional
        Address of a Dask scheduler, such as ``tcp://host:8786``. Without it the `dask` backend uses the process's
        current client if there is one, and otherwise starts a local cluster for the stage.
    progress : bool, default True
        Show a progress bar on a terminal, and write lines into the log elsewhere.
    verify : {"checksum", "size"}, default "checksum"
        How a stored result is looked at before it is taken for valid. `size` reads no data, for remote storage.

    Raises
    ------
    ParameterError
        If a value is outside of these, or if `scheduler` is given to another backend.
    """

    backend: str = "loky"
    n_workers: int | None = None
    scheduler: str | None = None
    progress: bool = True
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

    @classmethod
    def from_config(cls, config: Mapping[str, Any] | None) -> Execution:
        """Build the settings from a catalog entry.

        Raises
        ------
        ParameterError
            If a key is unknown or a value outside its domain.
        """
        known = {f.name for f in fields(cls)}
        unknown = sorted(set(config or {}) - known)
        if unknown:
            raise ParameterError(f"execution: unknown keys {unknown} (known: {sorted(known)})")
        return cls(**(config or {}))

    @property
    def n_local_workers(self) -> int:
        """The number of workers on this machine."""
        return self.n_workers or int(joblib.cpu_count())


class Progress:
    """Tells how far a stage is: a bar with an estimate of the time left on a terminal, else lines in the log.

    Parameters
    ----------
    stage : str
        Name of the stage, in front of the bar and of the lines.
    n_scenes : int
        How many scenes it has to compute.
    shown : bool
        Whether to tell anything.
    """

    def __init__(self, stage: str, n_scenes: int, *, shown: bool) -> None:
        self._stage = stage
        self._total = n_scenes
        self._done = 0
        self._start = self._last = time.monotonic()
        self._shown = shown
        terminal = shown and sys.stderr.isatty()
        self._bar = tqdm(total=n_scenes, desc=stage, unit="scene", dynamic_ncols=True) if terminal else None

    def step(self) -> None:
        """Count one scene."""
        self._done += 1
        now = time.monotonic()
        if self._bar is not None:
            self._bar.update()
        elif self._shown and now - self._last >= LOG_INTERVAL and self._done < self._total:
            self._last = now
            left = (now - self._start) / self._done * (self._total - self._done)
            logger.info("%s: %d of %d scenes, about %.0f s left", self._stage, self._done, self._total, left)

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.close()
