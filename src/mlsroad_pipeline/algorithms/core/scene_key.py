"""Keys of scenes, passes, files and ranges of rows in the stores."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, TypeVar

T = TypeVar("T")

TRAIN = "train"
"""Split that methods are trained on; all others are scored."""


class SceneKey(NamedTuple):
    """Key in a store: ``split.pass`` and ``split.file``; ``split.pass.scene`` and ``split.file.first_row``.

    No part holds a dot. Where files are not cut together, a pass is one file and has the file's key.
    """

    split: str  # Name of the split; ``survey`` in `label`
    source: str = ""  # Name of the pass or file within the split
    part: str = ""  # Name of the scene on its pass, or first row of the range in its file

    @classmethod
    def parse(cls, key: str) -> SceneKey:
        """Parse a stored key."""
        return cls(*key.split(".", maxsplit=2))

    def __str__(self) -> str:
        """Return the stored key."""
        return ".".join(part for part in self if part)

    @property
    def parent(self) -> str:
        """Key of the pass that a scene is on, or of the file that holds a range of rows."""
        return str(self._replace(part=""))


def group_by_split(results: Mapping[str, T]) -> dict[str, list[T]]:
    """Return the results of each split, in the order of their keys."""
    groups: dict[str, list[T]] = {}
    for key, result in results.items():
        groups.setdefault(SceneKey.parse(key).split, []).append(result)
    return groups
