"""Errors of `mlsroad` as one line with an exit code; the traceback is printed with `--verbose` alone."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.commands.console import error_console
from mlsroad_pipeline.execution.task import SceneError

FAILED, INTERRUPTED = 1, 130
"""Exit codes; 2 is that of a wrong command line."""
MAX_FAILURES = 3
"""Number of failed scenes that are named."""


def _chain(error: BaseException) -> Iterator[BaseException]:
    """Yield an error and its causes, the first cause last."""
    seen: set[int] = set()
    current: BaseException | None = error
    while current is not None and id(current) not in seen:
        seen.add(id(current))
        yield current
        current = current.__cause__ or (None if current.__suppress_context__ else current.__context__)


def describe(error: BaseException) -> str:
    """Return an error as one line: cause, file, value and remedy as the project's own errors state them."""
    chain = list(_chain(error))
    own = next((cause for cause in chain if isinstance(cause, MlsRoadError)), None)
    if isinstance(own, SceneError):
        failures = [" ".join(str(failure).split()) for failure in own.failures[:MAX_FAILURES]]
        more = len(own.failures) - len(failures)
        return "; ".join(failures) + (f"; and {more} more scenes" if more > 0 else "")
    if own is not None:
        return " ".join(str(own).split())
    system = next((cause for cause in chain if isinstance(cause, OSError) and cause.strerror), None)
    if isinstance(system, OSError):
        return f"{system.filename}: {system.strerror}" if system.filename else str(system.strerror)
    first = chain[0]
    text = str(first).strip().splitlines()
    return f"{type(first).__name__}: {text[-1].strip() if text else 'no message'} (--verbose shows the traceback)"


@contextmanager
def one_line_errors(*, verbose: bool) -> Iterator[None]:
    """End the process with one line and an exit code if the body raises."""
    try:
        yield
    except KeyboardInterrupt:
        error_console().print("Interrupted. The same command continues from here.", markup=False)
        sys.exit(INTERRUPTED)
    except Exception as error:  # the last resort of the command line: every error becomes one line
        if verbose:
            traceback.print_exc()
        error_console().print(f"Error: {describe(error)}", markup=False)
        sys.exit(FAILED)
