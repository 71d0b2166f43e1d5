"""Training of shape-based recognition: objects with their classes, and a random forest on their descriptors."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import RandomForestClassifier

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_results import Ground
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.machines.class_balance import majority_labels
from mlsroad_pipeline.algorithms.models.machines.flat_forest import FlatForest
from mlsroad_pipeline.papers.luo2016.shape_based.labeller import (
    SLUG,
    SceneObjects,
    ShapeParameters,
    build_objects,
)
from mlsroad_pipeline.papers.shared.patches.labelling import label_patches
from mlsroad_pipeline.papers.shared.patches.types import PatchStages, ScenePatches

logger = logging.getLogger(__name__)


class TrainingObjects(TypedDict):
    """Labelled objects of a training scene."""

    features: NDArray[np.float32]  # Features of each object
    label: NDArray[np.int16]  # Majority class of the object's labelled patches
    on_ground: NDArray[np.int64]  # Labelled patches of each class off the ground (row 0) and on it (row 1)


def training_objects(
    scene: PointCloud,
    ground: Ground,
    patches: ScenePatches,
    *,
    scheme: ClassScheme,
    parameters: ShapeParameters,
) -> TrainingObjects:
    """Return the labelled objects of a training scene."""
    objects = build_objects(ground, patches, parameters)
    return labelled_objects(objects, label_patches(scene, patches, scheme)["label"], len(scheme))


def labelled_objects(objects: SceneObjects, labels: NDArray[np.integer], n_classes: int) -> TrainingObjects:
    """Return the objects whose patches are labelled."""
    owner = objects["object_of_patch"]
    off = owner >= 0
    majority, _ = majority_labels(labels[off], owner[off], n_classes)
    known = majority != IGNORE
    counts = [np.bincount(labels[side & (labels != IGNORE)], minlength=n_classes) for side in (off, ~off)]
    return {"features": objects["features"][known], "label": majority[known], "on_ground": np.array(counts)}


def fit(
    scenes: Sequence[TrainingObjects],
    *,
    parameters: ShapeParameters,
    stages: PatchStages,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
) -> ModelBundle:
    """Train the classifier of objects; the weight of an object is the square root of its number of patches."""
    filled = [scene for scene in scenes if len(scene["label"])]
    if not filled:
        raise DataError("no labelled object in the training scenes: check their labels and the ground filter")
    features = np.concatenate([scene["features"] for scene in filled])
    labels = np.concatenate([scene["label"] for scene in filled])
    known = np.unique(labels)
    if len(known) < 2:
        raise DataError(f"all training objects are of {scheme.classes[known[0]]}: training needs at least two classes")
    forest = RandomForestClassifier(
        parameters.n_trees,
        min_samples_leaf=parameters.min_samples_leaf,
        class_weight="balanced_subsample",
        random_state=parameters.seed,
    ).fit(features, labels, sample_weight=np.exp(0.5 * features[:, 0]))  # square root of the number of patches
    missing = [name for number, name in enumerate(scheme.classes) if number not in known]
    if missing:
        logger.warning("%s: no training objects of %s: they are never predicted", SLUG, ", ".join(missing))
    above, below = np.sum([scene["on_ground"] for scene in filled], axis=0)
    off_ground = above >= below
    metadata = {
        "classes": list(scheme.classes),
        "classes_given": [scheme.classes[number] for number in known if off_ground[number]],
        "scheme": asdict(scheme),
        "parameters": {SLUG: asdict(parameters), **asdict(stages)},
        "attributes": ["rgb"] if parameters.appearance else [],
        "trained_on": {**trained_on, "objects": len(labels)},
    }
    arrays = FlatForest.from_trees(forest.estimators_).to_arrays()
    return ModelBundle(SLUG, {**arrays, "known": known.astype(np.int16)}, metadata)
