"""What detections are compared with: the reference objects of the wanted classes, and where nothing is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.segmentation.stage import reference_objects


def wanted_objects(
    scene: PointCloud, scheme: ClassScheme, wanted: NDArray[np.int16]
) -> tuple[NDArray[np.int32], NDArray[np.int16]]:
    """Return the reference objects of `reference_objects`, with what hangs on others as objects of its own.

    A sign on a lamp may be part of the lamp to whoever numbered the instances, and is a sign to whoever labelled the
    points: where an instance holds points of several wanted classes it is as many objects.

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
        Number of the object, from 1; 0 for none. What is parted off has numbers above all others.
    classes : ndarray of int16, shape (number of objects + 1,)
        Class of most of each object's points; -1 for number 0 and where none is labelled.

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
    parted = instances.copy()
    parted[aside] = numbers + len(classes)
    return parted, np.append(classes, (pairs % len(scheme)).astype(np.int16))


def without_reference(
    scene: PointCloud,
    segments: NDArray[np.integer],
    n_segments: int,
    *,
    scheme: ClassScheme,
    wanted: NDArray[np.int16],
) -> NDArray[np.bool_]:
    """Tell which segments lie where the reference says nothing: they are neither learned from nor scored.

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
        True where more than half of a segment's points have a label that the scheme ignores, or, in a survey with
        instances, that of a wanted class without being part of an instance: whoever made the reference saw such an
        object there and left it out.
    """
    labels = scheme.encode(scene["label"], source=scene.source)
    silent = labels == IGNORE
    if "instance" in scene:
        silent |= (scene["instance"] == 0) & np.isin(labels, wanted)
    inside = segments >= 0
    counts = np.bincount(segments[inside], minlength=n_segments)
    return np.asarray(2 * np.bincount(segments[inside & silent], minlength=n_segments) > counts)
