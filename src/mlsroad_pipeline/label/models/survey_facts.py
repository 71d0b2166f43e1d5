"""Facts of a survey, and their comparison with the training data of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.quality.scene_facts import median_facts, scene_facts, unusual_facts
from mlsroad_pipeline.algorithms.scenes.joining import join_pieces
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters, OutlierParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.surveys.plan import SurveyPlan
from mlsroad_pipeline.surveys.scene_plan import plan_drive

N_SCENES = 3
"""Number of scenes of the sample."""


def facts_of_pieces(plan: SurveyPlan, pieces: SceneCollection, ingest: IngestParameters) -> dict[str, float]:
    """Return the medians of the facts of scenes at equal steps, of a survey that has been read and cut."""
    points, bins = pieces.part("points", mapped=True), pieces.load_all("bins")
    scenes = [scene for drive in plan.drives() for scene in plan_drive(drive, plan, bins, ingest)]
    n = min(N_SCENES, len(scenes))
    chosen = [scenes[(2 * k + 1) * len(scenes) // (2 * n)] for k in range(n)]
    unfiltered = OutlierParameters(enabled=False)
    return median_facts(
        [
            scene_facts(
                join_pieces([_needed(points[key].load()) for key in scene.pieces], scene.span, unfiltered, scene.source)
            )
            for scene in chosen
        ]
    )


def _needed(piece: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Return a stored piece without the columns that no fact depends on."""
    kept = {f"column.{name}" for name in ("file", "row", "intensity")}
    return {name: piece[name] for name in piece if name in kept or not name.startswith("column.")}


def unusual_properties(bundle: ModelBundle, facts: Mapping[str, float]) -> list[str]:
    """Return one sentence per property of a survey that is outside the range of the training data of a model."""
    try:
        return unusual_facts(facts, bundle.metadata.get("training_facts", {}))
    except DataError as error:
        raise DataError(f"the model of {bundle.slug} is damaged: {error}") from error


def unusual_warnings(properties: Sequence[str]) -> list[str]:
    """Return a warning for each unusual property."""
    return [f"The survey differs from the training data: {sentence}." for sentence in properties]
