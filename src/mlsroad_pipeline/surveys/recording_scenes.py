"""Scenes of labelled recordings with their training and test parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.scenes.parts import (
    NEITHER,
    TEST,
    TRAIN,
    HalfPlane,
    Pose,
    parts_beyond,
    within_distance,
)
from mlsroad_pipeline.formats.kitti import read_labels
from mlsroad_pipeline.formats.options import ReadOptions
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
    plane: HalfPlane | None,
    pose: Pose | None,
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
        return cloud.with_columns(part=parts_beyond(plane.distance(xy), gap))
    part = np.full(len(cloud), TEST if is_test else TRAIN, np.uint8)
    for block in test_blocks:
        part[within_distance(world, read_points(Path(block), None, coding, read).world_xyz(), gap)] = NEITHER
    return cloud.with_columns(part=part)


def read_training_scene(path: str, *, coding: Coding, read: Mapping[str, Any]) -> PointCloud:
    """Read a scene of a recording with all its labels."""
    return read_points(Path(path), None, coding, read)
