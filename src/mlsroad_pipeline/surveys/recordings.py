"""Labelled recordings: their scenes with training and test parts, and those that a model is trained on."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.labelled_recording import LabelledRecording
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.scenes import parts
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.kitti import read_labels
from mlsroad_pipeline.formats.registry import get_format

WITHHELD = "withheld"
KEPT = ("intensity", "label")
"""Columns that labellers may use, and the reference."""


def files_by_name(root: Path, pattern: str) -> dict[str, Path]:
    """Return the files that a pattern names below a folder, sorted, by their names up to the first dot."""
    found: dict[str, Path] = {}
    for path in sorted(root.glob(pattern)):
        name = path.name.partition(".")[0]
        if name in found:
            raise ReadError(f"{found[name]} and {path} have the same name: {pattern} may name one of each")
        found[name] = path
    return found


def read_points(path: Path, labels: Path | None, coding: Coding, read: Mapping[str, Any]) -> PointCloud:
    """Read a file of a recording; `label` has taxonomy codes."""
    cloud = get_format(path).read(path, ReadOptions.from_config({**read, "coding": coding}))
    if labels is not None:
        codes = read_labels(labels, len(cloud), path)
        cloud = cloud.with_columns(label=coding.encode(codes, source=str(labels)))
    if WITHHELD in cloud:
        cloud = cloud.select(np.flatnonzero(cloud[WITHHELD] == 0))
    return cloud.without_columns(set(cloud.columns) - set(KEPT))


def read_scene(
    path: str,
    labels: str | None,
    test_blocks: Sequence[str],
    *,
    coding: Coding,
    read: Mapping[str, Any],
    plane: parts.HalfPlane | None,
    pose: parts.Pose | None,
    is_test: bool,
    gap: float,
) -> PointCloud:
    """Read a scene of a recording; the column `part` divides it (`TRAIN`, `TEST`, `NEITHER`).

    A plane divides a scan. Without one, the whole block belongs to the test part or not; a point of a training block
    within the gap of a point of a test block belongs to neither part.
    """
    cloud = read_points(Path(path), None if labels is None else Path(labels), coding, read)
    world = cloud.world_xyz()
    if plane is not None:
        xy = world[:, :2] if pose is None else pose.placed(world[:, :2])
        return cloud.with_columns(part=parts.parts_beyond(plane.distance(xy), gap))
    part = np.full(len(cloud), parts.TEST if is_test else parts.TRAIN, np.uint8)
    for block in test_blocks:
        part[parts.within_distance(world, read_points(Path(block), None, coding, read).world_xyz(), gap)] = (
            parts.NEITHER
        )
    return cloud.with_columns(part=part)


def read_training_scene(path: str, *, coding: Coding, read: Mapping[str, Any]) -> PointCloud:
    """Read a scene of a recording with all its labels."""
    return read_points(Path(path), None, coding, read)


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
