"""Extraction of objects from scenes, and selection of training objects."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.algorithms.segmentation.stage import Segments, owned_by_core
from mlsroad_pipeline.papers.shared.recognition.object_set import ObjectArrays, ObjectSet


@dataclass(frozen=True)
class RecognitionParameters:
    """Selection of objects."""

    scheme: str = "hdr9"  # Class scheme of the objects
    min_points: int = 30  # Minimum number of points of an object
    # Minimum share of the labelled points of an object in one class; other objects are excluded from training and
    # scores
    purity: float = 0.8
    max_per_class: int = 2000  # Maximum number of training objects of a class
    # Glob pattern below the root of the survey; each match lists the object files of a fold, whose names contain the
    # class. Cross-validation over the folds. None takes the objects of scenes.
    folds: str | None = None
    seed: int = 2019  # Seed of the sample of training objects

    def __post_init__(self) -> None:
        for name in ("min_points", "max_per_class"):
            check_at_least(getattr(self, name), 1, f"recognition.{name}")
        if not 0 < self.purity <= 1:
            raise ParameterError(f"recognition.purity must be above 0 and at most 1, got {self.purity!r}")


class SceneObjectArrays(ObjectArrays):
    """Arrays of the objects of a scene."""

    object: NDArray[np.int32]  # Segment number of each object in the scene


def objects_of_segments(cloud: PointCloud, segments: NDArray[np.int32]) -> ObjectSet:
    """Return the points of each segment as objects."""
    n = int(segments.max(initial=-1)) + 1
    rows = np.flatnonzero(segments >= 0)
    rows = rows[np.argsort(segments[rows], kind="stable")]
    bounds = np.searchsorted(segments[rows], np.arange(n + 1)).astype(np.int64)
    intensity = np.asarray(cloud["intensity"], dtype=np.float32)[rows] if "intensity" in cloud else None
    return ObjectSet(np.asarray(cloud.xyz, np.float64)[rows], bounds, np.full(n, IGNORE, np.int16), intensity)


def cut_objects(
    scene: PointCloud, objects: Segments, *, scheme: ClassScheme, parameters: RecognitionParameters
) -> SceneObjectArrays:
    """Return the objects that a scene owns, with the majority class of their points."""
    segments = objects["objects"]
    every = objects_of_segments(scene, segments)
    n = len(every)
    large = np.diff(every.indptr) >= parameters.min_points
    chosen = np.flatnonzero(large & owned_by_core(scene, segments, n))
    label = every.label
    if "label" in scene:
        table = np.zeros((n, len(scheme)), dtype=np.int64)
        truth = scheme.encode(scene["label"], source=scene.source)
        known = (segments >= 0) & (truth != IGNORE)
        np.add.at(table, (segments[known], truth[known]), 1)
        pure = table.max(axis=1, initial=0) >= parameters.purity * np.maximum(table.sum(axis=1), 1)
        label = np.where(pure, table.argmax(axis=1), IGNORE).astype(np.int16)
    labelled = ObjectSet(every.xyz, every.indptr, label, every.intensity)
    return {**labelled.take(chosen).to_arrays(), "object": chosen.astype(np.int32)}


def training_objects(sets: Sequence[ObjectArrays], parameters: RecognitionParameters) -> ObjectSet:
    """Concatenate sets and sample the training objects."""
    joined = ObjectSet.join([ObjectSet.from_arrays(arrays) for arrays in sets])
    rng = np.random.default_rng(parameters.seed)
    drawn = [
        rng.permutation(np.flatnonzero(joined.label == label))[: parameters.max_per_class]
        for label in np.unique(joined.label[joined.label != IGNORE])
    ]
    if not drawn:
        raise DataError(f"none of the {len(joined)} training objects has a known class")
    return joined.take(np.sort(np.concatenate(drawn)))
