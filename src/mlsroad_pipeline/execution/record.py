"""What a scene store notes of each scene: the files of its result and the fingerprint of the task that gave it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.execution.digests import digest_json
from mlsroad_pipeline.execution.results import EXTENSIONS

FORMAT = 1
"""Version of the records and manifests."""


@dataclass(frozen=True)
class Part:
    """One file of a result.

    Parameters
    ----------
    name : str
        Name of the part; `result` where there is only one.
    kind : str
        A key of `scene_results.EXTENSIONS`, which says how it is stored.
    size : int
        Bytes.
    checksum : str
        Digest of its content, hexadecimal.
    """

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
    """What makes the files of a scene a result.

    Parameters
    ----------
    task : str
        Fingerprint of the task that gave it.
    parts : tuple of Part
        Its files.
    """

    task: str
    parts: tuple[Part, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the record as plain data."""
        return {"format": FORMAT, "task": self.task, "parts": [asdict(part) for part in self.parts]}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Record:
        """Return the record that `to_json` gave; a KeyError, TypeError or ValueError says that it is none."""
        if data["format"] != FORMAT:
            raise ValueError(f"record of format {data['format']}, not {FORMAT}")
        return cls(data["task"], tuple(Part(**part) for part in data["parts"]))

    def fingerprint(self, part: str | None = None) -> str:
        """Return the fingerprint of the stored content.

        Raises
        ------
        DataError
            If there is no such part.
        """
        chosen = [p for p in self.parts if part is None or p.name == part]
        if part is not None and not chosen:
            have = ", ".join(p.name for p in self.parts)
            raise DataError(f"no part {part!r} is stored (parts: {have})")
        return digest_json([[p.name, p.kind, p.checksum] for p in chosen])
