"""Labelling of points by patch classifiers (Luo et al. 2016, section III).

A method provides a class with `fit`, `predict_proba`, `to_arrays` and `from_arrays` (see `extraction.PatchClassifier`).
This module and `models` provide the rest.
"""

import logging
from typing import cast

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.labels import PointLabels, core_labels, unlabelled
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.core.stage_results import Ground
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, missing_attributes
from mlsroad_pipeline.algorithms.models.machines.class_balance import majority_labels
from mlsroad_pipeline.algorithms.scenes.corridor import CorridorArrays, corridor_from_arrays
from mlsroad_pipeline.algorithms.stages import ground_of, inliers
from mlsroad_pipeline.papers.shared.patches.extraction import (
    PatchClassifier,
    PatchLabels,
    PatchParameters,
    ScenePatches,
    extract_patches,
)
from mlsroad_pipeline.papers.shared.patches.table import Patches
from mlsroad_pipeline.papers.shared.patches.voting import vote_on_points

logger = logging.getLogger(__name__)


def build_patches(scene: PointCloud, ground: Ground, parameters: PatchParameters) -> ScenePatches:
    """Cut a scene into patches."""
    cut = extract_patches(scene, height=ground["height"], parameters=parameters, keep=inliers(scene))
    arrays = {**cut.patches.to_arrays(), "patch_of_point": cut.patch_of_point, "edges": cut.edges}
    return cast(ScenePatches, arrays)


def label_patches(
    scene: PointCloud, patches: ScenePatches, scheme: ClassScheme, *, station: NDArray[np.float64] | None = None
) -> PatchLabels:
    """Assign to each patch the majority class of its labelled core points (Luo et al. 2016, section III-A)."""
    labels, owner = core_labels(scene, scheme), patches["patch_of_point"]
    known = (labels != IGNORE) & (owner >= 0)
    label = np.full(len(patches["height"]), IGNORE, np.int16)
    majority, _ = majority_labels(labels[known], owner[known], len(scheme))
    label[: len(majority)] = majority
    return {"label": label, "station": main_axis_stations(patches["centroid"]) if station is None else station}


def main_axis_stations(centroid: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the position of patches along their main horizontal axis."""
    plan = centroid[:, :2] - centroid[:, :2].mean(axis=0)
    _, axes = np.linalg.eigh(plan.T @ plan)
    along: NDArray[np.float64] = plan @ axes[:, 1]
    # The sign of an eigenvector is arbitrary: make its largest component positive.
    along *= np.sign(axes[np.abs(axes[:, 1]).argmax(), 1])
    return along - along.min()


def label_patch_scene(
    scene: PointCloud,
    patches: ScenePatches,
    bundle: ModelBundle,
    classifier: type[PatchClassifier],
) -> PointLabels:
    """Label the points of a prepared scene."""
    table = Patches.from_arrays(patches)
    if "rgb" not in bundle.metadata["attributes"]:
        table = table.with_columns(rgb=None)
    stored = PatchParameters(**bundle.metadata["parameters"]["patches"])
    width = (4 if stored.use_distance else 3) * stored.n_bins
    if table.fpfh.shape[1] != width:
        raise DataError(f"{scene.source}: the model needs histograms of {width} values, got {table.fpfh.shape[1]}")
    probabilities = classifier.from_arrays(bundle.arrays).predict_proba(table, patches["edges"])
    keep = inliers(scene)
    label, confidence = unlabelled(len(scene))
    label[keep], confidence[keep] = vote_on_points(
        scene.xyz[keep], table.centroid, probabilities, radius=stored.area_radius
    )
    return {"label": label, "confidence": confidence}


def prepare_cloud(cloud: PointCloud, bundle: ModelBundle) -> tuple[Ground, ScenePatches]:
    """Run the stages before a classifier with the parameters of its model."""
    absent = missing_attributes(bundle, list(cloud.columns))
    if absent:
        level = logging.INFO if "core" in cloud else logging.WARNING  # scenes of a survey: the caller warns once
        logger.log(level, "%s has no %s: it is labelled without", cloud.source, " and no ".join(absent))
    stored = bundle.metadata["parameters"]
    ground = ground_of(cloud, GroundParameters(**stored["ground"]))
    return ground, build_patches(cloud, ground, PatchParameters(**stored["patches"]))


def label_patches_along(
    scene: PointCloud, patches: ScenePatches, corridor: CorridorArrays, *, scheme: ClassScheme
) -> PatchLabels:
    """Return the class of each patch and its station along the corridor that the survey is cut along."""
    line = corridor_from_arrays(corridor)
    station = None if line is None else line.locate(patches["centroid"], origin=scene.origin)[0]
    return label_patches(scene, patches, scheme, station=station)
