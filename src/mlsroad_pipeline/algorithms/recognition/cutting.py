"""Which objects are recognised: cut out of scenes, named by their points, drawn to learn from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.algorithms.recognition.object_set import ObjectSet
from mlsroad_pipeline.algorithms.segmentation.stage import Segments, owned_by_core


@dataclass(frozen=True)
class RecognitionParameters:
    """Which objects are recognised.

    Parameters
    ----------
    scheme : str, default "hdr9"
        Class scheme of the objects.
    min_points : int, default 30
        Smaller objects are left out.
    purity : float, default 0.8
        Share of an object's labelled points that must be of one class; mixed objects are left out of training and
        scores.
    max_per_class : int, default 2000
        Most training objects of a class.
    folds : str, optional
        Files below the survey's root that list files of objects, one list for each fold, as a glob; the class of an
        object is in its file's name. Each fold is recognised by what the others teach. None takes objects of scenes.
    seed : int, default 2019
        Seed of the draw of training objects.

    Raises
    ------
    ParameterError
        If a number is out of range.
    """

    scheme: str = "hdr9"
    min_points: int = 30
    purity: float = 0.8
    max_per_class: int = 2000
    folds: str | None = None
    seed: int = 2019

    def __post_init__(self) -> None:
        for name in ("min_points", "max_per_class"):
            check_at_least(getattr(self, name), 1, f"recognition.{name}")
        if not 0 < self.purity <= 1:
            raise ParameterError(f"recognition.purity must be above 0 and at most 1, got {self.purity!r}")


def objects_of_segments(cloud: PointCloud, segments: NDArray[np.int32]) -> ObjectSet:
    """Gather the points of each segment.

    Parameters
    ----------
    cloud : PointCloud
        Points; their intensity is kept where there is any.
    segments : ndarray of int32, shape (n,)
        Segment of each point, from 0; -1 for none.

    Returns
    -------
    ObjectSet
        One object per segment, of unknown class.
    """
    n = int(segments.max(initial=-1)) + 1
    rows = np.flatnonzero(segments >= 0)
    rows = rows[np.argsort(segments[rows], kind="stable")]
    bounds = np.searchsorted(segments[rows], np.arange(n + 1)).astype(np.int64)
    intensity = np.asarray(cloud["intensity"], dtype=np.float32)[rows] if "intensity" in cloud else None
    return ObjectSet(np.asarray(cloud.xyz, np.float64)[rows], bounds, np.full(n, IGNORE, np.int16), intensity)


def cut_objects(
    scene: PointCloud, objects: Segments, *, scheme: ClassScheme, parameters: RecognitionParameters
) -> dict[str, NDArray]:
    """Cut the objects out of a scene that it is responsible for, and name them by their points.

    Parameters
    ----------
    scene : PointCloud
        The scene; without labels all classes are unknown.
    objects : mapping
        What `segment_scene` gave.
    scheme : ClassScheme
        The classes.
    parameters : RecognitionParameters
        The smallest object, and how pure it must be.

    Returns
    -------
    dict of str to ndarray
        The arrays of an `ObjectSet`, and ``object`` int32: the number of each in the scene.
    """
    segments = objects["objects"]
    every = objects_of_segments(scene, segments)
    n = len(every)
    large = np.diff(every.indptr) >= parameters.min_points
    wanted = np.flatnonzero(large & owned_by_core(scene, segments, n))
    label = every.label
    if "label" in scene:
        table = np.zeros((n, len(scheme)), dtype=np.int64)
        truth = scheme.encode(scene["label"], source=scene.source)
        known = (segments >= 0) & (truth != IGNORE)
        np.add.at(table, (segments[known], truth[known]), 1)
        pure = table.max(axis=1, initial=0) >= parameters.purity * np.maximum(table.sum(axis=1), 1)
        label = np.where(pure, table.argmax(axis=1), IGNORE).astype(np.int16)
    named = ObjectSet(every.xyz, every.indptr, label, every.intensity)
    return {**named.take(wanted).to_arrays(), "object": wanted.astype(np.int32)}


def training_objects(sets: Sequence[Mapping[str, NDArray]], parameters: RecognitionParameters) -> ObjectSet:
    """Join sets and draw the objects to learn from.

    Parameters
    ----------
    sets : sequence of mapping
        Arrays of `ObjectSet`.
    parameters : RecognitionParameters
        The most objects of a class.

    Returns
    -------
    ObjectSet
        Objects of known class.

    Raises
    ------
    DataError
        If there are none.
    """
    joined = ObjectSet.join([ObjectSet.from_arrays(arrays) for arrays in sets])
    rng = np.random.default_rng(parameters.seed)
    drawn = [
        rng.permutation(np.flatnonzero(joined.label == label))[: parameters.max_per_class]
        for label in np.unique(joined.label[joined.label != IGNORE])
    ]
    if not drawn:
        raise DataError(f"none of the {len(joined)} training objects has a known class")
    return joined.take(np.sort(np.concatenate(drawn)))
