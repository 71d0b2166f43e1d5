"""Shape-based recognition (Golovinskiy, Kim and Funkhouser 2009), a baseline of Luo et al. 2016 (section IV-C).

Objects are located, segmented, described and classified by a random forest. Points of the ground have no label.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import RandomForestClassifier

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.labels import PointLabels, unlabelled
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_results import Ground
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.machines.class_balance import majority_labels
from mlsroad_pipeline.algorithms.models.machines.flat_forest import FlatForest
from mlsroad_pipeline.algorithms.stages import inliers
from mlsroad_pipeline.papers.luo2016.shape_based.cutting import CutParameters, describe_objects, segment_objects
from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters, PatchStages, ScenePatches
from mlsroad_pipeline.papers.shared.patches.labelling import label_patches, prepare_cloud
from mlsroad_pipeline.papers.shared.patches.voting import vote_on_points

SLUG = "shape_based"
_GREY = 0.5  # colour where the survey has none


@dataclass(frozen=True)
class ShapeParameters:
    """Parameters of the method."""

    spacing: float = 0.6  # Least distance in plan between two locations of objects, metres. Larger values find fewer.
    # Candidate background radii of the cut at each location, metres, ascending
    radii: Sequence[float] = field(default_factory=lambda: [1.0, 2.0, 4.0])
    background: float = 0.05  # Cost of a foreground site at the radius. Larger values cut closer to the location.
    # Weight of cut links per foreground site below which a cut isolates an object and larger radii are skipped
    isolated: float = 0.1
    # Whether mean histogram and mean colour of the patches are features of an object. The paper uses shape and context
    # alone; the compared methods use them too.
    appearance: bool = True
    n_trees: int = 100  # Number of trees of the random forest
    min_samples_leaf: int = 1  # Fewest objects in a leaf
    seed: int = 2009  # Seed of the forest

    def __post_init__(self) -> None:
        for name in ("n_trees", "min_samples_leaf"):
            check_at_least(getattr(self, name), 1, f"{SLUG}.{name}")
        self.cut()

    def cut(self) -> CutParameters:
        """Return the parameters of location and segmentation."""
        return CutParameters(
            spacing=self.spacing, radii=tuple(self.radii), background=self.background, isolated=self.isolated
        )


class SceneObjects(TypedDict):
    """Objects of a scene."""

    features: NDArray[np.float32]  # Features of each object
    object_of_patch: NDArray[np.int32]  # Object of each patch; -1 on the ground


def build_objects(ground: Ground, patches: ScenePatches, parameters: ShapeParameters) -> SceneObjects:
    """Segment the off-ground patches of a scene into objects and compute their features."""
    owner = patches["patch_of_point"]
    n_patches = len(patches["height"])
    taken = owner >= 0
    on_ground = np.bincount(owner[taken], ground["ground"][taken].astype(np.float64), n_patches)
    off = np.flatnonzero(2 * on_ground < np.bincount(owner[taken], minlength=n_patches))
    sites = patches["centroid"][off].astype(np.float64)
    colour = patches["rgb"][off] if "rgb" in patches else np.full((len(off), 3), _GREY)
    appearance = np.concatenate([patches["fpfh"][off], colour], axis=1)
    objects = segment_objects(sites, parameters.cut())
    of_patch = np.full(n_patches, -1, np.int32)
    of_patch[off] = objects
    used = appearance if parameters.appearance else appearance[:, :0]
    return {"features": describe_objects(sites, patches["height"][off], used, objects), "object_of_patch": of_patch}


def label_objects(scene: PointCloud, ground: Ground, patches: ScenePatches, bundle: ModelBundle) -> PointLabels:
    """Label the off-ground points of a prepared scene."""
    stored = bundle.metadata["parameters"]
    objects = build_objects(ground, patches, ShapeParameters(**stored[SLUG]))
    label, confidence = unlabelled(len(scene))
    off = np.flatnonzero(objects["object_of_patch"] >= 0)
    points = inliers(scene) & ~ground["ground"].astype(np.bool_)
    if len(off) == 0 or not points.any():
        return {"label": label, "confidence": confidence}
    probabilities = np.zeros((len(objects["features"]), len(bundle.metadata["classes"])), np.float32)
    forest = FlatForest.from_arrays(bundle.arrays)
    probabilities[:, bundle.arrays["known"].astype(np.int64)] = forest.predict_proba(objects["features"])
    of_patch = probabilities[objects["object_of_patch"][off]]
    radius = PatchParameters(**stored["patches"]).area_radius
    label[points], confidence[points] = vote_on_points(
        scene.xyz[points], patches["centroid"][off], of_patch, radius=radius
    )
    return {"label": label, "confidence": confidence}


def label_cloud(cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Label the off-ground points of a cloud, starting from raw coordinates."""
    if not inliers(cloud).any():
        return unlabelled(len(cloud))
    ground, patches = prepare_cloud(cloud, bundle)
    labels = label_objects(cloud, ground, patches, bundle)
    return labels["label"], labels["confidence"]


logger = logging.getLogger(__name__)


class TrainingObjects(TypedDict):
    """Labelled objects of a training scene."""

    features: NDArray[np.float32]  # Features of each object
    label: NDArray[np.int16]  # Majority class of the object's labelled patches
    on_ground: NDArray[np.int64]  # Labelled patches of each class off the ground (row 0) and on it (row 1)


def training_objects(
    scene: PointCloud,
    ground: Ground,
    patches: ScenePatches,
    *,
    scheme: ClassScheme,
    parameters: ShapeParameters,
) -> TrainingObjects:
    """Return the labelled objects of a training scene."""
    objects = build_objects(ground, patches, parameters)
    return labelled_objects(objects, label_patches(scene, patches, scheme)["label"], len(scheme))


def labelled_objects(objects: SceneObjects, labels: NDArray[np.integer], n_classes: int) -> TrainingObjects:
    """Return the objects whose patches are labelled."""
    owner = objects["object_of_patch"]
    off = owner >= 0
    majority, _ = majority_labels(labels[off], owner[off], n_classes)
    known = majority != IGNORE
    counts = [np.bincount(labels[side & (labels != IGNORE)], minlength=n_classes) for side in (off, ~off)]
    return {"features": objects["features"][known], "label": majority[known], "on_ground": np.array(counts)}


def fit(
    scenes: Sequence[TrainingObjects],
    *,
    parameters: ShapeParameters,
    stages: PatchStages,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
) -> ModelBundle:
    """Train the classifier of objects; the weight of an object is the square root of its number of patches."""
    filled = [scene for scene in scenes if len(scene["label"])]
    if not filled:
        raise DataError("no labelled object in the training scenes: check their labels and the ground filter")
    features = np.concatenate([scene["features"] for scene in filled])
    labels = np.concatenate([scene["label"] for scene in filled])
    known = np.unique(labels)
    if len(known) < 2:
        raise DataError(f"all training objects are of {scheme.classes[known[0]]}: training needs at least two classes")
    forest = RandomForestClassifier(
        parameters.n_trees,
        min_samples_leaf=parameters.min_samples_leaf,
        class_weight="balanced_subsample",
        random_state=parameters.seed,
    ).fit(features, labels, sample_weight=np.exp(0.5 * features[:, 0]))  # square root of the number of patches
    missing = [name for number, name in enumerate(scheme.classes) if number not in known]
    if missing:
        logger.warning("%s: no training objects of %s: they are never predicted", SLUG, ", ".join(missing))
    above, below = np.sum([scene["on_ground"] for scene in filled], axis=0)
    off_ground = above >= below
    metadata = {
        "classes": list(scheme.classes),
        "classes_given": [scheme.classes[number] for number in known if off_ground[number]],
        "scheme": asdict(scheme),
        "parameters": {SLUG: asdict(parameters), **asdict(stages)},
        "attributes": ["rgb"] if parameters.appearance else [],
        "trained_on": {**trained_on, "objects": len(labels)},
    }
    arrays = FlatForest.from_trees(forest.estimators_).to_arrays()
    return ModelBundle(SLUG, {**arrays, "known": known.astype(np.int16)}, metadata)
