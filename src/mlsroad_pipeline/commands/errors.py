"""Errors of `mlsroad` as one line with an exit code; the traceback is printed with `--verbose` alone."""

from __future__ import annotations

import errno
import re
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from mlsroad_pipeline.algorithms.core import exceptions
from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable, without_password
from mlsroad_pipeline.commands.console import error_console
from mlsroad_pipeline.execution.task import SceneError, SceneFailure

FAILED, INTERRUPTED = 1, 130
"""Exit codes; 2 is that of a wrong command line."""
MAX_FAILURES = 3
"""Number of failed scenes that are named."""


NO_SPACE = "free some on the disk of the results, or choose another output (-o); the same command continues"

_PARAMETER = re.compile(r"Failed to instantiate \w+ for parameter '[^']*': (.+)$")
"""Message of Kedro for a class of parameters that refuses a value; it holds the reason, but not as the cause."""


def _chain(error: BaseException) -> Iterator[BaseException]:
    """Yield an error and its causes, the first cause last."""
    seen: set[int] = set()
    current: BaseException | None = error
    while current is not None and id(current) not in seen:
        seen.add(id(current))
        yield current
        current = current.__cause__ or (None if current.__suppress_context__ else current.__context__)


def describe(error: BaseException) -> str:
    """Return an error as one line without passwords: cause, file, value and remedy as the own errors state them."""
    return without_password(_described(error))


def _described(error: BaseException) -> str:
    chain = list(_chain(error))
    own = next((cause for cause in chain if isinstance(cause, MlsRoadError)), None)
    if isinstance(own, SceneError):
        failures = [printable(_failure(failure)) for failure in own.failures[:MAX_FAILURES]]
        more = len(own.failures) - len(failures)
        return "; ".join(failures) + (f"; and {more} more scenes" if more > 0 else "")
    if own is not None:
        return printable(own)
    system = next((cause for cause in chain if isinstance(cause, OSError) and cause.strerror), None)
    if isinstance(system, OSError):
        text = f"{system.filename}: {system.strerror}" if system.filename else str(system.strerror)
        text = printable(text)
        return f"{text}: {NO_SPACE}" if system.errno in (errno.ENOSPC, errno.EDQUOT) else text
    first = chain[0]
    lines = str(first).strip().splitlines()
    if lines and (parameter := _PARAMETER.search(lines[-1])):
        return printable(parameter[1])
    return f"{type(first).__name__}: {printable(lines[-1]) if lines else 'no message'} (--verbose shows the traceback)"


def _failure(failure: SceneFailure) -> str:
    """Return the message alone of an own error that names the file; scene, file, type and message otherwise."""
    kind, _, message = failure.cause.partition(": ")
    own = isinstance(found := getattr(exceptions, kind, None), type) and issubclass(found, MlsRoadError)
    return message if own and failure.source and failure.source in message else str(failure)


def _check_working_folder() -> None:
    try:
        Path.cwd()
    except FileNotFoundError as error:
        raise ReadError("the working folder does not exist any more: change to another folder") from error


@contextmanager
def one_line_errors(*, verbose: bool) -> Iterator[None]:
    """End the process with one line and an exit code if the body raises."""
    try:
        _check_working_folder()
        yield
    except KeyboardInterrupt:
        error_console().print("Interrupted. The same command continues from here.", markup=False)
        sys.exit(INTERRUPTED)
    except (typer.Exit, typer.BadParameter):  # a wrong command line, which typer prints
        raise
    except Exception as error:  # the last resort of the command line: every error becomes one line
        if verbose:
            traceback.print_exc()
        error_console().print(f"Error: {describe(error)}", markup=False)
        sys.exit(FAILED)
