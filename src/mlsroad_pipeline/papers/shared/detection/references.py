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

    Parameters
    ----------
    scene : PointCloud
        A scene with `label` and perhaps `instance`.
    scheme : ClassScheme
        The classes.
    wanted : ndarray of int16
        The labels of the wanted classes in it.

    Returns
    -------
    instances : ndarray of int32, shape (n,)
        Number of the object, from 1; 0 for none. Objects that were split off have the highest numbers.
    classes : ndarray of int16, shape (number of objects + 1,)
        Majority class of each object's points; -1 for number 0 and where no point is labelled.

    Raises
    ------
    MissingColumnError
        If the scene has no labels.
    UnknownClassError
        If a label is not in the scheme.
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
    """Return which segments have no reference information and are excluded from training and scores.

    Parameters
    ----------
    scene : PointCloud
        The scene, with `label`.
    segments : ndarray of int, shape (n,)
        Segment of each point, -1 for none.
    n_segments : int
        Number of segments.
    scheme : ClassScheme
        The classes.
    wanted : ndarray of int16
        The labels of the wanted classes in it.

    Returns
    -------
    ndarray of bool, shape (n_segments,)
        True where more than half of a segment's points have a label that the scheme ignores or, in a survey with
        instances, the label of a wanted class but no instance: such objects are in the scene but not in the reference.
    """
    labels = scheme.encode(scene["label"], source=scene.source)
    unknown = labels == IGNORE
    if "instance" in scene:
        unknown |= (scene["instance"] == 0) & np.isin(labels, wanted)
    inside = segments >= 0
    counts = np.bincount(segments[inside], minlength=n_segments)
    return np.asarray(2 * np.bincount(segments[inside & unknown], minlength=n_segments) > counts)
