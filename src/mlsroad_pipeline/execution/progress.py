"""Progress reports of stages: a bar, lines in the log, or what a command shows in their place."""

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from tqdm import tqdm

LOG_INTERVAL = 15.0
"""Seconds between two progress lines in the log, written where there is no terminal for a bar."""

logger = logging.getLogger(__name__)


class StageProgress(Protocol):
    """Progress of one stage."""

    def step(self) -> None:
        """Count one scene."""

    def close(self) -> None:
        """End the report."""


Reporter = Callable[[str, int], StageProgress]
"""Function of the name of a stage and its number of scenes, called when the stage starts."""

_reporters: list[Reporter] = []


@contextmanager
def reporting_to(reporter: Reporter) -> Iterator[None]:
    """Pass the progress of all stages of this process to a reporter, in place of bars and log lines."""
    _reporters.append(reporter)
    try:
        yield
    finally:
        _reporters.remove(reporter)


def start_progress(stage: str, n_scenes: int, *, shown: bool) -> StageProgress:
    """Start the report of a stage; without a reporter, `shown` selects whether a bar or log lines are written."""
    return _reporters[-1](stage, n_scenes) if _reporters else _BarOrLog(stage, n_scenes, shown=shown)


class _BarOrLog:
    """Progress of a stage with an estimate of the time left: a bar on a terminal, otherwise lines in the log."""

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
        """Remove the bar."""
        if self._bar is not None:
            self._bar.close()
