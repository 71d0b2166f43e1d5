"""Files and passes that lie apart where they overlap: their offsets, and scenes with the moves that undo them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.inventory.objects.sightings import ROUTE, SECOND
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.algorithms.registration.network import Move
from mlsroad_pipeline.algorithms.scenes.binning import BinnedCloud
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import StoredResult
from mlsroad_pipeline.surveys.pass_offsets import Source, SurveyOffsets, survey_offsets
from mlsroad_pipeline.surveys.plan import SurveyPlan

NEEDED = ("xyz", "origin", "bins", "indptr", "crs", "source", f"column.{SECOND}", f"column.{ROUTE}")
"""Stored arrays of a piece that offsets depend on."""


@dataclass(frozen=True)
class PassMove:
    """Move of the points of a file from one second on and before another, or of a route."""

    file: int  # Number of the file in its pass
    first: float
    stop: float
    route: int | None
    move: Move


def offsets_of_pieces(plan: SurveyPlan, pieces: SceneCollection) -> SurveyOffsets:
    """Return the offsets between the files and passes of a survey that has been read and cut."""
    points = pieces.part("points", mapped=True)
    own: dict[str, list[StoredResult]] = {file.key: [] for file in plan.files}
    for key in points:
        own[SceneKey.parse(key).parent].append(points[key])
    return survey_offsets(
        [Source(file.source.name, file.pass_key, partial(_chunks, own[file.key])) for file in plan.files]
    )


def _chunks(stored: Sequence[StoredResult]) -> Iterable[PointCloud]:
    for result in stored:
        piece: Mapping[str, NDArray] = result.load()
        yield BinnedCloud.from_arrays({name: piece[name] for name in NEEDED if name in piece}).cloud


def moves_of_passes(plan: SurveyPlan, found: SurveyOffsets, bundle: ModelBundle) -> dict[str, tuple[PassMove, ...]]:
    """Return the moves that count, by the key of the pass in the plan."""
    moves: dict[str, tuple[PassMove, ...]] = {}
    for recording, move in zip(found.recordings, found.moves, strict=bool(found.moves)):
        if move.is_small:
            continue
        if needs_images(bundle.slug):
            raise ParameterError(
                f"label.align_passes: {recording.name} would be moved away from its images, which {bundle.slug} needs; "
                "choose a method without images (label.method)"
            )
        file = plan.files[recording.source]
        route = recording.starts[recording.visit] if recording.by_route else None
        moves[file.pass_key] = (*moves.get(file.pass_key, ()), PassMove(file.number, *recording.interval, route, move))
    return moves


def aligned(scene: PointCloud, moves: Sequence[PassMove]) -> PointCloud:
    """Return a scene with the moved points of some files and passes."""
    xyz = None
    for each in moves:
        own = scene["file"] == each.file
        if each.route is not None:
            own &= scene[ROUTE] == each.route
        elif SECOND in scene:
            own &= (scene[SECOND] >= each.first) & (scene[SECOND] < each.stop)
        if own.any():
            xyz = scene.xyz.astype(np.float64) if xyz is None else xyz
            xyz[own] = each.move.apply(xyz[own] + scene.origin) - scene.origin
    if xyz is None:
        return scene
    low = np.floor(xyz.min(axis=0))
    return replace(scene, xyz=(xyz - low).astype(scene.xyz.dtype), origin=scene.origin + low)
