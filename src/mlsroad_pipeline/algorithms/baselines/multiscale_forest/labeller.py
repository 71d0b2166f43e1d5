"""Labels of points by a trained multiscale forest."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines.multiscale_forest.parameters import SLUG, MultiscaleForestParameters
from mlsroad_pipeline.algorithms.core.labels import PointLabels, unlabelled
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.features.intensity_ranks import known_intensity, rank_within
from mlsroad_pipeline.algorithms.features.sphere_features import ATTRIBUTES, SpherePyramid, find_spheres
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.flat_forest import FlatForest
from mlsroad_pipeline.algorithms.stages import inliers

COLUMNS_OF = {"intensity": ATTRIBUTES[:1], "rgb": ATTRIBUTES[1:]}
"""Column of a scene to the attributes of the neighbourhoods."""
_BLOCK = 65536
"""Voxels described together; bounds the memory."""


def spheres_of(
    scene: PointCloud, parameters: MultiscaleForestParameters, *, columns: Collection[str] = tuple(COLUMNS_OF)
) -> SpherePyramid:
    """Subsample the inliers of a scene for each scale.

    Parameters
    ----------
    scene : PointCloud
        The scene, with at least one point that is no outlier. An intensity or colour that is constant counts as
        missing, and so does an intensity that is NaN everywhere; single NaN are replaced by the median.
    parameters : MultiscaleForestParameters
        Parameters of the method.
    columns : collection of str
        Those of ``"rgb"`` and ``"intensity"`` to use where the scene has them; both by default.

    Returns
    -------
    SpherePyramid
        The subsampled clouds. Intensities are ranks within the scene, colours in [0, 1].

    Raises
    ------
    DataError
        If a coordinate is not finite.
    """
    keep = inliers(scene)
    attributes: dict[str, NDArray[np.float64]] = {}
    for name in columns:
        if name not in scene:
            continue
        values = known_intensity(scene[name][keep]) if name == "intensity" else scene[name][keep]
        if values is None or (values == values[0]).all():
            continue
        table = rank_within(values)[:, None] if name == "intensity" else values / 255.0
        attributes |= dict(zip(COLUMNS_OF[name], table.T, strict=True))
    return find_spheres(scene.xyz[keep], attributes, **parameters.spheres())


def label_scene(scene: PointCloud, bundle: ModelBundle) -> PointLabels:
    """Label the points of a scene.

    Parameters
    ----------
    scene : PointCloud
        The scene; intensity and colour are used if it has them and the model was trained with them.
    bundle : ModelBundle
        A model of `training.fit`.

    Returns
    -------
    PointLabels
        Class and probability of each point, those of its voxel; outliers have no class.

    Raises
    ------
    DataError
        If a coordinate is not finite.
    """
    label, confidence = unlabelled(len(scene))
    keep = inliers(scene)
    if keep.any():
        parameters = MultiscaleForestParameters(**bundle.metadata["parameters"][SLUG])
        pyramid = spheres_of(scene, parameters, columns=bundle.metadata["attributes"])
        best, probability = _classify(pyramid, bundle)
        label[keep], confidence[keep] = best[pyramid.owner], probability[pyramid.owner]
    return {"label": label, "confidence": confidence}


def _classify(pyramid: SpherePyramid, bundle: ModelBundle) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Return class and probability of each voxel."""
    if SLUG not in bundle.prepared:
        bundle.prepared[SLUG] = FlatForest.from_arrays(bundle.arrays)
    forest: FlatForest = bundle.prepared[SLUG]
    columns, classes = bundle.arrays["columns"], bundle.arrays["trained_classes"]
    best, probability = np.empty(len(pyramid), np.int16), np.empty(len(pyramid), np.float32)
    for first in range(0, len(pyramid), _BLOCK):
        voxels = np.arange(first, min(first + _BLOCK, len(pyramid)))
        probabilities = forest.predict_proba(pyramid.describe(voxels)[:, columns])
        best[voxels] = classes[probabilities.argmax(axis=1)]
        probability[voxels] = probabilities.max(axis=1)
    return best, probability


def label_cloud(cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Label the points of a cloud.

    Parameters
    ----------
    cloud : PointCloud
        Points; intensity and colour are used where there are any.
    bundle : ModelBundle
        A model of `training.fit`.

    Returns
    -------
    labels : ndarray of int16, shape (n,)
        Classes of the model's scheme; -1 for outliers.
    confidence : ndarray of float32, shape (n,)
        Probability of the class; 0 for outliers.

    Raises
    ------
    DataError
        If a coordinate is NaN or infinite.
    """
    labels = label_scene(cloud, bundle)
    return labels["label"], labels["confidence"]
