"""Who makes a survey: this process and, where it is worth their start, others; what they make does not depend on it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import RLock, Thread
from typing import Any
from uuid import uuid4

from joblib.externals.loky.backend import get_context

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.simulation.cameras.cameras import Image
from mlsroad_pipeline.simulation.furnishing.blocks import Block, ObjectRecord
from mlsroad_pipeline.simulation.runtime.stream import SurveyStream
from mlsroad_pipeline.simulation.runtime.threads import ahead_of, workers
from mlsroad_pipeline.simulation.runtime.wires import SLOTS, Wire, forget, shared_file

_WORTHWHILE = 1_500_000  # pulses and pixels that it takes for another process to be worth its start
_AHEAD = 4  # results per worker that may wait for the one asked for
_ENDED = "a process that simulated a part of the survey ended; was there enough memory?"
_SPARES = 1  # processes that are kept for the next survey


@dataclass(frozen=True)
class Piece:
    """What one step of a survey gave; the parts that it did not give are empty.

    Parameters
    ----------
    number : int
        The block that the vehicle is in.
    records : list of ObjectRecord
        The truth about the objects of another block that came into sight.
    cloud : PointCloud or None
        Points, see `SurveyStream.scan`.
    images, depths : list
        Images, see `SurveyStream.photograph`.
    """

    number: int
    records: list[ObjectRecord] = field(default_factory=list)
    cloud: PointCloud | None = None
    images: list[Image] = field(default_factory=list)
    depths: list[Any] = field(default_factory=list)


@dataclass(frozen=True)
class _Job:
    """A step: to build a block, to scan a span of time, or to take the images of a moment."""

    number: int
    kind: str
    part: Any
    needs: Mapping[int, Future[Block]]
    promise: Future[Block]


class _Bench:
    """A stream and the blocks that its process has."""

    def __init__(self, stream: SurveyStream) -> None:
        self.stream, self.blocks = stream, dict[int, Block]()

    def do(self, number: int, kind: str, part: Any, blocks: Mapping[int, Block]) -> Any:
        stream = self.stream
        if kind == "build":
            self.blocks[part] = stream.build(part)
            return self.blocks[part]
        self.blocks |= blocks
        scene = stream.scene(number, self.blocks)
        self.blocks = {k: block for k, block in self.blocks.items() if k >= stream.near(number)[0]}
        return stream.scan_span(scene, *part) if kind == "scan" else stream.shoot(scene, part)


def _serve(pipe: Connection, path: str) -> None:
    """Do jobs for another process until it hangs up."""
    name, bench = "", None
    with suppress(EOFError, OSError):
        wire = Wire(pipe, path, 1)
        wire.send((True, None))
        jobs: SimpleQueue[Any] = SimpleQueue()
        # The next job is fetched while one is done.
        Thread(target=_fetch, args=(wire, jobs), daemon=True).start()
        while (message := jobs.get()) is not None:
            wanted, order, *job = message
            try:
                if bench is None or wanted != name:
                    parameters, length, number, start = order
                    name = wanted
                    bench = _Bench(SurveyStream(parameters, length=length, number=number, start=start))
                answer = True, bench.do(*job)
            except Exception as error:  # whatever it is, who asked must know
                answer = False, error
            wire.send(answer)


def _fetch(wire: Wire, jobs: SimpleQueue[Any]) -> None:
    """Queue what arrives, and None when the other end has hung up."""
    with suppress(EOFError, OSError):
        while True:
            jobs.put(wire.receive())
    jobs.put(None)


class _Worker:
    """Another process; `SLOTS` jobs may be given to it at a time, so that it never waits for the next one."""

    def __init__(self) -> None:
        ours, theirs = Pipe()
        self._path = shared_file()
        self._wire = Wire(ours, self._path, 0)
        # A process of this kind does not run the main module again.
        self._process = get_context("loky").Process(target=_serve, args=(theirs, self._path), daemon=True)
        self._process.start()
        theirs.close()
        self.lock, self._gone = RLock(), False
        self._ready: Future[Any] = Future()
        self._promised = deque([self._ready])
        self._reader = Thread(target=self._listen, daemon=True)
        self._reader.start()

    def wait(self) -> None:
        """Return once it is ready for work."""
        self._ready.result()
        forget(self._path)

    def ask(self, *job: Any) -> Any:
        """Have a job done."""
        return self.order(*job).result()

    def order(self, *job: Any) -> Future[Any]:
        """Give it a job; they are done in the order given."""
        promise: Future[Any] = Future()
        with self.lock:
            try:
                if self._gone:
                    raise EOFError
                self._promised.append(promise)
                self._wire.send(job)
            except (EOFError, OSError) as error:
                raise DataError(_ENDED) from error
        return promise

    def _listen(self) -> None:
        try:
            while True:
                fine, result = self._wire.receive()
                promise = self._promised.popleft()
                if fine:
                    promise.set_result(result)
                else:
                    promise.set_exception(result)
        except (EOFError, OSError):
            with self.lock:
                self._gone = True
                for promise in self._promised:
                    promise.set_exception(DataError(_ENDED))

    def is_alive(self) -> bool:
        """Tell whether it still runs."""
        return bool(self._process.is_alive())

    def end(self) -> None:
        """Let it go."""
        self._process.terminate()
        self._reader.join(timeout=5.0)
        self._wire.close()
        forget(self._path)


class _Elsewhere:
    """Another process's bench; it is sent only blocks that it lacks."""

    def __init__(self, stream: SurveyStream, worker: _Worker) -> None:
        self._worker, self._stream, self._name = worker, stream, uuid4().hex
        self._order = stream.parameters, stream.length, stream.number, stream.drive.start
        self._known: set[int] = set()

    def do(self, number: int, kind: str, part: Any, blocks: Mapping[int, Block]) -> Any:
        with self._worker.lock:
            fresh = {k: block for k, block in blocks.items() if k not in self._known}
            promise = self._worker.order(self._name, self._order, number, kind, part, fresh)
            if kind == "build":
                self._known.add(part)
            else:
                self._known = {k for k in self._known | set(fresh) if k >= self._stream.near(number)[0]}
        return promise.result()


_SPARE: list[_Worker] = []


@contextmanager
def _processes(count: int) -> Iterator[list[_Worker]]:
    """Yield processes; one stays for the next who wants it, unless something went wrong."""
    while _SPARE and not _SPARE[-1].is_alive():
        _SPARE.pop().end()
    found = [_SPARE.pop() if _SPARE else _Worker() for _ in range(count)]
    fine = False
    try:
        yield found
        fine = True
    except GeneratorExit:
        fine = True
        raise
    finally:
        for worker in found:
            if fine and len(_SPARE) < _SPARES:
                _SPARE.append(worker)
            else:
                worker.end()


def _is_worthwhile(stream: SurveyStream) -> bool:
    parameters = stream.parameters
    work = stream.length / parameters.speed * sum(device.pulse_rate for device in parameters.devices)
    if parameters.with_images:
        work += 3 * stream.length / parameters.image_interval * parameters.image_width * parameters.image_height
    return work > _WORTHWHILE


def pieces(stream: SurveyStream) -> Iterator[Piece]:
    """Yield all that a stream measures, with as many workers as it has threads.

    Parameters
    ----------
    stream : SurveyStream
        The survey.

    Yields
    ------
    Piece
        Block after block: records of what comes into sight, then points in the order of time, then images. A block of
        street is built once; for each further worker a process is started where the survey is long enough.
    """
    n = stream.n_threads if _is_worthwhile(stream) else 1
    with _processes(n - 1) as found, workers(1 + (1 + SLOTS) * (n - 1) if n > 1 else 0) as threads:
        benches: SimpleQueue[_Bench | _Elsewhere] = SimpleQueue()
        benches.put(_Bench(stream))
        for worker in found:
            assert threads is not None
            # Until it has started, the others do its work.
            threads.submit(_join, benches, stream, worker)
        yield from ahead_of(threads, lambda job: _done(job, benches), _jobs(stream), _AHEAD * n)


def _join(benches: SimpleQueue[_Bench | _Elsewhere], stream: SurveyStream, worker: _Worker) -> None:
    worker.wait()
    bench = _Elsewhere(stream, worker)
    for _ in range(SLOTS):
        benches.put(bench)


def _jobs(stream: SurveyStream) -> Iterator[_Job]:
    built: dict[int, Future[Block]] = {}
    nobody: Future[Block] = Future()
    for number in range(stream.block_count()):
        built = {k: block for k, block in built.items() if k in stream.near(number)}
        for k in stream.near(number):
            if k not in built:
                built[k] = Future()
                yield _Job(number, "build", k, {}, built[k])
        near = {k: built[k] for k in stream.near(number)}
        for span in stream.spans(number):
            yield _Job(number, "scan", span, near, nobody)
        for moment in stream.moments(number) if stream.parameters.with_images else ():
            yield _Job(number, "shoot", moment, near, nobody)


def _done(job: _Job, benches: SimpleQueue[_Bench | _Elsewhere]) -> Piece:
    # Blocks are asked for before a bench is taken: who builds them needs one.
    blocks = {k: block.result() for k, block in job.needs.items()}
    bench = benches.get()
    try:
        result = bench.do(job.number, job.kind, job.part, blocks)
    except BaseException as error:
        if job.kind == "build":
            job.promise.set_exception(error)
        raise
    finally:
        benches.put(bench)
    if job.kind == "build":
        job.promise.set_result(result)
        return Piece(job.number, records=result.records)
    if job.kind == "scan":
        return Piece(job.number, cloud=result)
    return Piece(job.number, images=result[0], depths=result[1])
