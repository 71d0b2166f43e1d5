"""Warnings about the results of `label`, and about surveys that differ from the training data of a model."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.kerb_lines import ground_classes
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.familiarity import KINDS
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.algorithms.quality.scene_facts import median_facts, scene_facts, unusual_facts
from mlsroad_pipeline.algorithms.scenes.joining import join_pieces
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters, OutlierParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.label.confidence import confidence_table, confidence_warnings, ground_warnings
from mlsroad_pipeline.label.given_classes import given_counts, given_warnings
from mlsroad_pipeline.label.images import effect_without_images
from mlsroad_pipeline.label.scene import MOST_BELOW, LabelCounts
from mlsroad_pipeline.label.summary import summed_counts
from mlsroad_pipeline.label.written_file import WrittenFile
from mlsroad_pipeline.surveys.plan import SurveyPlan, plan_pass


def label_warnings(
    bundle: ModelBundle, counts: Mapping[str, LabelCounts], written: Mapping[str, WrittenFile]
) -> list[str]:
    """Return the warnings about the labels and the images."""
    scheme, confidences = bundle_scheme(bundle), summed_counts(written)["confidences"]
    no_ground = ground_warnings(confidences, ground_classes(scheme))
    return [
        *confidence_warnings(confidence_table(confidences, scheme.classes)),
        *no_ground,
        *unfamiliar_warnings(counts, explained=bool(no_ground)),
        *image_warnings(bundle, counts),
        *given_warnings(given_counts(counts.values())),
        *below_warnings(counts),
    ]


def unfamiliar_warnings(counts: Mapping[str, LabelCounts], *, explained: bool = False) -> list[str]:
    """Return a warning for scenes unlike the training data, with likely reasons unless another warning has one."""
    known = [scene for scene in counts.values() if "kinds" in scene]
    points = np.array([scene["counts"].sum() for scene in known], np.float64)
    strange = np.array([scene["kinds"][0] < _STRANGE for scene in known])
    if not points.sum() or points[strange].sum() < _LEAST_STRANGE * points.sum():
        return []
    reasons = points[strange] @ np.array([scene["kinds"] for scene in known])[strange]
    names = list(KINDS)
    likely = [k for k in np.argsort(-reasons[1:])[:_REASONS] + 1 if reasons[k] > reasons[1:].sum() / 4]
    return [
        f"{points[strange].sum() / points.sum():.0%} of the points lie in scenes unlike the training data: "
        "confidences are lowered there, and labels may be wrong."
        + ("" if explained else f" Most probable: {'; or '.join(KINDS[names[k]] for k in likely)}.")
    ]


def below_warnings(counts: Mapping[str, LabelCounts]) -> list[str]:
    """Return a warning for points of objects below the ground, from as many on as an object has."""
    n = sum(int(scene["below"][0]) for scene in counts.values() if "below" in scene)
    if n < _LEAST_BELOW:
        return []
    return [
        f"{n:,} points of classes of objects lie more than {MOST_BELOW:g} m below the ground, such as reflections of a "
        "wet road: they belong to no object."
    ]


def doubt_warnings(doubts: pd.DataFrame) -> list[str]:
    """Return a warning of the doubtful clusters, with their numbers by reason, most points first."""
    if doubts.empty:
        return []
    grouped = doubts.groupby("reason", sort=False)["points"].agg(["size", "sum"]).sort_values("sum", ascending=False)
    n = len(doubts)
    return [
        f"{n} {'cluster' if n == 1 else 'clusters'} with {doubts['points'].sum():,} points may have a wrong class: "
        + "; ".join(f"{reason} ({number})" for reason, number in grouped["size"].items())
        + ". The report lists them under Places to check, and mlsroad open shows them first (J)."
    ]


def image_warnings(bundle: ModelBundle, counts: Mapping[str, LabelCounts]) -> list[str]:
    """Return a warning for passes without images, for methods that use images."""
    without = list(dict.fromkeys(SceneKey.parse(key).parent for key, scene in counts.items() if "seen" not in scene))
    if not needs_images(bundle.slug) or not without:
        return []
    return [f"There are no images for {', '.join(without)}: {effect_without_images(bundle)}."]


_LEAST_BELOW = 50  # points, that the rules need for a vehicle
_STRANGE, _LEAST_STRANGE, _REASONS = 0.3, 0.2, 2
"""Probability of a familiar scene below which it is strange, share of points in such scenes at which a warning is
given, and most reasons that it names."""

N_SCENES = 3
"""Number of scenes of the sample."""


def facts_of_pieces(plan: SurveyPlan, pieces: SceneCollection, ingest: IngestParameters) -> dict[str, float]:
    """Return the medians of the facts of some scenes of a survey that has been read and cut."""
    points, bins = pieces.part("points", mapped=True), pieces.load_all("bins")
    scenes = [scene for pass_key in plan.passes() for scene in plan_pass(pass_key, plan, bins, ingest)]
    chosen = [scenes[k] for k in spread_scenes([scene.span.n_core for scene in scenes], N_SCENES)]
    unfiltered = OutlierParameters(enabled=False)
    return median_facts(
        [
            scene_facts(
                join_pieces([_needed(points[key].load()) for key in scene.pieces], scene.span, unfiltered, scene.source)
            )
            for scene in chosen
        ]
    )


def spread_scenes(counts: Sequence[int], n: int) -> NDArray[np.int64]:
    """Return the scenes at `n` equal steps of the points, so that scenes with few points far away do not count."""
    ends = np.cumsum(counts)
    return np.unique(np.searchsorted(ends, np.arange(1, 2 * n, 2) * ends.max(initial=0) / (2 * n)))[: len(ends)]


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
