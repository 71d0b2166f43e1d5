"""Training of the multiscale forest (Thomas et al. 2018): the same number of voxels of each class."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines.multiscale_forest.labeller import COLUMNS_OF, spheres_of
from mlsroad_pipeline.algorithms.baselines.multiscale_forest.parameters import SLUG, MultiscaleForestParameters
from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.features.sphere_features import attribute_columns, sphere_feature_names
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.class_balance import draw_per_class, majority_labels
from mlsroad_pipeline.algorithms.models.flat_forest import FlatForest
from mlsroad_pipeline.algorithms.stages import inliers

logger = logging.getLogger(__name__)


class TrainingSpheres(TypedDict):
    """Labelled voxels of a training scene.

    Attributes
    ----------
    values : ndarray of float32, shape (v, f)
        Features.
    labels : ndarray of int16, shape (v,)
        Class of each voxel.
    """

    values: NDArray[np.float32]
    labels: NDArray[np.int16]


def training_spheres(scene: PointCloud, own: MultiscaleForestParameters, *, scheme: ClassScheme) -> TrainingSpheres:
    """Draw the training voxels of a scene; a voxel takes the majority of its labelled core points.

    Parameters
    ----------
    scene : PointCloud
        The scene, with `label`; points outside `core` are not trained on.
    own : MultiscaleForestParameters
        Parameters of the method.
    scheme : ClassScheme
        The classes.

    Returns
    -------
    TrainingSpheres
        At most `max_per_scene` voxels of each class.

    Raises
    ------
    MissingColumnError
        If the scene has no labels.
    UnknownClassError
        If a label is not in the scheme.
    """
    labels = scheme.encode(scene["label"], source=scene.source)
    core = scene.get("core")
    if core is not None:
        labels = np.where(core, labels, np.int16(IGNORE))
    keep = inliers(scene)
    if not keep.any():
        none = np.zeros((0, len(sphere_feature_names(own.n_scales))), np.float32)
        return {"values": none, "labels": np.zeros(0, np.int16)}
    pyramid = spheres_of(scene, own)
    majority, _ = majority_labels(labels[keep], pyramid.owner, len(scheme))
    drawn = draw_per_class(majority, own.max_per_scene, seed=own.seed)
    return {"values": pyramid.describe(drawn), "labels": majority[drawn]}


def fit(
    scenes: Sequence[TrainingSpheres],
    *,
    parameters: MultiscaleForestParameters,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
    n_jobs: int = 1,
) -> ModelBundle:
    """Train the forest.

    Parameters
    ----------
    scenes : sequence of TrainingSpheres
        Voxels of `training_spheres`.
    parameters : MultiscaleForestParameters
        Parameters of the method.
    scheme : ClassScheme
        The classes.
    trained_on : mapping
        Description of the training data for the model's metadata; JSON values.
    n_jobs : int, default 1
        Jobs of the training; the model does not depend on them.

    Returns
    -------
    ModelBundle
        The model.

    Raises
    ------
    DataError
        If there are no scenes, or fewer than two classes among the voxels.
    """
    if not scenes:
        raise DataError("no training scenes: the split 'train' is empty")
    values = np.concatenate([scene["values"] for scene in scenes])
    labels = np.concatenate([scene["labels"] for scene in scenes])
    drawn = draw_per_class(labels, parameters.max_per_class, seed=parameters.seed)
    values, labels = values[drawn], labels[drawn]
    classes = np.unique(labels)
    if len(classes) < 2:
        raise DataError(
            f"the training scenes have points of {len(classes)} classes, and a forest needs two: "
            "check survey.splits.train and survey.scheme"
        )
    missing = [name for number, name in enumerate(scheme.classes) if number not in classes]
    if missing:
        logger.warning("No training points of %s: they are never predicted", ", ".join(missing))
    attributes = _hide_attributes(values, parameters)
    columns = np.flatnonzero(~np.isnan(values).all(axis=0))
    arrays = {
        **_grow(values[:, columns], labels, parameters, n_jobs).to_arrays(),
        "columns": columns,
        "trained_classes": classes.astype(np.int16),
    }
    names = sphere_feature_names(parameters.n_scales)
    metadata = {
        "classes": list(scheme.classes),
        "scheme": asdict(scheme),
        "parameters": {SLUG: asdict(parameters)},
        "feature_names": [names[column] for column in columns],
        "attributes": attributes,
        "trained_on": {**trained_on, "voxels": len(labels)},
    }
    return ModelBundle(SLUG, arrays, metadata)


def _hide_attributes(values: NDArray[np.float32], parameters: MultiscaleForestParameters) -> list[str]:
    """Hide each attribute of a share of the voxels, in place; return the columns that any voxel has."""
    rng = np.random.default_rng(parameters.seed)
    present = []
    for name, attributes in COLUMNS_OF.items():
        columns = np.concatenate([attribute_columns(parameters.n_scales, attribute) for attribute in attributes])
        if not np.isnan(values[:, columns]).all():
            present.append(name)
        hidden = rng.random(len(values)) < parameters.dropout
        values[np.ix_(hidden, columns)] = np.nan
    return present


def _grow(
    values: NDArray[np.float32], labels: NDArray[np.int16], parameters: MultiscaleForestParameters, n_jobs: int
) -> FlatForest:
    """Grow the trees; all classes have the same total weight."""
    from sklearn.ensemble import RandomForestClassifier  # noqa: PLC0415  # labelling needs none

    forest = RandomForestClassifier(
        parameters.n_trees, min_samples_leaf=parameters.min_samples_leaf, max_features=parameters.max_features,
        class_weight="balanced_subsample", random_state=parameters.seed, n_jobs=n_jobs,
    )  # fmt: skip
    return FlatForest.from_trees(forest.fit(values, labels).estimators_)
