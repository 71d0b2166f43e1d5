"""What all methods that label patches share: scenes in, labels of points out, models as plain arrays.

A method brings a class with `predict_proba`, `to_arrays` and `from_arrays` (see `PatchClassifier`), a function
``train(training, ...)`` that makes a model of what `patch_training` holds, and its entry point
``label_cloud = partial(label_patch_cloud, classifier=...)``. All else is here and in `patch_training`:

- `build_patches` is the stage of the pipeline `patches`: the patches and edges of one scene as arrays;
- `label_patches` gives the patches of a training scene their classes;
- `label_patch_scene` labels the points of a prepared scene, `label_patch_cloud` those of a cloud never seen before.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.majority import majority_labels
from mlsroad_pipeline.algorithms.patches.extraction import Patches, PatchParameters, extract_patches
from mlsroad_pipeline.algorithms.patches.voting import vote_on_points
from mlsroad_pipeline.algorithms.stages import GroundParameters, find_ground, inliers

logger = logging.getLogger(__name__)


class PatchClassifier(Protocol):
    """What a method that labels patches brings; the number of classes is its own business from `fit` on."""

    def predict_proba(self, patches: Patches, edges: NDArray[np.int32]) -> NDArray[np.floating]:
        """Return the class probabilities of the patches of one scene.

        Parameters
        ----------
        patches : Patches
            The patches; they may lack colour where the training scenes had it.
        edges : ndarray of int32, shape (m, 2)
            Pairs of patches whose leaves touch.

        Returns
        -------
        ndarray of float, shape (n, c)
            Probability of every class of the scheme.
        """

    def to_arrays(self) -> dict[str, NDArray]:
        """Return all that was learned as named plain arrays.

        Returns
        -------
        dict of str to ndarray
            The arrays.
        """

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild the classifier from what `to_arrays` returned.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            The arrays.

        Returns
        -------
        PatchClassifier
            The classifier.
        """


@dataclass(frozen=True)
class PatchStages:
    """How a scene is prepared before a classifier sees it; kept in the model, so that new surveys are prepared alike.

    Parameters
    ----------
    ground : GroundParameters
        The ground filter.
    patches : PatchParameters
        The patches.
    """

    ground: GroundParameters
    patches: PatchParameters


def build_patches(scene: PointCloud, ground: Mapping[str, NDArray], parameters: PatchParameters) -> dict[str, NDArray]:
    """Cut a scene into patches.

    Parameters
    ----------
    scene : PointCloud
        The scene; outliers take no part.
    ground : mapping
        What `find_ground` gave.
    parameters : PatchParameters
        Sizes and radii.

    Returns
    -------
    dict of str to ndarray
        The columns of `Patches`, ``patch_of_point`` int32 (n,), -1 for outliers, and ``edges`` int32 (m, 2).

    Raises
    ------
    DataError
        If no point takes part or a coordinate is not finite.
    """
    found = extract_patches(scene, height=ground["height"], parameters=parameters, keep=inliers(scene))
    return {**found.patches.to_arrays(), "patch_of_point": found.patch_of_point, "edges": found.edges}


def label_patches(scene: PointCloud, patches: Mapping[str, NDArray], scheme: ClassScheme) -> dict[str, NDArray]:
    """Give each patch the class of most of its labelled core points (Luo et al. 2016, section III-A).

    Parameters
    ----------
    scene : PointCloud
        A training scene, with `label` and, where it has a buffer, `core`.
    patches : mapping
        What `build_patches` gave.
    scheme : ClassScheme
        The classes.

    Returns
    -------
    dict of str to ndarray
        ``label`` int16 (p,), of equal counts the lowest; -1 for patches without labelled core points.

    Raises
    ------
    MissingColumnError
        If the scene has no labels.
    UnknownClassError
        If a label is not in the scheme.
    """
    labels = scheme.encode(scene["label"], source=scene.source)
    core = scene.get("core")
    owner = patches["patch_of_point"]
    known = (labels != IGNORE) & (owner >= 0) & (True if core is None else core.astype(np.bool_))
    found = np.full(len(patches["height"]), IGNORE, np.int16)
    voted, _ = majority_labels(labels[known], owner[known], len(scheme))
    found[: len(voted)] = voted
    return {"label": found}


def label_patch_scene(
    scene: PointCloud,
    patches: Mapping[str, NDArray],
    bundle: ModelBundle,
    classifier: type[PatchClassifier],
) -> dict[str, NDArray]:
    """Give every point of a prepared scene a class and a confidence.

    Parameters
    ----------
    scene : PointCloud
        The scene.
    patches : mapping
        What `build_patches` gave with the parameters that the model was trained with.
    bundle : ModelBundle
        A model of `patch_training.bundle_model`.
    classifier : type
        The method's class.

    Returns
    -------
    dict of str to ndarray
        ``label`` int16 (n,), -1 for outliers, and ``confidence`` float32 (n,), 0 for outliers.

    Raises
    ------
    DataError
        If the model needs other histograms than the patches have.
    """
    found = Patches.from_arrays(patches)
    if "rgb" not in bundle.metadata["attributes"]:
        found = found.with_columns(rgb=None)
    stored = PatchParameters(**bundle.metadata["parameters"]["patches"])
    width = (4 if stored.use_distance else 3) * stored.n_bins
    if found.fpfh.shape[1] != width:
        raise DataError(f"{scene.source}: the model needs histograms of {width} values, got {found.fpfh.shape[1]}")
    probabilities = classifier.from_arrays(bundle.arrays).predict_proba(found, patches["edges"])
    keep = inliers(scene)
    label, confidence = np.full(len(scene), IGNORE, np.int16), np.zeros(len(scene), np.float32)
    label[keep], confidence[keep] = vote_on_points(
        scene.xyz[keep], found.centroid, probabilities, radius=stored.area_radius
    )
    return {"label": label, "confidence": confidence}


def label_patch_cloud(
    cloud: PointCloud, bundle: ModelBundle, classifier: type[PatchClassifier]
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Give every point of a cloud a class and a confidence, from raw coordinates on.

    Parameters
    ----------
    cloud : PointCloud
        Points; colour is used where the cloud and the model have it. Where it has the columns `ground` and `height`, as
        `find_ground` gives them, they are taken.
    bundle : ModelBundle
        A model of `patch_training.bundle_model`.
    classifier : type
        The method's class.

    Returns
    -------
    labels : ndarray of int16, shape (n,)
        Labels of the model's scheme, -1 for outliers.
    confidence : ndarray of float32, shape (n,)
        Mean probability of the label over the patches around.

    Raises
    ------
    DataError
        If a coordinate is NaN or infinite.
    """
    if not inliers(cloud).any():
        return np.full(len(cloud), IGNORE, np.int16), np.zeros(len(cloud), np.float32)
    _, patches = prepare_cloud(cloud, bundle)
    found = label_patch_scene(cloud, patches, bundle, classifier)
    return found["label"], found["confidence"]


def prepare_cloud(cloud: PointCloud, bundle: ModelBundle) -> tuple[dict[str, NDArray], dict[str, NDArray]]:
    """Prepare a cloud as the scenes were that a model was trained on.

    Parameters
    ----------
    cloud : PointCloud
        Points, at least one no outlier. Where it has the columns `ground` and `height`, as `find_ground` gives them,
        they are taken.
    bundle : ModelBundle
        The model.

    Returns
    -------
    ground : dict of str to ndarray
        ``ground`` and ``height``.
    patches : dict of str to ndarray
        What `build_patches` gives.

    Raises
    ------
    DataError
        If a coordinate is NaN or infinite.
    """
    absent = [name for name in bundle.metadata["attributes"] if name not in cloud]
    if absent:
        level = logging.INFO if "core" in cloud else logging.WARNING  # who cuts a survey into scenes says it once
        logger.log(level, "%s has no %s: it is labelled without", cloud.source, " and no ".join(absent))
    stored, names = bundle.metadata["parameters"], ("ground", "height")
    if all(name in cloud for name in names):
        ground = {name: cloud[name] for name in names}
    else:
        ground = find_ground(cloud, GroundParameters(**stored["ground"]))
    return ground, build_patches(cloud, ground, PatchParameters(**stored["patches"]))
