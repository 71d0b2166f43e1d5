"""Progress of the simulation of a survey, as lines."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable

SHARE_OF_ESTIMATE = 0.05
"""Share of the length from which on the time left is estimated; the first metres include the start."""

LOG_INTERVAL = 15.0
"""Seconds between two lines."""

logger = logging.getLogger(__name__)


def distance_lines(name: str, length: float) -> Callable[[float], None]:
    """Return a function that reports a distance out of a length in metres, with an estimate of the time left.

    A line is written every `LOG_INTERVAL` seconds: to the log or, in a worker process, which has none, to stderr.
    """
    start = last = time.monotonic()

    def report(distance: float) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < LOG_INTERVAL or not 0 < distance < length:
            return
        last = now
        left = (now - start) / distance * (length - distance)
        estimate = f", about {left:.0f} s left" if distance >= SHARE_OF_ESTIMATE * length else ""
        line = f"{name}: {distance:.0f} of {length:.0f} m{estimate}"
        if logger.isEnabledFor(logging.INFO):
            logger.info(line)
        else:
            sys.stderr.write(f"{line}\n")

    return report
