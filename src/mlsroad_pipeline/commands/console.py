"""Terminal output of `mlsroad`: progress, log records, tables, paths; errors as one line with an exit code."""

from __future__ import annotations

import errno
import logging
import re
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from mlsroad_pipeline.algorithms.core import exceptions
from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable, without_password
from mlsroad_pipeline.execution.progress import reporting_to

if TYPE_CHECKING:
    from mlsroad_pipeline.execution.task import SceneFailure

PACKAGE_LOGGER = "mlsroad_pipeline"

LINE_INTERVAL = 60.0
"""Seconds between two lines of progress where no terminal shows a bar."""


def _bar(console: Console, title: TextColumn, share: TextColumn) -> Progress:
    """Return a bar with the time spent and the time left; it disappears at the end, and needs a terminal."""
    times = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    return Progress(
        *(title, BarColumn(), share, *times), console=console, transient=True, disable=not console.is_terminal
    )


class _Lines:
    """Lines of progress for a log file; a terminal has a bar instead."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._begin = self._last = time.monotonic()
        self._first = 0.0

    def begin(self, share: float) -> None:
        """Estimate the time left from here on: what was done before says nothing of the rest."""
        self._begin, self._first = time.monotonic(), share

    def show(self, title: str, share: float, done: str) -> None:
        """Print what is done and the time left, at most every `LINE_INTERVAL` seconds."""
        now = time.monotonic()
        if self._console.is_terminal or now - self._last < LINE_INTERVAL or not 0 < share < 1:
            return
        self._last = now
        steps = share - self._first
        left = f", about {(now - self._begin) * (1 - share) / steps:.0f} s left" if steps > 0 else ""
        self._console.print(f"{title}: {done}{left}", markup=False)

    def show_compiling(self, text: str) -> None:
        """Print how many kernels are compiled, at most every `LINE_INTERVAL` seconds."""
        now = time.monotonic()
        if not self._console.is_terminal and now - self._last >= LINE_INTERVAL:
            self._last = now
            self._console.print(text, markup=False)


class Compiling(NamedTuple):
    """Kernels that a first run compiles."""

    compiled: Callable[[], int]  # Number of those that are compiled now
    total: int
    until: str  # Title of the stage whose first step ends it


class Stages:
    """One progress bar over the stages of a pipeline."""

    def __init__(
        self, stages: Mapping[str, tuple[str, float]], console: Console, *, compiling: Compiling | None = None
    ) -> None:
        self._stages = stages
        self._compiling = compiling
        self._compiled = threading.Event()
        self._bar = _bar(console, TextColumn("{task.description}"), TextColumn("{task.percentage:>3.0f} %"))
        self._title = "Starting"
        self._task: TaskID = self._bar.add_task(self._title, total=1.0)
        self._lines = _Lines(console)
        self._done = 0.0

    @contextmanager
    def shown(self) -> Iterator[None]:
        """Draw the bar while the body runs."""
        watch = None if self._compiling is None else threading.Thread(target=self._watch, args=[self._compiling])
        with self._bar, reporting_to(self.start):
            try:
                if watch is not None:
                    watch.start()
                yield
            finally:
                self._compiled.set()
                if watch is not None:
                    watch.join()

    def _watch(self, compiling: Compiling) -> None:
        """Show the number of compiled kernels once a second."""
        while not self._compiled.wait(1.0):
            text = f"Compiling, once: {compiling.compiled()} of about {compiling.total} kernels"
            self._bar.update(self._task, description=text)
            self._lines.show_compiling(text)

    def start(self, stage: str, n_scenes: int) -> _Stage:
        """Start a stage; stages that are not listed leave the bar where it is."""
        self._title, share = self._stages.get(stage, (stage, 0.0))
        if self._compiling is None or self._compiled.is_set():
            self._bar.update(self._task, description=self._title)
        return _Stage(self, share, n_scenes)

    def advance(self, share: float) -> None:
        """Move the bar by a share of the time."""
        self._done += share
        if self._compiling is not None and not self._compiled.is_set():
            if self._title != self._compiling.until:
                return
            self._compiled.set()
            self._lines.begin(self._done)
        self._bar.update(self._task, completed=min(self._done, 1.0))
        self._lines.show(self._title, self._done, f"{100 * self._done:.0f} %")


class _Stage:
    """Progress of one stage, which ends at its share of the bar also where scenes were stored before."""

    def __init__(self, bar: Stages, share: float, n_scenes: int) -> None:
        self._bar, self._left, self._step = bar, share, share / max(n_scenes, 1)

    def step(self) -> None:
        self._left -= self._step
        self._bar.advance(self._step)

    def close(self) -> None:
        self._bar.advance(max(self._left, 0.0))


@contextmanager
def survey_progress(console: Console, length: float) -> Iterator[Callable[[float], None]]:
    """Draw a bar over a street of a length in metres; the function that is yielded moves it to a distance."""
    lines = _Lines(console)
    bar = _bar(console, TextColumn("Simulating"), TextColumn("{task.completed:.0f} of {task.total:.0f} m"))
    task = bar.add_task("", total=length)

    def move(distance: float) -> None:
        bar.update(task, completed=distance)
        lines.show("Simulating", distance / length, f"{distance:.0f} of {length:.0f} m")

    with bar:
        yield move


class _Collector(logging.Handler):
    """Handler that keeps warnings, to be printed once at the end."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno < logging.ERROR:  # an error ends the run, and the command prints it
            self.messages.append(record.getMessage())


@contextmanager
def collected_warnings(*, verbose: bool) -> Iterator[list[str]]:
    """Collect the warnings that the package logs, instead of printing them; with `verbose` print every record too."""
    collector = _Collector()
    package, root = logging.getLogger(PACKAGE_LOGGER), logging.getLogger()
    package.addHandler(collector)
    before, propagate = root.handlers[:], package.propagate
    if not verbose:
        root.handlers = [logging.NullHandler()]
    try:
        yield collector.messages
    finally:
        package.removeHandler(collector)
        root.handlers, package.propagate = before, propagate


def error_console() -> Console:
    """Return the console of progress and errors."""
    return Console(stderr=True, highlight=False, emoji=False, soft_wrap=True)


def output_console() -> Console:
    """Return the console of results; the width is that of the terminal, and lines of pipes are not wrapped."""
    return Console(
        highlight=False,
        markup=False,
        emoji=False,
        soft_wrap=True,
        width=None if sys.stdout and sys.stdout.isatty() else 200,
    )


def count_table(rows: Sequence[tuple[str, ...]], titles: tuple[str, ...]) -> Table:
    """Return a plain table, its first column to the left and numbers to the right."""
    table = Table(box=None, pad_edge=False, padding=(0, 2), show_header=True, header_style="dim")
    for number, title in enumerate(titles):
        table.add_column(title, justify="left" if number == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    return table


def shown_path(path: str | Path) -> str:
    """Return a path relative to the working folder if it lies below, else as it is."""
    resolved, here = Path(path).absolute(), Path.cwd()
    return printable(resolved.relative_to(here) if resolved.is_relative_to(here) else resolved)


def print_warnings(console: Console, messages: list[Any]) -> None:
    """Print each warning on a line of its own, once."""
    unique = list(dict.fromkeys(printable(message) for message in messages))
    if unique:
        console.print("\nWarnings")
        for message in unique:
            console.print(f"  {message}")


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
    from mlsroad_pipeline.execution.task import SceneError  # 0.4 s, which only an error takes

    if isinstance(own, SceneError):
        failures = [printable(_failure(failure)) for failure in own.failures[:MAX_FAILURES]]
        more = len(own.failures) - len(failures)
        return "; ".join(failures) + (f"; and {more} more scenes" if more > 0 else "")
    if own is not None:
        return printable(own)
    lacking = next((cause.name for cause in chain if isinstance(cause, ModuleNotFoundError) and cause.name), None)
    if lacking is not None:
        return f"this needs the package {lacking}, which is not installed: a light installation lacks it"
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
    named = (failure.source, failure.scene.rpartition(".")[2])
    return message if own and any(name and name in message for name in named) else str(failure)


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
