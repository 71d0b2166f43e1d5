"""Description of a recording with labels: name, files, coding and licence."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError


@dataclass(frozen=True, kw_only=True)
class LabelledRecording:
    """Description of one recording, from a configuration."""

    section: ClassVar[str]
    """Section of the configuration that the recordings are in, for messages."""

    name: str  # Name in keys and tables
    title: str  # Name in reports, cards and messages
    files: str  # Pattern of its point files below the root; one file is one scene
    coding: str  # Name of the coding of its labels in ``classes.codings``
    licence: str  # Licence of the data
    read: Mapping[str, Any] = field(default_factory=dict)  # Further options of reading, see `ReadOptions`
    ignored: Sequence[int] = ()  # Codes of the coding that are ignored

    @classmethod
    def configured(cls, config: Mapping[str, Mapping[str, Any]]) -> dict[str, Self]:
        """Return the recordings of a configuration."""
        recordings = {}
        for name, fields in config.items():
            try:
                recordings[name] = cls(name=name, **fields)
            except TypeError as error:
                raise ParameterError(f"{cls.section}.{name}: {error}") from error
        return recordings

    def read_coding(self, codings: Mapping[str, Mapping[int, str]]) -> Coding:
        """Return the coding of the labels, with the ignored codes as unlabelled."""
        if self.coding not in codings:
            raise ParameterError(f"{self.section}.{self.name}: coding {self.coding!r} is not configured")
        names = {c: "unlabelled" if c in self.ignored else kind for c, kind in codings[self.coding].items()}
        return Coding(self.coding, names)
