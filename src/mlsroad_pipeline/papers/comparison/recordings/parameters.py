"""Parameters of the benchmark of recordings: files, classes, scanner, licence and test part of each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.core.labelled_recording import LabelledRecording
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive
from mlsroad_pipeline.algorithms.scenes.parts import HalfPlane, Pose

SHIPPED, SIMULATED, OTHERS, OWN, BOTH = "shipped", "simulated", "others", "own", "own_and_simulated"
PROTOCOLS = (SHIPPED, SIMULATED, OTHERS, OWN, BOTH)
"""Training data of a run: those of a model of the package; simulated streets; these and all other recordings; the
recording's own training part; this and simulated streets."""


@dataclass(frozen=True)
class StudyParameters:
    """Parameters of the benchmark of recordings."""

    root: str  # Folder of the recordings
    sources: Mapping[str, Mapping[str, Any]]  # Name of each recording to the fields of `Source`
    # Name of each simulated street to its configuration, as in ``simulation.surveys``; with ``scan_spacing`` it gives
    # single scans
    streets: Mapping[str, Mapping[str, Any]]
    street_weight: float  # Weight of all simulated streets together, for methods that weigh sources; a recording has 1
    scheme: str  # Class scheme of training and scoring. Its class ``other`` is counted, but no part of means.
    # Models of the package to score. ``pool`` has the other protocols too: with trees of the protocol and the network
    # of the package.
    models: Sequence[str]
    seen: Sequence[str]  # Recordings that this network learned from; there ``pool`` has the protocol ``shipped`` alone
    method: str | None  # Method or model to run alone; None runs all labellers that need no images
    source: str | None  # Recording to score alone; None scores all
    # Protocol to run alone: ``shipped``, ``simulated``, ``others``, ``own`` or ``own_and_simulated``; None runs all
    protocol: str | None
    # Width of the strip between training part and test part, metres. It exceeds the least distance of the two, 5 m, by
    # the error of the poses.
    gap: float
    scenes_per_source: int  # Most scenes of a recording to train on, evenly spread; more take longer
    least_points: int  # Fewest points of a class in the scored part; rarer classes are no part of means
    pictured: Sequence[str]  # Runs that are drawn, as ``method.protocol``

    def __post_init__(self) -> None:
        for name in ("gap", "street_weight"):
            check_positive(getattr(self, name), f"recordings_study.{name}")
        for name in ("scenes_per_source", "least_points"):
            check_at_least(getattr(self, name), 1, f"recordings_study.{name}")
        if self.protocol not in (None, *PROTOCOLS):
            raise ParameterError(f"recordings_study.protocol {self.protocol!r} is none of {', '.join(PROTOCOLS)}")


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
