"""Labelled patches of the training scenes, and models of classifiers that were trained on them."""

import logging
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.core.validation import check_arrays
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.papers.shared.patches.extraction import PatchClassifier, PatchLabels, PatchStages, ScenePatches
from mlsroad_pipeline.papers.shared.patches.table import Patches, edges_between, join_patches

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class PatchTraining:
    """Labelled patches of all training scenes."""

    patches: Patches  # The labelled patches; `scene` numbers their scenes from 0
    edges: NDArray[np.int32]  # Pairs of adjacent patches of a scene, each pair once
    stages: PatchStages  # Parameters of the stages that prepared the scenes
    scheme: ClassScheme  # The classes
    trained_on: Mapping[str, Any]  # Description of the training data for the model's metadata; JSON values
    surveys: NDArray[np.int32] | None = None  # Survey of each scene, see `number_surveys`; None if unknown


def number_surveys(keys: Iterable[str]) -> NDArray[np.int32]:
    """Return the survey of each training scene; scenes of one file or one drive belong to one survey."""
    surveys = [SceneKey.parse(key).parent for key in sorted(keys)]
    return np.unique(surveys, return_inverse=True)[1].astype(np.int32)


def join_training_scenes(
    scenes: Mapping[str, ScenePatches], labels: Mapping[str, PatchLabels]
) -> tuple[Patches, NDArray[np.int32]]:
    """Join the labelled patches of all training scenes."""
    if not labels:
        raise DataError("no training scenes: the split 'train' is empty")
    parts, edges, shift = [], [], 0
    for number, key in enumerate(sorted(labels)):
        check_arrays(labels[key], ("label", "station"), f"the patch labels of scene {key} (label the patches again)")
        arrays, label = scenes[key], labels[key]["label"]
        rows = np.flatnonzero(label != IGNORE)
        edges.append(edges_between(arrays["edges"], label != IGNORE) + np.int32(shift))
        own = {"label": label, "station": labels[key]["station"], "scene": np.full(len(label), number)}
        whole = Patches.from_arrays({**arrays, **own})
        parts.append(whole.take(rows))
        shift += len(rows)
    if shift == 0:
        raise DataError("no patch of the training scenes is labelled with a class of the scheme")
    return join_patches(parts), np.concatenate(edges)


def bundle_model(
    slug: str,
    classifier: PatchClassifier,
    training: PatchTraining,
    *,
    parameters: Any,
    facts: Mapping[str, Any] | None = None,
) -> ModelBundle:
    """Pack a trained classifier as a model bundle."""
    patches, scheme = training.patches, training.scheme
    counts = np.bincount(patches.label[patches.label >= 0], minlength=len(scheme))
    missing = [name for name, count in zip(scheme.classes, counts, strict=True) if count == 0]
    if missing:
        logger.warning("%s: no training patches of %s: they are never predicted", slug, ", ".join(missing))
    metadata = {
        "classes": list(scheme.classes),
        "scheme": asdict(scheme),
        "parameters": {slug: _json_values(asdict(parameters)), **asdict(training.stages)},
        "attributes": [] if patches.rgb is None else ["rgb"],
        "trained_on": {**training.trained_on, "patches": len(patches)},
        **(facts or {}),
    }
    return ModelBundle(slug, classifier.to_arrays(), metadata)


def _json_values(values: Any) -> Any:
    """Return values with infinite numbers, which JSON lacks, as text."""
    if isinstance(values, Mapping):
        return {name: _json_values(value) for name, value in values.items()}
    return str(values) if isinstance(values, float) and not np.isfinite(values) else values
