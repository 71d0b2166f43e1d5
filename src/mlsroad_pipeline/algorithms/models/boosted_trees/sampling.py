"""Training voxels of labelled scenes, and their weights.

A label is a row of a table of sets of classes. A row may allow several classes: a recording may not separate trees from
low vegetation, for example.
"""

from collections.abc import Mapping, Sequence
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.labels import core_labels
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.core.stage_results import Ground
from mlsroad_pipeline.algorithms.features.voxel_table import voxel_feature_names
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import describe_scene
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import SLUG, BoostedTreesParameters
from mlsroad_pipeline.algorithms.models.machines.class_balance import draw_per_class, majority_labels
from mlsroad_pipeline.algorithms.stages import ground_of, inliers


class TrainingVoxels(TypedDict):
    """Labelled voxels of a training scene."""

    values: NDArray[np.float32]  # Features
    rows: NDArray[np.int16]  # Row of `sets` of each voxel
    sets: NDArray[np.bool_]  # Allowed classes of each row
    found: NDArray[np.int64]  # Labelled voxels of each row in the scene, of which those here are a sample


def training_voxels(
    scene: PointCloud, ground: Ground, *, parameters: BoostedTreesParameters, scheme: ClassScheme
) -> TrainingVoxels:
    """Draw the training voxels of a scene labelled in a scheme."""
    labels = core_labels(scene, scheme)
    return sample_voxels(scene, ground, labels, np.eye(len(scheme), dtype=np.bool_), parameters=parameters)


def coarse_training_voxels(
    scene: PointCloud,
    filtered: GroundParameters,
    own: BoostedTreesParameters,
    *,
    scheme: ClassScheme,
    coarse: ClassScheme,
) -> TrainingVoxels:
    """Draw the training voxels of a scene whose labels separate fewer classes than the scheme."""
    truth = coarse.encode(scene["label"], source=scene.source)
    sets = scheme.coarsen(coarse)[None, :] == np.arange(len(coarse))[:, None]
    return sample_voxels(scene, ground_of(scene, filtered), truth, sets, parameters=own)


def sample_voxels(
    scene: PointCloud,
    ground: Ground,
    truth: NDArray[np.integer],
    sets: NDArray[np.bool_],
    *,
    parameters: BoostedTreesParameters,
) -> TrainingVoxels:
    """Draw the training voxels of a scene; a voxel takes the majority of its labelled points."""
    if not sets.any(axis=1).all():
        raise DataError(f"{scene.source}: row {int(np.argmin(sets.any(axis=1)))} of the class sets allows no class")
    keep = inliers(scene)
    n_rows = len(sets)
    if not keep.any():
        none = np.zeros((0, len(voxel_feature_names())), np.float32)
        return {"values": none, "rows": np.zeros(0, np.int16), "sets": sets, "found": np.zeros(n_rows, np.int64)}
    features = describe_scene(scene, ground, voxel_size=parameters.voxel_size)
    majority, _ = majority_labels(truth[keep], features.owner, n_rows)
    drawn = draw_per_class(majority, parameters.max_per_class, seed=parameters.seed)
    return {
        "values": features.values[drawn],
        "rows": majority[drawn],
        "sets": np.asarray(sets, np.bool_),
        "found": np.bincount(majority[majority != IGNORE], minlength=n_rows).astype(np.int64),
    }


def join_voxels(
    scenes: Sequence[TrainingVoxels],
    *,
    scheme: ClassScheme,
    prior: Mapping[str, float],
    weights: Sequence[float] | None = None,
    sources: Sequence[str] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.float64]]:
    """Join the voxels of scenes."""
    if not scenes:
        raise DataError("no training scenes: the split 'train' is empty")
    of_source = np.array(["" for _ in scenes] if sources is None else list(sources))
    of_scene = np.ones(len(scenes)) if weights is None else np.asarray(weights, np.float64)
    used = [i for i, scene in enumerate(scenes) if len(scene["rows"])]
    if not used:
        raise DataError("there are no labelled points to train on: check survey.splits.train and survey.scheme")
    for i in used:
        if scenes[i]["sets"].shape[1] != len(scheme):
            raise DataError(f"class sets have {scenes[i]['sets'].shape[1]} classes, the scheme {len(scheme)}")
    shares = _shares(scheme, prior)
    weight = [np.zeros(0)] * len(scenes)
    for name in dict.fromkeys(of_source[used].tolist()):
        own = [i for i in used if of_source[i] == name]
        parts = [_found_weights(scenes[i]) for i in own]
        if shares is not None:
            parts = _with_prior([scenes[i] for i in own], parts, shares)
        total = sum(float(part.sum()) for part in parts)
        for i, part in zip(own, parts, strict=True):
            weight[i] = part * (of_scene[i] / total)
    joined = np.concatenate([weight[i] for i in used])
    allowed = np.concatenate([scenes[i]["sets"][scenes[i]["rows"]] for i in used])
    return np.concatenate([scenes[i]["values"] for i in used]), allowed, joined * (len(joined) / joined.sum())


def _shares(scheme: ClassScheme, prior: Mapping[str, float]) -> NDArray[np.float64] | None:
    """Return the share of each class of the scheme; None without a prior."""
    if not prior:
        return None
    wrong = [name for name in prior if name not in scheme.classes] + [n for n in scheme.classes if n not in prior]
    if wrong:
        raise ParameterError(
            f"{SLUG}.prior must name the classes of the scheme, {', '.join(scheme.classes)}: check {wrong[0]!r}"
        )
    return np.array([prior[name] for name in scheme.classes])


def _found_weights(scene: TrainingVoxels) -> NDArray[np.float64]:
    """Return weights with which the sample has the shares of the rows of the whole scene."""
    drawn = np.bincount(scene["rows"], minlength=len(scene["found"]))
    return (scene["found"] / np.maximum(drawn, 1))[scene["rows"]]


def _with_prior(
    scenes: Sequence[TrainingVoxels], weights: Sequence[NDArray[np.float64]], shares: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Scale weights so that each class has its share: a voxel of several classes gets the sum of their factors."""
    of_class = sum(w @ scene["sets"][scene["rows"]] for scene, w in zip(scenes, weights, strict=True))
    factor = np.divide(shares, of_class, out=np.zeros(len(shares)), where=np.asarray(of_class) > 0)
    return [w * (scene["sets"][scene["rows"]] @ factor) for scene, w in zip(scenes, weights, strict=True)]
