"""The labeller of Tomic et al. 2019, section 2.1: from a cloud that it has never seen to a class for every point.

A model holds a forest for every combination of colour and intensity that the training scenes had, so that a survey
without colour is labelled by a forest that never saw any, and not by guesses in its place. `training` makes models;
this module uses them and imports no more than that takes.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.detrended_forest.labelling import label_points, smooth_probabilities
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under, missing_attributes
from mlsroad_pipeline.algorithms.models.flat_forest import FlatForest
from mlsroad_pipeline.algorithms.stages import (
    FeatureParameters,
    GroundParameters,
    SupervoxelParameters,
    build_supervoxels,
    describe_supervoxels,
    find_ground,
    inliers,
)

SLUG = "detrended_forest"
ENTRY_POINT = "mlsroad_pipeline.algorithms.detrended_forest.labeller:label_cloud"

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class StageParameters:
    """How a scene is prepared before the forest sees it; kept in the model, so that new surveys are prepared alike.

    Parameters
    ----------
    ground : GroundParameters
        The ground filter.
    supervoxels : SupervoxelParameters
        The partition.
    features : FeatureParameters
        The features.
    """

    ground: GroundParameters
    supervoxels: SupervoxelParameters
    features: FeatureParameters


def label_scene(
    scene: PointCloud, supervoxels: Mapping[str, Any], features: Mapping[str, NDArray], bundle: ModelBundle
) -> dict[str, NDArray]:
    """Give every point of a prepared scene a class and a confidence.

    Parameters
    ----------
    scene : PointCloud
        The scene.
    supervoxels : mapping
        What `build_supervoxels` gave.
    features : mapping
        What `describe_supervoxels` gave.
    bundle : ModelBundle
        A model of `fit`.

    Returns
    -------
    dict of str to ndarray
        ``label`` int16 (n,), -1 for outliers, and ``confidence`` float32 (n,), the probability of the label, 0 for
        outliers.

    Raises
    ------
    DataError
        If the scene lacks features that the model needs.
    """
    probabilities = supervoxel_probabilities(scene, supervoxels, features, bundle)
    keep = inliers(scene)
    label = np.full(len(scene), IGNORE, dtype=np.int16)
    confidence = np.zeros(len(scene), dtype=np.float32)
    label[keep], confidence[keep] = label_points(
        scene.xyz[keep],
        features["centroids"],
        probabilities,
        supervoxel_labels=supervoxels["labels"][keep],
        rule=bundle.metadata["parameters"]["forest"]["rule"],
    )
    return {"label": label, "confidence": confidence}


def supervoxel_probabilities(
    scene: PointCloud, supervoxels: Mapping[str, Any], features: Mapping[str, NDArray], bundle: ModelBundle
) -> NDArray[np.float32]:
    """Return the class probabilities of the supervoxels of a prepared scene.

    Parameters
    ----------
    scene : PointCloud
        The scene.
    supervoxels : mapping
        What `build_supervoxels` gave.
    features : mapping
        What `describe_supervoxels` gave.
    bundle : ModelBundle
        A model of `fit`.

    Returns
    -------
    ndarray of shape (s, classes), float32
        Probabilities, those of the neighbours mixed in as the model has it.

    Raises
    ------
    DataError
        If the scene lacks features that the model needs.
    """
    have = [name for name in bundle.metadata["attributes"] if name in scene]
    variant = "+".join(("geometry", *have))
    names = [str(name) for name in features["names"]]
    missing = [name for name in bundle.metadata["feature_names"][variant] if name not in names]
    if missing:
        raise DataError(f"{scene.source}: the model needs the features {', '.join(missing)}")
    columns = [names.index(name) for name in bundle.metadata["feature_names"][variant]]
    probabilities = _predict(
        arrays_under(bundle.arrays, f"{variant}."), np.ascontiguousarray(features["values"][:, columns])
    )
    forest = bundle.metadata["parameters"]["forest"]
    if forest["smoothing"] > 0:
        probabilities = smooth_probabilities(probabilities, supervoxels["adjacency"], weight=forest["smoothing"])
    return probabilities


def _predict(arrays: Mapping[str, NDArray], values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the probabilities of all classes of the scheme, 0 for those that training did not see."""
    out = np.zeros((len(values), int(arrays["n_classes"])), dtype=np.float32)
    out[:, arrays["trained_classes"]] = FlatForest.from_arrays(arrays).predict_proba(values)
    return out


def prepare(scene: PointCloud, bundle: ModelBundle) -> tuple[dict[str, NDArray], dict[str, Any], dict[str, NDArray]]:
    """Run the stages that come before the forest, with the parameters that the model was trained with.

    Parameters
    ----------
    scene : PointCloud
        The scene. Where it has the columns `ground` and `height`, as `find_ground` gives them, they are taken.
    bundle : ModelBundle
        A model of `fit`.

    Returns
    -------
    ground, supervoxels, features : dict
        What `find_ground`, `build_supervoxels` and `describe_supervoxels` give.

    Raises
    ------
    DataError
        If a coordinate is NaN or infinite.
    """
    stages = _stages(bundle)
    known = "ground" in scene and "height" in scene
    ground = {n: scene[n] for n in ("ground", "height")} if known else find_ground(scene, stages.ground)
    supervoxels = build_supervoxels(scene, stages.supervoxels)
    return ground, supervoxels, describe_supervoxels(scene, ground, supervoxels, stages.features)


def _stages(bundle: ModelBundle) -> StageParameters:
    stored = bundle.metadata["parameters"]
    kinds = {"ground": GroundParameters, "supervoxels": SupervoxelParameters, "features": FeatureParameters}
    return StageParameters(**{f.name: kinds[f.name](**stored[f.name]) for f in fields(StageParameters)})


def label_cloud(cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Give every point of a cloud a class and a confidence, from raw coordinates on.

    Parameters
    ----------
    cloud : PointCloud
        Points; colour and intensity are used where the cloud and the model have them.
    bundle : ModelBundle
        A model of `fit`.

    Returns
    -------
    labels : ndarray of int16, shape (n,)
        Labels of the model's scheme.
    confidence : ndarray of float32, shape (n,)
        Probability of the label.

    Raises
    ------
    DataError
        If a coordinate is NaN or infinite.
    """
    if len(cloud) == 0:
        return np.zeros(0, dtype=np.int16), np.zeros(0, dtype=np.float32)
    absent = missing_attributes(bundle, list(cloud.columns))
    if absent:
        level = logging.INFO if "core" in cloud else logging.WARNING  # who cuts a survey into scenes says it once
        logger.log(level, "%s has no %s: the forest without it is used", cloud.source, " and no ".join(absent))
    _, supervoxels, features = prepare(cloud, bundle)
    found = label_scene(cloud, supervoxels, features, bundle)
    return found["label"], found["confidence"]
