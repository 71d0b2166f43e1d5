"""Scene store: result files, a record per scene that makes them valid, and a manifest of all scenes.

```
<store>/manifest.json            all records, written last; during a run it holds the token of that run instead
<store>/<scene>/record.json      fingerprint of the task; name, size and checksum of each part; written after the parts
<store>/<scene>/<part>.parquet   the parts (`result` for a result that is not divided)
```

Local files and their folders are synchronised to the disk before the record that names them, so a record that survives
a power failure names complete files. A manifest that cannot be read still marks the folder as a store: scenes with a
record are kept. A process that outlives its killed run reads another token in the manifest, or none, and stores
nothing.
"""

from __future__ import annotations

import hashlib
import io
import socket
import uuid
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import PurePosixPath
from typing import Any

from fsspec.implementations.local import LocalFileSystem

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MlsRoadError, ReadError
from mlsroad_pipeline.execution.digests import digest_json, new_digest
from mlsroad_pipeline.execution.result_files import EXTENSIONS, SINGLE, read_part, split_parts, write_part
from mlsroad_pipeline.execution.store_files import SHARED, HashingStream, StoreFiles

FORMAT = 1
"""Version of the records and manifests; results of other versions are computed again."""
MANIFEST = "manifest.json"
RECORD = "record.json"
_BLOCK = 1 << 20


class SupersededError(MlsRoadError):
    """Another run has taken over the store; this run stores nothing more."""


@dataclass(frozen=True)
class Part:
    """One file of a result: its name, its kind (a key of `EXTENSIONS`), its size in bytes and its BLAKE2b checksum."""

    name: str
    kind: str
    size: int
    checksum: str

    @property
    def file(self) -> str:
        """The file's name in the folder of its scene."""
        return f"{self.name}.{EXTENSIONS[self.kind]}"


@dataclass(frozen=True)
class Record:
    """Record of a stored result: the fingerprint of its task and its files."""

    task: str
    parts: tuple[Part, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the record as plain data."""
        return {"format": FORMAT, "task": self.task, "parts": [asdict(part) for part in self.parts]}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Record:
        """Return the record of `to_json`; raise KeyError, TypeError or ValueError for other data."""
        if data["format"] != FORMAT:
            raise ValueError(f"record of format {data['format']}, not {FORMAT}")
        return cls(data["task"], tuple(Part(**part) for part in data["parts"]))

    def fingerprint(self, part: str | None = None) -> str:
        """Return the fingerprint of the stored content, or of one part; raise DataError for an unknown part."""
        chosen = [p for p in self.parts if part is None or p.name == part]
        if part is not None and not chosen:
            names = ", ".join(p.name for p in self.parts)
            raise DataError(f"no part {part!r} is stored (parts: {names})")
        return digest_json([[p.name, p.kind, p.checksum] for p in chosen])


def _is_store_file(path: str) -> bool:
    """Return whether a store writes files of this relative path."""
    parts = PurePosixPath(path).parts
    if parts == (MANIFEST,) or parts[0] == SHARED:
        return True
    own = parts[-1] == RECORD or PurePosixPath(path).suffix.removeprefix(".") in EXTENSIONS.values()
    return len(parts) == 2 and own


class SceneStore(StoreFiles):
    """Scenes and manifest of a store; small and picklable, like the `StoreFiles` below it."""

    # --- scenes --------------------------------------------------------------------------------------------------

    def read_record(self, key: str) -> Record | None:
        """Return the record of a scene, or None if it is missing or incomplete."""
        data = self.read_json(f"{key}/{RECORD}")
        try:
            return None if data is None else Record.from_json(data)
        except (KeyError, TypeError, ValueError):
            return None

    def is_intact(self, key: str, record: Record, *, checksums: bool) -> bool:
        """Return whether the files of a scene have the sizes, and optionally the checksums, of its record."""
        filesystem, root = self.opened()
        for part in record.parts:
            path = f"{root}/{key}/{part.file}"
            try:
                if filesystem.size(path) != part.size:
                    return False
                if checksums:
                    with filesystem.open(path, "rb", block_size=_BLOCK) as stream:
                        if hashlib.file_digest(stream, new_digest).hexdigest() != part.checksum:
                            return False
            except FileNotFoundError:
                return False
        return True

    def commit(self, key: str, task: str, result: Any, *, token: str) -> Record:
        """Store a result: remove the old record first, write the new one last."""
        parts = split_parts(result)
        self.check_held(token)
        self.remove(f"{key}/{RECORD}")
        self.remove(key)
        written = []
        for name, part in parts.items():
            with self.writing(f"{key}/{name}.{EXTENSIONS[part.kind]}", sync_entry=False) as target:
                stream = HashingStream(target)
                write_part(part.kind, part.value, stream)
            written.append(Part(name, part.kind, stream.size, stream.digest.hexdigest()))
        record = Record(task, tuple(written))
        self.sync_entries(key)
        self.write_json(f"{key}/{RECORD}", record.to_json())
        return record

    def load(self, key: str, *, fingerprint: str, part: str | None = None, mapped: bool = False) -> Any:
        """Read a result or one part of it; raise ReadError if it is missing, replaced since or unreadable."""
        record = self.read_record(key)
        if record is None:
            raise ReadError(f"{self.url}: scene {key!r} is not stored")
        if record.fingerprint(part) != fingerprint:
            raise ReadError(f"{self.url}: scene {key!r} has been computed anew since this store was loaded")
        chosen = [p for p in record.parts if part is None or p.name == part]
        values = {p.name: self._load_part(key, p, mapped=mapped) for p in chosen}
        return values[chosen[0].name] if part is not None or SINGLE in values else values

    def _load_part(self, key: str, part: Part, *, mapped: bool) -> Any:
        filesystem, root = self.opened()
        path = f"{root}/{key}/{part.file}"
        try:
            local = isinstance(filesystem, LocalFileSystem)
            return read_part(part.kind, path if local else io.BytesIO(filesystem.cat_file(path)), mapped=mapped)
        except Exception as error:
            raise ReadError(f"{path}: cannot be read: {type(error).__name__}: {error}") from error

    # --- the whole store -------------------------------------------------------------------------------------------

    def check_ours(self) -> None:
        """Raise DataError for a folder with files of others: a store removes unknown files.

        A manifest of a store proves ownership. One that cannot be read, as after a power failure, does where all other
        files are such as a store writes.
        """
        manifest = self.read_json(MANIFEST)
        if isinstance(manifest, Mapping) and "format" in manifest:
            return
        damaged = manifest is None and self.exists(MANIFEST)
        foreign = sorted(
            path
            for path in self.listing()
            if path != ".gitkeep" and not path.endswith(".tmp") and not (damaged and _is_store_file(path))
        )
        if foreign:
            raise DataError(f"{self.url} is not a scene store but holds {len(foreign)} files, such as {foreign[0]}")

    def begin(self) -> str:
        """Take over the store for a run and return its token; the store is incomplete until `finish`."""
        token = uuid.uuid4().hex
        self.write_json(MANIFEST, {"format": FORMAT, "run": token})
        return token

    def is_held(self, token: str) -> bool:
        """Return whether the run with this token holds the store."""
        manifest = self.read_json(MANIFEST)
        return manifest is not None and manifest.get("run") == token

    def check_held(self, token: str) -> None:
        """Raise SupersededError if another run has taken over the store."""
        if self.is_held(token):
            return
        if not self.exists(MANIFEST):
            raise SupersededError(
                f"{self.url} is not there on {socket.gethostname()}: it was removed, or this worker does not share "
                "that folder; mount it at the same path, or use an object store"
            )
        raise SupersededError(f"{self.url}: another run has taken this store over")

    def release(self, token: str) -> None:
        """End an unfinished run, so that its remaining workers store nothing more."""
        if self.is_held(token):
            self.remove(SHARED)
            self.write_json(MANIFEST, {"format": FORMAT, "run": None})

    def finish(self, records: Mapping[str, Record], *, token: str, keep: bool = False) -> None:
        """Remove other scenes, or keep them, and write the manifest; raise SupersededError after a takeover."""
        self.check_held(token)
        if keep:
            records = {**self.stored_records(), **records}
        else:
            for name in set(self.names()) - set(records) - {MANIFEST, ".gitkeep"}:
                self.remove(name)
        scenes = {key: records[key].to_json() for key in sorted(records)}
        self.write_json(MANIFEST, {"format": FORMAT, "scenes": scenes})

    def stored_records(self) -> dict[str, Record]:
        """Return the records of all intact scenes in the folder, whatever the manifest holds."""
        found = {name: self.read_record(name) for name in self.names()}
        return {
            name: record
            for name, record in found.items()
            if record is not None and self.is_intact(name, record, checksums=False)
        }

    def clean(self) -> None:
        """Remove temporary files and shared values of a killed run."""
        self.remove(SHARED)
        for path in self.listing():
            name = PurePosixPath(path).name
            if name.startswith(".") and name.endswith(".tmp"):
                self.remove(path)

    def read_manifest(self) -> dict[str, Record] | None:
        """Return the records of all scenes, or None for an incomplete store."""
        manifest = self.read_json(MANIFEST)
        try:
            scenes = None if manifest is None else manifest.get("scenes")
            return None if scenes is None else {key: Record.from_json(data) for key, data in scenes.items()}
        except (AttributeError, KeyError, TypeError, ValueError):
            return None

    def is_complete(self) -> bool:
        """Return whether there is a manifest and all files of its scenes exist in their recorded sizes."""
        records = self.read_manifest()
        if records is None:
            return False
        files = self.listing()
        for key, record in records.items():
            if f"{key}/{RECORD}" not in files:
                return False
            if any(files.get(f"{key}/{part.file}") != part.size for part in record.parts):
                return False
        return True
