"""Recordings that a model of the package is trained on: files, classes and licence. Users fetch them themselves."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.labelled_recording import LabelledRecording
from mlsroad_pipeline.surveys.recording_scenes import files_by_name


@dataclass(frozen=True, kw_only=True)
class TrainingRecording(LabelledRecording):
    """One recording; codes that are ignored are not trained on."""

    section = "shipped.recordings"

    sha256: str  # Digest of the files, see `digest`

    def paths(self, root: Path) -> dict[str, Path]:
        """Return the point files by their names up to the first dot."""
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


def described_recordings(config: Mapping[str, Mapping[str, Any]], keys: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return title, licence, digest and number of scenes of each recording, for the registry entry of a model."""
    of_scene = [key.partition(".")[0] for key in keys]
    return {
        name: {"title": r.title, "licence": r.licence, "scenes": of_scene.count(name), "sha256": r.sha256}
        for name, r in TrainingRecording.configured(config).items()
    }


def digest(paths: Sequence[Path]) -> str:
    """Return the SHA256 of the names and contents of files."""
    whole = hashlib.sha256()
    for path in sorted(paths, key=lambda p: p.name):
        with path.open("rb") as file:
            whole.update(f"{path.name} {hashlib.file_digest(file, 'sha256').hexdigest()}\n".encode())
    return whole.hexdigest()
