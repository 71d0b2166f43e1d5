"""Reference objects of the wanted classes, and segments without reference information."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.segmentation.stage import reference_objects


def wanted_objects(
    scene: PointCloud, scheme: ClassScheme, wanted: NDArray[np.int16]
) -> tuple[NDArray[np.int32], NDArray[np.int16]]:
    """Return the reference objects of a scene, with instances of several wanted classes split by class.

    A sign on a lamp may belong to the instance of the lamp while its points are labelled as a sign. The points of each
    further wanted class are then an object.
    """
    instances, classes = reference_objects(scene, scheme)
    labels = scheme.encode(scene["label"], source=scene.source)
    aside = np.flatnonzero((instances > 0) & (labels != classes[instances]) & np.isin(labels, wanted))
    pairs, numbers = np.unique(instances[aside].astype(np.int64) * len(scheme) + labels[aside], return_inverse=True)
    split = instances.copy()
    split[aside] = numbers + len(classes)
    return split, np.append(classes, (pairs % len(scheme)).astype(np.int16))


def without_reference(
    scene: PointCloud,
    segments: NDArray[np.integer],
    n_segments: int,
    *,
    scheme: ClassScheme,
    wanted: NDArray[np.int16],
) -> NDArray[np.bool_]:
    """Return which segments have no reference information and are excluded from training and scores."""
    labels = scheme.encode(scene["label"], source=scene.source)
    unknown = labels == IGNORE
    if "instance" in scene:
        unknown |= (scene["instance"] == 0) & np.isin(labels, wanted)
    inside = segments >= 0
    counts = np.bincount(segments[inside], minlength=n_segments)
    return np.asarray(2 * np.bincount(segments[inside & unknown], minlength=n_segments) > counts)
