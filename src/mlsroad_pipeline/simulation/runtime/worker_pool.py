"""Worker pool of a survey: this process and, for long surveys, others; points do not depend on their number."""

import sys
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from threading import RLock, Thread
from typing import Any, NamedTuple
from uuid import uuid4

from joblib.externals.loky.backend import get_context

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.simulation.furnishing.blocks import Block
from mlsroad_pipeline.simulation.runtime.channels import SLOTS, Channel, create_shared_file
from mlsroad_pipeline.simulation.runtime.stream import SurveyStream

_MIN_WORK = 1_500_000  # pulses and pixels from which on a further process pays for its start
_AHEAD = 4  # results per worker that are computed ahead, which bounds the memory
_SWITCH = 0.0002  # seconds a thread may hold the interpreter lock while others wait
_ENDED = "a process that simulated a part of the survey ended; check whether there was enough memory"
_MAX_IDLE = 1  # idle processes that are kept for the next survey


class Result(NamedTuple):
    """Result of one task of a survey."""

    number: int  # The vehicle's block
    kind: str  # ``"build"``, ``"scan"`` or ``"shoot"``
    # A new block within range, points as from `SurveyStream.scan_span`, or images as from `SurveyStream.shoot`
    value: Any


@dataclass(frozen=True)
class _Task:
    """A task: build a block, scan a span of time, or take the images of a moment."""

    number: int
    kind: str
    part: Any
    needs: Mapping[int, Future[Block]]
    built: Future[Block]


class _LocalWorker:
    """A worker in this process: a stream and the blocks built so far."""

    def __init__(self, stream: SurveyStream) -> None:
        self.stream, self.blocks = stream, dict[int, Block]()

    def run(self, number: int, kind: str, part: Any, blocks: Mapping[int, Block]) -> Any:
        stream = self.stream
        if kind == "build":
            self.blocks[part] = stream.build(part)
            return self.blocks[part]
        self.blocks |= blocks
        scene = stream.scene(number, self.blocks)
        self.blocks = {k: block for k, block in self.blocks.items() if k >= stream.near(number)[0]}
        return stream.scan_span(scene, *part) if kind == "scan" else stream.shoot(scene, part)


def _serve(pipe: Connection, path: str) -> None:
    """Run the tasks of another process until its end of the channel is closed."""
    current, worker = "", None
    with suppress(EOFError, OSError):
        channel = Channel(pipe, path, 1)
        channel.send((True, None))
        tasks: SimpleQueue[Any] = SimpleQueue()
        # The next task is received while one runs.
        Thread(target=_receive_tasks, args=(channel, tasks), daemon=True).start()
        while (message := tasks.get()) is not None:
            survey, arguments, *task = message
            try:
                if worker is None or survey != current:
                    parameters, length, number, start = arguments
                    current = survey
                    worker = _LocalWorker(SurveyStream(parameters, length=length, number=number, start=start))
                reply = True, worker.run(*task)
            except Exception as error:  # of any kind: the other process raises it
                reply = False, error
            channel.send(reply)


def _receive_tasks(channel: Channel, tasks: SimpleQueue[Any]) -> None:
    """Queue the messages that arrive, then None when the other end is closed."""
    with suppress(EOFError, OSError):
        while True:
            tasks.put(channel.receive())
    tasks.put(None)


class _Process:
    """Another process; it may hold `SLOTS` tasks at a time, so that it never waits for the next one."""

    def __init__(self) -> None:
        ours, theirs = Pipe()
        self._path = Path(create_shared_file())
        self._channel = Channel(ours, str(self._path), 0)
        # Processes of this context do not run the main module again.
        self.process = get_context("loky").Process(target=_serve, args=(theirs, str(self._path)), daemon=True)
        self.process.start()
        theirs.close()
        self.lock, self._ended = RLock(), False
        self._ready: Future[Any] = Future()
        self._pending = deque([self._ready])
        self._reader = Thread(target=self._read_replies, daemon=True)
        self._reader.start()

    def wait_until_ready(self) -> None:
        """Return when the process accepts tasks."""
        self._ready.result()
        self._path.unlink(missing_ok=True)

    def submit(self, *task: Any) -> Future[Any]:
        """Queue a task; tasks run in the order submitted."""
        future: Future[Any] = Future()
        with self.lock:
            try:
                if self._ended:
                    raise EOFError
                self._pending.append(future)
                self._channel.send(task)
            except (EOFError, OSError) as error:
                raise DataError(_ENDED) from error
        return future

    def _read_replies(self) -> None:
        try:
            while True:
                succeeded, result = self._channel.receive()
                future = self._pending.popleft()
                if succeeded:
                    future.set_result(result)
                else:
                    future.set_exception(result)
        except (EOFError, OSError):
            with self.lock:
                self._ended = True
                for future in self._pending:
                    future.set_exception(DataError(_ENDED))

    def end(self) -> None:
        """Terminate the process and close the channel."""
        self.process.terminate()
        self._reader.join(timeout=5.0)
        self._channel.close()
        self._path.unlink(missing_ok=True)


class _RemoteWorker:
    """A worker in another process, which is sent only the blocks that it lacks."""

    def __init__(self, stream: SurveyStream, process: _Process) -> None:
        self._process, self._stream, self._survey = process, stream, uuid4().hex
        self._arguments = stream.parameters, stream.length, stream.number, stream.drive.start
        self._known: set[int] = set()

    def run(self, number: int, kind: str, part: Any, blocks: Mapping[int, Block]) -> Any:
        with self._process.lock:
            fresh = {k: block for k, block in blocks.items() if k not in self._known}
            future = self._process.submit(self._survey, self._arguments, number, kind, part, fresh)
            if kind == "build":
                self._known.add(part)
            else:
                self._known = {k for k in self._known | set(fresh) if k >= self._stream.near(number)[0]}
        return future.result()


_IDLE: list[_Process] = []


@contextmanager
def _processes(count: int) -> Iterator[list[_Process]]:
    """Yield processes; `_MAX_IDLE` of them are kept for the next survey unless an error occurred."""
    while _IDLE and not _IDLE[-1].process.is_alive():
        _IDLE.pop().end()
    processes = [_IDLE.pop() if _IDLE else _Process() for _ in range(count)]
    kept = _MAX_IDLE
    try:
        yield processes
    except (Exception, KeyboardInterrupt):
        kept = 0
        raise
    finally:
        for process in processes:
            if len(_IDLE) < kept:
                _IDLE.append(process)
            else:
                process.end()


def _needs_processes(stream: SurveyStream) -> bool:
    parameters = stream.parameters
    work = stream.length / parameters.speed * sum(device.pulse_rate for device in parameters.devices)
    if parameters.with_images:
        work += 3 * stream.length / parameters.image_interval * parameters.image_width * parameters.image_height
    return work > _MIN_WORK


def run_survey(stream: SurveyStream) -> Iterator[Result]:
    """Yield all measurements of a stream, computed by as many workers as it has threads.

    The order is block by block: new blocks within range, points in the order of time, images. Each block of
    street is built once. Each further worker is a process of its own if the survey is long enough.
    """
    workers: SimpleQueue[_LocalWorker | _RemoteWorker] = SimpleQueue()
    workers.put(_LocalWorker(stream))
    n = stream.n_threads if _needs_processes(stream) else 1
    if n == 1:
        yield from (_run(task, workers) for task in _tasks(stream))
        return
    with _processes(n - 1) as processes, _threads(1 + (1 + SLOTS) * (n - 1)) as threads:
        for process in processes:
            # The other workers run its tasks until it has started.
            threads.submit(_join, workers, stream, process)
        waiting: deque[Future[Result]] = deque()
        for task in _tasks(stream):
            waiting.append(threads.submit(_run, task, workers))
            if len(waiting) > _AHEAD * n:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


@contextmanager
def _threads(count: int) -> Iterator[ThreadPoolExecutor]:
    """Yield a pool of threads; pending tasks are cancelled on exit."""
    pool = ThreadPoolExecutor(count)
    # Compiled code releases the interpreter lock and takes it back often: waits of 5 ms would add up.
    interval = sys.getswitchinterval()
    sys.setswitchinterval(min(interval, _SWITCH))
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        sys.setswitchinterval(interval)


def _join(workers: SimpleQueue[_LocalWorker | _RemoteWorker], stream: SurveyStream, process: _Process) -> None:
    process.wait_until_ready()
    worker = _RemoteWorker(stream, process)
    for _ in range(SLOTS):
        workers.put(worker)


def _tasks(stream: SurveyStream) -> Iterator[_Task]:
    built: dict[int, Future[Block]] = {}
    unused: Future[Block] = Future()
    for number in range(stream.block_count()):
        built = {k: block for k, block in built.items() if k in stream.near(number)}
        for k in stream.near(number):
            if k not in built:
                built[k] = Future()
                yield _Task(number, "build", k, {}, built[k])
        near = {k: built[k] for k in stream.near(number)}
        for span in stream.spans(number):
            yield _Task(number, "scan", span, near, unused)
        for moment in stream.moments(number) if stream.parameters.with_images else ():
            yield _Task(number, "shoot", moment, near, unused)


def _run(task: _Task, workers: SimpleQueue[_LocalWorker | _RemoteWorker]) -> Result:
    # Blocks are awaited before a worker is taken: the tasks that build them need one.
    blocks = {k: block.result() for k, block in task.needs.items()}
    worker = workers.get()
    try:
        result = worker.run(task.number, task.kind, task.part, blocks)
    except BaseException as error:
        if task.kind == "build":
            task.built.set_exception(error)
        raise
    finally:
        workers.put(worker)
    if task.kind == "build":
        task.built.set_result(result)
    return Result(task.number, task.kind, result)
