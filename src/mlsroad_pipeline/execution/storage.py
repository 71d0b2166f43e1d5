"""Where a scene store lies: files of results, a record per scene that makes them valid, a manifest over all scenes.

```
<store>/manifest.json            all records, written last; while a run is under way it holds that run's token instead
<store>/<scene>/record.json      fingerprint, and name, size and checksum of each part; written after the parts
<store>/<scene>/<part>.parquet   the parts (`result` where there is only one)
```

Nothing is synchronised to the disk: after a power failure the checksums tell what is whole. A process that outlived
its killed run finds another token in the manifest, or none, and stores nothing.
"""

from __future__ import annotations

import hashlib
import io
import uuid
from collections.abc import Collection, Mapping
from pathlib import PurePosixPath
from typing import Any

from fsspec.implementations.local import LocalFileSystem

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MlsRoadError, ReadError
from mlsroad_pipeline.execution.digests import new_digest
from mlsroad_pipeline.execution.files import SHARED, HashingStream, StoreFiles
from mlsroad_pipeline.execution.record import FORMAT, Part, Record
from mlsroad_pipeline.execution.results import EXTENSIONS, SINGLE, read_part, split_parts, write_part

MANIFEST = "manifest.json"
RECORD = "record.json"
_BLOCK = 1 << 20


class SupersededError(MlsRoadError):
    """Another run has taken the store over; this one stores nothing more."""


class SceneStorage(StoreFiles):
    """A store's scenes and manifest.

    Parameters
    ----------
    url : str
        The store's folder.
    options : mapping, optional
        What the file system is opened with (credentials, endpoints).
    """

    # --- scenes --------------------------------------------------------------------------------------------------

    def read_record(self, key: str) -> Record | None:
        """Return the record of a scene, or None if it has none that is whole."""
        data = self.read_json(f"{key}/{RECORD}")
        try:
            return None if data is None else Record.from_json(data)
        except (KeyError, TypeError, ValueError):
            return None

    def is_intact(self, key: str, record: Record, *, checksums: bool) -> bool:
        """Tell whether a scene's files are as its record says."""
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
        """Store a result: the old record goes first, the new one comes last.

        Raises
        ------
        DataError
            If the result is of a type that cannot be stored.
        SupersededError
            If another run has taken the store over.
        """
        parts = split_parts(result)
        if not self.is_held(token):
            raise SupersededError(f"{self.url}: another run has taken this store over")
        self.remove(f"{key}/{RECORD}")
        self.remove(key)
        written = []
        for name, (kind, value) in parts.items():
            with self.writing(f"{key}/{name}.{EXTENSIONS[kind]}") as target:
                stream = HashingStream(target)
                write_part(kind, value, stream)
            written.append(Part(name, kind, stream.size, stream.digest.hexdigest()))
        record = Record(task, tuple(written))
        self.write_json(f"{key}/{RECORD}", record.to_json())
        return record

    def load(self, key: str, *, fingerprint: str, part: str | None = None, mapped: bool = False) -> Any:
        """Read a result, or one part of it.

        Raises
        ------
        ReadError
            If the result is not there, has been replaced by another one since, or cannot be read.
        """
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

    # --- the store as a whole --------------------------------------------------------------------------------------

    def check_ours(self) -> None:
        """Refuse a folder that holds something else, since a store removes what it does not know.

        Raises
        ------
        DataError
            If there are files but no manifest.
        """
        if self.read_json(MANIFEST) is None:
            foreign = sorted(p for p in self.listing() if p != ".gitkeep" and not p.endswith(".tmp"))
            if foreign:
                raise DataError(f"{self.url} is not a scene store but holds {len(foreign)} files, such as {foreign[0]}")

    def begin(self) -> str:
        """Take the store over for a run and return its token; until `finish` the store does not exist."""
        token = uuid.uuid4().hex
        self.write_json(MANIFEST, {"format": FORMAT, "run": token})
        return token

    def is_held(self, token: str) -> bool:
        """Tell whether the run of this token has the store."""
        manifest = self.read_json(MANIFEST)
        return manifest is not None and manifest.get("run") == token

    def release(self, token: str) -> None:
        """End a run that did not finish, so that nothing of it is stored any more."""
        if self.is_held(token):
            self.remove(SHARED)
            self.write_json(MANIFEST, {"format": FORMAT, "run": None})

    def finish(self, records: Mapping[str, Record], *, token: str) -> None:
        """Remove what belongs to no scene of this run, and write the manifest.

        Raises
        ------
        SupersededError
            If another run has taken the store over.
        """
        if not self.is_held(token):
            raise SupersededError(f"{self.url}: another run has taken this store over")
        self._remove_strangers(records)
        scenes = {key: records[key].to_json() for key in sorted(records)}
        self.write_json(MANIFEST, {"format": FORMAT, "scenes": scenes})

    def _remove_strangers(self, keys: Collection[str]) -> None:
        filesystem, root = self.opened()
        filesystem.invalidate_cache()
        names = {PurePosixPath(path).name for path in filesystem.ls(root, detail=False)}  # empty folders too
        for name in sorted(names - set(keys) - {MANIFEST, ".gitkeep"}):
            self.remove(name)

    def clean(self) -> None:
        """Remove temporary files and shared values that a killed run left."""
        self.remove(SHARED)
        for path in self.listing():
            name = PurePosixPath(path).name
            if name.startswith(".") and name.endswith(".tmp"):
                self.remove(path)

    def read_manifest(self) -> dict[str, Record] | None:
        """Return the records of all scenes, or None if the store is not complete."""
        manifest = self.read_json(MANIFEST)
        try:
            scenes = None if manifest is None else manifest.get("scenes")
            return None if scenes is None else {key: Record.from_json(data) for key, data in scenes.items()}
        except (AttributeError, KeyError, TypeError, ValueError):
            return None

    def is_complete(self) -> bool:
        """Tell whether a manifest lists all scenes and all their files are there in their size."""
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
