"""Recordings that a model of the package is trained on: files, classes and licence. Users fetch them themselves."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.codings import Coding, configured_coding
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.surveys.recording_scenes import files_by_name


@dataclass(frozen=True)
class TrainingRecording:
    """One recording.

    Parameters
    ----------
    name : str
        Name in keys.
    title : str
        Name in cards and messages.
    files : str
        Pattern of its point files below the root; one file is one scene.
    coding : str
        Name of the coding of its labels in ``classes.codings``.
    licence : str
        Licence of the data.
    sha256 : str
        Digest of the files, see `digest`.
    ignored : sequence of int
        Codes of the coding that are not trained on.
    read : mapping
        Further options of reading, see `ReadOptions`.
    """

    name: str
    title: str
    files: str
    coding: str
    licence: str
    sha256: str
    ignored: Sequence[int] = ()
    read: Mapping[str, Any] = field(default_factory=dict)

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
            If there is none, two have one name, or the files are others than those of the model.
        """
        found = files_by_name(root, self.files)
        if not found:
            raise ReadError(
                f"{root} has no {self.files}: put {self.title} there, or set MLSROAD_DATA to the folder that has it"
            )
        other = digest(list(found.values()))
        if other != self.sha256:
            raise ReadError(
                f"{root / self.files}: the files of {self.title} are not those of the model (SHA256 {other}, expected "
                f"{self.sha256})"
            )
        return found

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
        return configured_coding(codings, self.coding, ignored=self.ignored, where=f"shipped.recordings.{self.name}")


def training_recordings(config: Mapping[str, Mapping[str, Any]]) -> dict[str, TrainingRecording]:
    """Return the recordings of a configuration.

    Parameters
    ----------
    config : mapping of str to mapping
        Name to the fields of `TrainingRecording`.

    Returns
    -------
    dict of str to TrainingRecording
        The recordings.

    Raises
    ------
    ParameterError
        If one lacks a field or has an unknown one.
    """
    recordings = {}
    for name, fields in config.items():
        try:
            recordings[name] = TrainingRecording(name=name, **fields)
        except TypeError as error:
            raise ParameterError(f"shipped.recordings.{name}: {error}") from error
    return recordings


def described_recordings(config: Mapping[str, Mapping[str, Any]], keys: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return title, licence, digest and number of scenes of each recording, for the registry entry of a model.

    Parameters
    ----------
    config : mapping of str to mapping
        Name to the fields of `TrainingRecording`.
    keys : iterable of str
        Keys of the scenes, each with the name of its recording before the first dot.

    Returns
    -------
    dict of str to dict
        The facts by name.
    """
    of_scene = [key.partition(".")[0] for key in keys]
    return {
        name: {"title": r.title, "licence": r.licence, "scenes": of_scene.count(name), "sha256": r.sha256}
        for name, r in training_recordings(config).items()
    }


def digest(paths: Sequence[Path]) -> str:
    """Return the SHA256 of the names and contents of files.

    Parameters
    ----------
    paths : sequence of Path
        The files, in any order.

    Returns
    -------
    str
        Hexadecimal digest.
    """
    whole = hashlib.sha256()
    for path in sorted(paths, key=lambda p: p.name):
        with path.open("rb") as file:
            whole.update(f"{path.name} {hashlib.file_digest(file, 'sha256').hexdigest()}\n".encode())
    return whole.hexdigest()
