"""Scenes of a store as handles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.execution.digests import digest_json
from mlsroad_pipeline.execution.store import Record, SceneStore
from mlsroad_pipeline.execution.task import StoredResult


class SceneCollection(Mapping[str, StoredResult]):
    """Scene keys, sorted, to handles of their results; results are read only on request."""

    def __init__(
        self, store: SceneStore, records: Mapping[str, Record], part: str | None = None, *, mapped: bool = False
    ) -> None:
        self._store = store
        self._records = {key: records[key] for key in sorted(records)}
        self._part = part
        self._mapped = mapped

    def __getitem__(self, key: str) -> StoredResult:
        """Return the handle of a scene; a KeyError names the store and the scene."""
        if key not in self._records:
            raise KeyError(f"{self._store.url} has no scene {key!r}")
        fingerprint = self._records[key].fingerprint(self._part)
        return StoredResult(self._store.url, key, fingerprint, self._part, self._store.options, self._mapped)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the scene keys."""
        return iter(self._records)

    def __len__(self) -> int:
        """Return the number of scenes."""
        return len(self._records)

    def __repr__(self) -> str:
        """Return the store, the part and the number of scenes."""
        part = "" if self._part is None else f", part {self._part!r}"
        return f"SceneCollection({self._store.url!r}{part}, {len(self)} scenes)"

    @property
    def fingerprint(self) -> str:
        """Digest of the content of all scenes."""
        return digest_json([[key, record.fingerprint(self._part)] for key, record in self._records.items()])

    def part(self, name: str, *, mapped: bool = False) -> SceneCollection:
        """Return handles of one part of each result, so that workers read only this part."""
        for key, record in self._records.items():
            names = [part.name for part in record.parts]
            if name not in names:
                raise DataError(f"{self._store.url}: scene {key!r} has no part {name!r} (parts: {', '.join(names)})")
        return SceneCollection(self._store, self._records, name, mapped=mapped)

    def load_all(self, part: str | None = None) -> dict[str, Any]:
        """Read the results of all scenes, or one part of each, into memory: for small data such as tables."""
        chosen = self if part is None else self.part(part)
        return {key: handle.load() for key, handle in chosen.items()}
