"""The scenes of a store, as handles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.execution.digests import digest_json
from mlsroad_pipeline.execution.record import Record
from mlsroad_pipeline.execution.storage import SceneStorage
from mlsroad_pipeline.execution.task import StoredResult


class SceneCollection(Mapping[str, StoredResult]):
    """The scenes of a store in the order of their names, as handles; nothing is read before it is asked for.

    Parameters
    ----------
    storage : SceneStorage
        Where the store lies.
    records : mapping of str to Record
        Scene to record, from the manifest.
    part : str, optional
        The part of each result that the handles mean; None is the whole.
    mapped : bool, default False
        Whether the handles map arrays into memory instead of reading them.
    """

    def __init__(
        self, storage: SceneStorage, records: Mapping[str, Record], part: str | None = None, *, mapped: bool = False
    ) -> None:
        self._storage = storage
        self._records = {key: records[key] for key in sorted(records)}
        self._part = part
        self._mapped = mapped

    def __getitem__(self, key: str) -> StoredResult:
        """Return the handle of a scene; a KeyError names the store and the scene."""
        if key not in self._records:
            raise KeyError(f"{self._storage.url} has no scene {key!r}")
        fingerprint = self._records[key].fingerprint(self._part)
        return StoredResult(self._storage.url, key, fingerprint, self._part, self._storage.options, self._mapped)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the scenes' names."""
        return iter(self._records)

    def __len__(self) -> int:
        """Return the number of scenes."""
        return len(self._records)

    def __repr__(self) -> str:
        """Return the store, the part and the number of scenes."""
        part = "" if self._part is None else f", part {self._part!r}"
        return f"SceneCollection({self._storage.url!r}{part}, {len(self)} scenes)"

    @property
    def fingerprint(self) -> str:
        """Digest of the content of all scenes."""
        return digest_json([[key, record.fingerprint(self._part)] for key, record in self._records.items()])

    def part(self, name: str, *, mapped: bool = False) -> SceneCollection:
        """Return the same scenes with handles of one part of their results, so that a worker reads no more than it.

        Raises
        ------
        DataError
            If a scene has no such part.
        """
        for key, record in self._records.items():
            if name not in {p.name for p in record.parts}:
                have = ", ".join(p.name for p in record.parts)
                raise DataError(f"{self._storage.url}: scene {key!r} has no part {name!r} (parts: {have})")
        return SceneCollection(self._storage, self._records, name, mapped=mapped)

    def load_all(self, part: str | None = None) -> dict[str, Any]:
        """Read all scenes, or one part of each, into memory: for small things such as tables of figures.

        Raises
        ------
        DataError
            If a scene has no such part.
        ReadError
            If a result cannot be read.
        """
        chosen = self if part is None else self.part(part)
        return {key: handle.load() for key, handle in chosen.items()}
