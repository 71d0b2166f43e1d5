"""Recordings of the benchmark: files, classes, scanner, licence and test part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.core.labelled_recording import LabelledRecording
from mlsroad_pipeline.algorithms.scenes.parts import HalfPlane, Pose


@dataclass(frozen=True, kw_only=True)
class Source(LabelledRecording):
    """One recording."""

    section = "recordings_study.sources"

    classes: Sequence[str]  # Common classes that the recording has; only these are scored
    scanner: str  # The scanner
    # Test part: ``azimuth`` and ``offset`` of a `HalfPlane`, or ``files``, patterns of the names of whole blocks
    test: Mapping[str, Any]
    group: str = ""  # Recordings of one group are one source when a source is left out; the name by default
    # Folder of SemanticKITTI labels relative to that of the point files; None where labels are found beside them
    labels: str | None = None
    # A class of the recording to the common classes that it holds beside its own: predictions of these are right. Such
    # points train no model of other recordings.
    mixed: Mapping[str, Sequence[str]] = field(default_factory=dict)
    # Name of each file, without extension, to x, y (metres) and heading (degrees) of the scan in the frame of the
    # drive; empty if the points are in one frame
    poses: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if set(self.test) not in ({"azimuth", "offset"}, {"files"}):
            raise ParameterError(
                f"{self.section}.{self.name}.test must have azimuth and offset, or files, got {sorted(self.test)}"
            )

    @property
    def left_out(self) -> str:
        """Return the name of the group that is left out together."""
        return self.group or self.name

    @property
    def plane(self) -> HalfPlane | None:
        """Return the plane before the test part; None for a recording of whole blocks."""
        return HalfPlane(**self.test) if "azimuth" in self.test else None

    def paths(self, root: Path) -> dict[str, Path]:
        """Return the point files by their names up to the first dot."""
        found = {path.name.partition(".")[0]: path for path in sorted(root.glob(self.files))}
        if not found:
            raise ReadError(
                f"{root} has no {self.files} ({self.title}): set recordings_study.root or MLSROAD_DATA to the folder "
                "of the recordings, or choose one with recordings_study.source"
            )
        return found

    def is_test_block(self, path: Path) -> bool:
        """Return whether a whole file belongs to the test part."""
        return any(path.match(pattern) for pattern in self.test.get("files", ()))

    def pose(self, stem: str) -> Pose | None:
        """Return the pose of a file; None for a recording whose points are in one frame."""
        if not self.poses:
            return None
        if stem not in self.poses:
            raise ParameterError(f"{self.section}.{self.name}.poses has no pose of {stem!r}")
        return Pose(*self.poses[stem])


def sources_of(config: Mapping[str, Mapping[str, Any]]) -> dict[str, Source]:
    """Return the recordings of a configuration."""
    if not config:
        raise ParameterError("recordings_study.sources is empty: run the benchmark with --env=recordings")
    return Source.configured(config)
