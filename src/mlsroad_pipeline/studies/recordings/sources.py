"""Recordings of the benchmark: files, classes, scanner, licence and test part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.codings import Coding, configured_coding
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.scenes.parts import HalfPlane, Pose


@dataclass(frozen=True)
class Source:
    """One recording.

    Parameters
    ----------
    name : str
        Name in keys and tables.
    title : str
        Name in reports.
    files : str
        Pattern of its point files below the root; one file is one scene.
    coding : str
        Name of the coding of its labels in ``classes.codings``.
    classes : sequence of str
        Common classes that the recording has; only these are scored.
    scanner : str
        The scanner.
    licence : str
        Licence of the data.
    test : mapping
        Test part: ``azimuth`` and ``offset`` of a `HalfPlane`, or ``files``, patterns of the names of whole blocks.
    group : str, optional
        Recordings of one group are one source when a source is left out; the name by default.
    labels : str, optional
        Folder of SemanticKITTI labels relative to that of the point files; None where labels are found beside them.
    read : mapping
        Further options of reading, see `ReadOptions`.
    ignored : sequence of int
        Codes of the coding that are ignored.
    mixed : mapping of str to sequence of str
        A class of the recording to the common classes that it holds beside its own: predictions of these are right.
        Such points train no model of other recordings.
    poses : mapping of str to sequence of float
        Name of each file, without extension, to x, y (metres) and heading (degrees) of the scan in the frame of the
        drive; empty if the points are in one frame.

    Raises
    ------
    ParameterError
        If the test part has other keys or patterns.
    """

    name: str
    title: str
    files: str
    coding: str
    classes: Sequence[str]
    scanner: str
    licence: str
    test: Mapping[str, Any]
    group: str = ""
    labels: str | None = None
    read: Mapping[str, Any] = field(default_factory=dict)
    ignored: Sequence[int] = ()
    mixed: Mapping[str, Sequence[str]] = field(default_factory=dict)
    poses: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if set(self.test) not in ({"azimuth", "offset"}, {"files"}):
            raise ParameterError(
                f"recordings_study.sources.{self.name}.test must have azimuth and offset, or files, got "
                f"{sorted(self.test)}"
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
        """Return the point files by their names without extension.

        Parameters
        ----------
        root : Path
            Folder of all recordings.

        Returns
        -------
        dict of str to Path
            The files, sorted by name.

        Raises
        ------
        ReadError
            If there is none.
        """
        found = {path.name.partition(".")[0]: path for path in sorted(root.glob(self.files))}
        if not found:
            raise ReadError(
                f"{root} has no {self.files} ({self.title}): set recordings_study.root or MLSROAD_DATA to the folder "
                "of the recordings, or choose one with recordings_study.source"
            )
        return found

    def is_test_block(self, path: Path) -> bool:
        """Return whether a whole file belongs to the test part.

        Parameters
        ----------
        path : Path
            A point file.

        Returns
        -------
        bool
            False for every file of a recording that is divided by a plane.
        """
        return any(path.match(pattern) for pattern in self.test.get("files", ()))

    def pose(self, stem: str) -> Pose | None:
        """Return the pose of a file; None for a recording whose points are in one frame.

        Parameters
        ----------
        stem : str
            Name of the file without extension.

        Returns
        -------
        Pose or None
            The pose.

        Raises
        ------
        ParameterError
            If the recording has poses, but none for this file.
        """
        if not self.poses:
            return None
        if stem not in self.poses:
            raise ParameterError(f"recordings_study.sources.{self.name}.poses has no pose of {stem!r}")
        return Pose(*self.poses[stem])

    def read_coding(self, codings: Mapping[str, Mapping[int, str]]) -> Coding:
        """Return the coding of the labels, with the ignored codes as unlabelled.

        Parameters
        ----------
        codings : mapping of str to mapping
            The configured codings.

        Returns
        -------
        Coding
            The coding.

        Raises
        ------
        ParameterError
            If there is no such coding.
        """
        return configured_coding(
            codings, self.coding, ignored=self.ignored, where=f"recordings_study.sources.{self.name}"
        )


def sources_of(config: Mapping[str, Mapping[str, Any]]) -> dict[str, Source]:
    """Return the recordings of a configuration.

    Parameters
    ----------
    config : mapping of str to mapping
        Name to the fields of `Source`.

    Returns
    -------
    dict of str to Source
        The recordings.

    Raises
    ------
    ParameterError
        If there is none, or one lacks a field or has an unknown one.
    """
    if not config:
        raise ParameterError("recordings_study.sources is empty: run the benchmark with --env=recordings")
    sources = {}
    for name, fields in config.items():
        try:
            sources[name] = Source(name=name, **fields)
        except TypeError as error:
            raise ParameterError(f"recordings_study.sources.{name}: {error}") from error
    return sources
