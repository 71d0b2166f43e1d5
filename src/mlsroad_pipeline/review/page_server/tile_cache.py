"""Tiles of an output folder: found by size and time of the labelled files, or built in a process of their own."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import multiprocessing.process
import shutil
import signal
import threading
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from mlsroad_pipeline.formats.files import atomic_file
from mlsroad_pipeline.review.page_server.cloud_files import CloudFiles
from mlsroad_pipeline.review.page_server.first_picture import FirstPicture
from mlsroad_pipeline.review.page_server.lock import CACHE
from mlsroad_pipeline.review.page_server.tile_building import build_tiles, unfinished
from mlsroad_pipeline.review.page_server.tile_format import FORMAT, TileIndex, point_bytes

TILES, PICTURE = "tiles-", "first-"
_START = multiprocessing.get_context("spawn")


def mark_of(folder: Path, names: list[str]) -> str:
    """Return what changes with the labelled files: a digest of their names, sizes and times."""
    states = [(name, (folder / name).stat().st_size, (folder / name).stat().st_mtime_ns) for name in names]
    return hashlib.blake2b(json.dumps([FORMAT, states]).encode(), digest_size=8).hexdigest()


class TileCache:
    """Tiles of an output folder."""

    def __init__(self, folder: Path, names: list[str]) -> None:
        self._output, self._names = folder, names
        self._mark = mark_of(folder, names)
        self.folder = folder / CACHE / f"{TILES}{self._mark}"
        self._process: multiprocessing.process.BaseProcess | None = None
        self._channel: Connection | None = None
        self._share, self._error = 0.0, ""
        self._guard, self._stopped = threading.Lock(), False
        self._index: TileIndex | None = None

    @property
    def _picture(self) -> Path:
        return self.folder.with_name(f"{PICTURE}{self._mark}")

    def kept_picture(self) -> FirstPicture | None:
        """Return the first picture of an earlier opening, None if there is none of these files or it is damaged."""
        try:
            text, _, chunk = self._picture.read_bytes().partition(b"\n")
            facts = json.loads(text)
            whole = len(chunk) == facts["n_points"] * point_bytes(facts["coloured"])
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return FirstPicture(chunk, facts) if whole else None

    def keep_picture(self, picture: FirstPicture) -> None:
        """Keep the first picture for the next opening."""
        if self.folder.parent.is_dir() and self.kept_picture() is None:
            with atomic_file(self._picture) as stream:
                stream.write(json.dumps(picture.facts).encode() + b"\n" + picture.chunk)

    def start(self) -> None:
        """Start to build the tiles if there are none; those of other versions of the files are removed."""
        for other in self.folder.parent.glob(f"{TILES}*"):
            if other != self.folder:
                shutil.rmtree(other, ignore_errors=True)
        for picture in self.folder.parent.glob(f"{PICTURE}*"):
            if picture != self._picture:
                picture.unlink()
        with self._guard:
            if self.index() is None and not self._stopped:
                self._start()

    def _start(self) -> None:
        """Start the process; Ctrl-C does not reach it, it is ended by `stop`."""
        self._channel, other_end = _START.Pipe(duplex=False)
        arguments = (str(self._output), self._names, str(self.folder), other_end)
        self._process = _START.Process(target=_build, args=arguments, daemon=True)
        resource_tracker.ensure_running()  # it would unblock the signal
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))  # inherited by the process
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            other_end.close()

    def index(self) -> TileIndex | None:
        """Return the index, None while the tiles are not finished."""
        if self._index is None:
            self._index = TileIndex.read(self.folder)
        return self._index

    def status(self) -> dict[str, Any]:
        """Return the state: `ready`, `building` with the share that is done, `failed` with the reason, or `stale`."""
        try:
            changed = mark_of(self._output, self._names) != self._mark
        except OSError:
            changed = True
        if changed:
            return {"state": "stale", "share": 1.0}
        if self.index() is not None:
            return {"state": "ready", "share": 1.0}
        with self._guard:  # two tabs may request it at the same time
            self._receive()
        alive = not self._error if self._process is None else self._process.is_alive()
        if not alive and self.index() is None:
            return {"state": "failed", "share": self._share, "error": self._error or "the process ended early"}
        return {"state": "building", "share": self._share}

    def _receive(self) -> None:
        while self._channel is not None and self._channel.poll():
            try:
                kind, value = self._channel.recv()
            except EOFError:
                self._channel = None
                break
            if kind == "share":
                self._share = value
            else:
                self._error = value

    def fail(self, reason: str) -> None:
        """State why the tiles cannot be built."""
        self._error = reason

    def stop(self) -> None:
        """End the process that builds."""
        with self._guard:
            self._stopped = True
            if self._process is not None and self._process.is_alive():
                self._process.terminate()
                self._process.join()
                shutil.rmtree(unfinished(self.folder), ignore_errors=True)


def _build(output: str, names: list[str], folder: str, channel: Connection) -> None:
    """Build tiles and send the share that is done; the process ends with the one that started it."""
    parent = multiprocessing.parent_process()

    def progress(share: float) -> None:
        if parent is not None and not parent.is_alive():
            raise SystemExit
        channel.send(("share", share))

    try:
        build_tiles(CloudFiles.at(Path(output), names), Path(folder), progress=progress)
    except (KeyboardInterrupt, BrokenPipeError):
        pass
    except Exception as error:  # shown in the page
        channel.send(("error", " ".join(str(error).split()) or type(error).__name__))
