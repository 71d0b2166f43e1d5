"""Who makes a survey: this process and, where it is worth their start, others; what they make does not depend on it."""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any
from uuid import uuid4

import numpy as np
from joblib.externals.loky.backend import get_context

from mlsroad_pipeline.algorithms.exceptions import DataError
from mlsroad_pipeline.algorithms.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.simulation.blocks import Block, ObjectRecord
from mlsroad_pipeline.algorithms.simulation.cameras import Image
from mlsroad_pipeline.algorithms.simulation.stream import SurveyStream
from mlsroad_pipeline.algorithms.simulation.threads import ahead_of, workers

_WORTHWHILE = 1_500_000  # pulses and pixels that it takes for another process to be worth its start
_AHEAD = 4  # results per worker that may wait for the one asked for
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


def _serve(wire: Connection) -> None:
    """Do jobs for another process until it hangs up."""
    name, bench = "", None
    with suppress(EOFError, OSError):
        _send(wire, True)
        while True:
            wanted, order, *job = _receive(wire)
            try:
                if bench is None or wanted != name:
                    parameters, length, number, start = order
                    name = wanted
                    bench = _Bench(SurveyStream(parameters, length=length, number=number, start=start))
                answer = True, bench.do(*job)
            except Exception as error:  # whatever it is, who asked must know
                answer = False, error
            _send(wire, answer)


def _send(wire: Connection, thing: Any) -> None:
    """Send an object, its arrays as they lie in memory."""
    buffers: list[pickle.PickleBuffer] = []
    head = pickle.dumps(thing, protocol=5, buffer_callback=buffers.append)
    raw = [buffer.raw() for buffer in buffers]
    wire.send((head, [part.nbytes for part in raw]))
    for part in raw:
        if part.nbytes:
            wire.send_bytes(part)


def _receive(wire: Connection) -> Any:
    head, sizes = wire.recv()
    buffers = [np.empty(size, np.uint8) for size in sizes]
    for buffer in buffers:
        if len(buffer):
            wire.recv_bytes_into(buffer)
    return pickle.loads(head, buffers=buffers)


class _Worker:
    """Another process."""

    def __init__(self) -> None:
        self._wire, theirs = Pipe()
        # A process of this kind does not run the main module again.
        self._process = get_context("loky").Process(target=_serve, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()
        self._started = False

    def wait(self) -> None:
        """Return once it is ready for work."""
        if not self._started:
            self._started = self._answer()

    def ask(self, *job: Any) -> Any:
        """Have a job done."""
        _send(self._wire, job)
        fine, result = self._answer()
        if not fine:
            raise result
        return result

    def _answer(self) -> Any:
        try:
            return _receive(self._wire)
        except (EOFError, OSError) as error:
            raise DataError("a process that simulated a part of the survey ended; was there enough memory?") from error

    def is_alive(self) -> bool:
        """Tell whether it still runs."""
        return bool(self._process.is_alive())

    def end(self) -> None:
        """Let it go."""
        self._wire.close()
        self._process.terminate()


class _Elsewhere:
    """Another process's bench; it is sent only blocks that it lacks."""

    def __init__(self, stream: SurveyStream, worker: _Worker) -> None:
        self._worker, self._stream, self._name = worker, stream, uuid4().hex
        self._order = stream.parameters, stream.length, stream.number, stream.drive.start
        self._known: set[int] = set()

    def do(self, number: int, kind: str, part: Any, blocks: Mapping[int, Block]) -> Any:
        fresh = {k: block for k, block in blocks.items() if k not in self._known}
        result = self._worker.ask(self._name, self._order, number, kind, part, fresh)
        if kind == "build":
            self._known.add(part)
        else:
            self._known = {k for k in self._known | set(fresh) if k >= self._stream.near(number)[0]}
        return result


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
    with _processes(n - 1) as found, workers(2 * n - 1 if n > 1 else 0) as threads:
        benches: SimpleQueue[_Bench | _Elsewhere] = SimpleQueue()
        benches.put(_Bench(stream))
        for worker in found:
            assert threads is not None
            # Until it has started, the others do its work.
            threads.submit(_join, benches, stream, worker)
        yield from ahead_of(threads, lambda job: _done(job, benches), _jobs(stream), _AHEAD * n)


def _join(benches: SimpleQueue[_Bench | _Elsewhere], stream: SurveyStream, worker: _Worker) -> None:
    worker.wait()
    benches.put(_Elsewhere(stream, worker))


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
