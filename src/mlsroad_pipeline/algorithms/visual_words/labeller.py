"""Scenes into bags and detections, with a model and without training code (Yu et al. 2016, IV)."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.classes import IGNORE
from mlsroad_pipeline.algorithms.exceptions import DataError
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.algorithms.object_segmentation import SegmentationParameters, segment_scene
from mlsroad_pipeline.algorithms.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.scene_stages import GroundParameters, find_ground
from mlsroad_pipeline.algorithms.visual_words.bags import count_words
from mlsroad_pipeline.algorithms.visual_words.detector import VisualWordsDetector
from mlsroad_pipeline.algorithms.visual_words.groups import ContextualGroups, build_groups
from mlsroad_pipeline.algorithms.visual_words.regions import INTENSITY, RegionParameters, describe_regions
from mlsroad_pipeline.algorithms.visual_words.vocabulary import Vocabulary

SLUG = "visual_words"
ENTRY_POINT = "mlsroad_pipeline.algorithms.visual_words.labeller:label_cloud"

WITH_INTENSITY, GEOMETRY = "geometry+intensity", "geometry"
"""Variants of a model: a survey without intensity is quantised with words that never saw any."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class GroupParameters:
    """How the objects of a scene are described.

    Parameters
    ----------
    regions : RegionParameters or mapping
        Supervoxels and neighbourhoods.
    k : int, default 2
        Neighbours in a contextual group (yu2016: 2).
    """

    regions: RegionParameters
    k: int = 2

    def __post_init__(self) -> None:
        if isinstance(self.regions, Mapping):
            object.__setattr__(self, "regions", RegionParameters(**self.regions))


def describe_objects(
    scene: PointCloud, objects: Mapping[str, NDArray], *, parameters: GroupParameters
) -> dict[str, NDArray]:
    """Describe the objects of a scene by contextual groups.

    Parameters
    ----------
    scene : PointCloud
        The scene.
    objects : mapping
        What `segment_scene` gave.
    parameters : GroupParameters
        How they are described.

    Returns
    -------
    dict of str to ndarray
        The arrays of `ContextualGroups`; ``objects`` int32, the object of each group; ``n_objects``; ``intensity``,
        whether the scene has it.
    """
    regions = describe_regions(
        scene.xyz, objects["objects"], intensity=scene.get("intensity"), parameters=parameters.regions
    )
    groups = build_groups(regions, k=parameters.k)
    return {
        "descriptors": groups.descriptors,
        "orientations": groups.orientations,
        "scales": groups.scales,
        "objects": regions.objects,
        "n_objects": np.array(int(objects["objects"].max(initial=-1)) + 1),
        "intensity": np.array("intensity" in scene),
    }


def groups_of(arrays: Mapping[str, NDArray], *, intensity: bool = True) -> ContextualGroups:
    """Return the groups that `describe_objects` stored.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        What it gave.
    intensity : bool, default True
        Whether to keep the intensities; without, they are 0 everywhere.

    Returns
    -------
    ContextualGroups
        The groups.
    """
    groups = ContextualGroups(arrays["descriptors"], arrays["orientations"], arrays["scales"])
    if intensity:
        return groups
    blind = groups.descriptors.copy()
    blind[..., INTENSITY] = 0.0
    return replace(groups, descriptors=blind)


def bag_objects(arrays: Mapping[str, NDArray], vocabulary: Vocabulary, *, intensity: bool) -> csr_array:
    """Count the words of the objects of a scene.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        What `describe_objects` gave.
    vocabulary : Vocabulary
        The words.
    intensity : bool
        Whether they know of intensities.

    Returns
    -------
    csr_array of shape (objects, words)
        Occurrences.
    """
    words = vocabulary.quantise(groups_of(arrays, intensity=intensity))
    return count_words(words, arrays["objects"], n_objects=int(arrays["n_objects"]), stopped=vocabulary.stopped)


def variant_arrays(bundle: ModelBundle, variant: str) -> dict[str, NDArray]:
    """Return the arrays of one variant of a model, by their plain names.

    Parameters
    ----------
    bundle : ModelBundle
        The model.
    variant : str
        `WITH_INTENSITY` or `GEOMETRY`.

    Returns
    -------
    dict of str to ndarray
        The arrays.
    """
    prefix = f"{variant}."
    return {key.removeprefix(prefix): array for key, array in bundle.arrays.items() if key.startswith(prefix)}


def model_of(bundle: ModelBundle, variant: str) -> tuple[Vocabulary, VisualWordsDetector]:
    """Rebuild a vocabulary and its detector.

    Parameters
    ----------
    bundle : ModelBundle
        The model.
    variant : str
        `WITH_INTENSITY` or `GEOMETRY`.

    Returns
    -------
    vocabulary : Vocabulary
        The words.
    detector : VisualWordsDetector
        Queries and thresholds.
    """
    arrays = variant_arrays(bundle, variant)
    words = ContextualGroups(arrays["words.descriptors"], arrays["words.orientations"], arrays["words.scales"])
    vocabulary = Vocabulary(words, arrays["words.inverse"], arrays["words.stopped"], float(arrays["words.floor"]))
    return vocabulary, VisualWordsDetector.from_arrays(arrays)


def detect_scene(arrays: Mapping[str, NDArray], bundle: ModelBundle) -> dict[str, NDArray]:
    """Detect the objects of a scene.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        What `describe_objects` gave.
    bundle : ModelBundle
        A model of `train_detector`.

    Returns
    -------
    dict of str to ndarray
        ``label`` int16 (objects,): place in the wanted classes, -1 for none; ``score`` float32, likeness to the nearest
        query.
    """
    known = bool(arrays["intensity"]) and WITH_INTENSITY in bundle.metadata["variants"]
    vocabulary, detector = model_of(bundle, WITH_INTENSITY if known else GEOMETRY)
    label, score = detector.detect(bag_objects(arrays, vocabulary, intensity=known))
    return {"label": label, "score": score}


def label_cloud(cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Give the points of detected objects their class and score, from raw coordinates on; all others none.

    Parameters
    ----------
    cloud : PointCloud
        Points; intensity is used where the cloud and the model have it. Where it has the columns `ground` and
        `height`, as `find_ground` gives them, they are taken.
    bundle : ModelBundle
        A model of `train_detector`.

    Returns
    -------
    labels : ndarray of int16, shape (n,)
        Labels of the model's scheme, -1 outside detected objects.
    confidence : ndarray of float32, shape (n,)
        Likeness of the object to the nearest query; 0 outside.

    Raises
    ------
    DataError
        If a coordinate is NaN or infinite, or the model lacks its parts.
    """
    labels, confidence = np.full(len(cloud), IGNORE, dtype=np.int16), np.zeros(len(cloud), dtype=np.float32)
    if len(cloud) == 0:
        return labels, confidence
    stored: Mapping[str, Any] = bundle.metadata["parameters"]
    if "intensity" in bundle.metadata["attributes"] and "intensity" not in cloud:
        level = logging.INFO if "core" in cloud else logging.WARNING  # who cuts a survey into scenes says it once
        logger.log(level, "%s has no intensity: objects are looked for by their shape", cloud.source)
    known = "ground" in cloud
    ground = {"ground": cloud["ground"]} if known else find_ground(cloud, GroundParameters(**stored["ground"]))
    objects = segment_scene(cloud, ground, SegmentationParameters(**stored["segmentation"]))
    found = detect_scene(describe_objects(cloud, objects, parameters=GroupParameters(**stored["groups"])), bundle)
    wanted = np.array(bundle.metadata["wanted"], dtype=np.int16)
    if len(found["label"]) and found["label"].max() >= len(wanted):
        raise DataError(f"model {bundle.slug!r} detects class {found['label'].max()} of {len(wanted)}")
    inside = objects["objects"] >= 0
    label = np.where(found["label"] >= 0, wanted[found["label"]], IGNORE).astype(np.int16)
    labels[inside] = label[objects["objects"][inside]]
    confidence[inside] = found["score"][objects["objects"][inside]]
    return labels, confidence
