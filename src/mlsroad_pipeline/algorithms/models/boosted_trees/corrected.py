"""A labeller of any method, and boosted trees that correct its class probabilities by the answers of a user.

The trees add to the logarithms of the probabilities, as a further round of boosting would (Friedman 2001, "Greedy
function approximation", with the scores of the labeller as the initial function). The labeller stays as it is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.labels import unlabelled
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.features.voxel_table import voxel_feature_names
from mlsroad_pipeline.algorithms.models.boosted_trees import answer_boosting
from mlsroad_pipeline.algorithms.models.boosted_trees.answer_boosting import Answer, Replay, Scored, boost_on_answers
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import describe_scene, softmax
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under
from mlsroad_pipeline.algorithms.models.familiarity import familiarity_of
from mlsroad_pipeline.algorithms.models.labelling import SoftLabels, label_softly, labels_of_rows, stored_member
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees
from mlsroad_pipeline.algorithms.models.machines.combinations import decide, rank_pairs
from mlsroad_pipeline.algorithms.stages import ground_of, inlier_rows, inliers


def continue_training(
    bundle: ModelBundle,
    answers: Sequence[Answer],
    survey: NDArray[np.float32],
    replay: Replay,
    *,
    learned_from: Mapping[str, Any] | None = None,
) -> ModelBundle:
    """Return a model that has learned from answers."""
    trees = BoostedTrees.from_arrays(bundle.arrays)
    temperature = float(bundle.arrays["temperature"])

    def scored(values: NDArray[np.floating]) -> Scored:
        rows = values.astype(np.float32, copy=False)
        if not len(rows):
            return Scored(rows, np.zeros((0, len(bundle.metadata["classes"]))))
        return Scored(rows, trees.scores(rows) / temperature + bundle.arrays["offsets"])

    known = [answer._replace(scores=scored(answer.values).scores) for answer in answers]
    groups = bundle.arrays.get("groups")
    added = boost_on_answers(known, scored(survey), replay, scored(replay.values), trees=trees, groups=groups)
    entry = learned_entry(answers, learned_from)
    metadata = {**bundle.metadata, "learned": [*bundle.metadata.get("learned", ()), entry]}
    kept = {name: array for name, array in bundle.arrays.items() if name not in trees.to_arrays()}
    scaled = [replace(part, leaf=(part.leaf * (temperature / len(added))).astype(np.float32)) for part in added]
    return ModelBundle(bundle.slug, {**BoostedTrees.joined([trees, *scaled]).to_arrays(), **kept}, metadata)


def learned_entry(answers: Sequence[Answer], learned_from: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the description of a learning for the metadata of a model."""
    used = sum(len(answer.values) > 0 for answer in answers)
    return {"answers": used, "parameters": asdict(answer_boosting.SETTINGS), **(learned_from or {})}


SLUG = "corrected"

BASE, ADDED = "base", "added"
"""Names of the labeller and of the trees in a model."""

FLOOR = 1e-4
"""Least probability of a class."""

MOST = 0.9
"""Greatest probability of the class of a labeller that gives no probabilities of the others."""

_SHARED = ("scheme", "classes", "attributes", "parameters", "trained_on", "training_facts")  # metadata of the labeller


def learn_corrections(
    bundle: ModelBundle,
    answers: Sequence[Answer],
    survey: Scored,
    replay: tuple[Replay, Scored],
    *,
    trees: BoostedTrees,
    voxel_size: float,
    learned_from: Mapping[str, Any] | None = None,
) -> ModelBundle:
    """Return a labeller with trees that correct it."""
    base, before = labeller_of(bundle), added_trees(bundle)
    if bundle.slug == SLUG and bundle.metadata["voxel_size"] != voxel_size:
        raise DataError(f"the trees of the model have voxels of {bundle.metadata['voxel_size']} m, not {voxel_size} m")
    groups = base.arrays.get("groups")
    added = boost_on_answers(answers, survey, *replay, trees=trees, groups=groups)
    parts = [replace(part, leaf=(part.leaf / len(added)).astype(np.float32)) for part in added]
    joined = BoostedTrees.joined([*([] if before is None else [before]), *parts])
    learned = [*bundle.metadata.get("learned", ()), learned_entry(answers, learned_from)]
    return _with_trees(base, joined, voxel_size, learned)


def _with_trees(
    base: ModelBundle, trees: BoostedTrees, voxel_size: float, learned: Sequence[Mapping[str, Any]]
) -> ModelBundle:
    arrays = {f"{BASE}/{name}": values for name, values in base.arrays.items()}
    arrays |= {f"{ADDED}/{name}": values for name, values in trees.to_arrays().items()}
    metadata = {
        **{name: base.metadata[name] for name in _SHARED if name in base.metadata},
        "voxel_size": voxel_size,
        "feature_names": voxel_feature_names(),
        "members": {BASE: {**base.metadata, "slug": base.slug}},
        "learned": list(learned),
    }
    return familiarity_of(base, ModelBundle(SLUG, arrays, metadata))


def labeller_of(bundle: ModelBundle) -> ModelBundle:
    """Return the labeller that the trees of a model correct."""
    if bundle.slug != SLUG:
        return bundle
    if BASE not in bundle.prepared:
        stored = bundle.metadata.get("members", {}).get(BASE)
        if not stored or "slug" not in stored:
            raise DataError(f"model {bundle.slug!r}: its labeller is missing: the model is damaged")
        bundle.prepared[BASE] = stored_member(bundle, BASE)
    found: ModelBundle = bundle.prepared[BASE]
    return found


def added_trees(bundle: ModelBundle) -> BoostedTrees | None:
    """Return the trees that correct a labeller."""
    if bundle.slug != SLUG:
        return None
    if bundle.metadata.get("feature_names") != voxel_feature_names():
        raise DataError(f"model {bundle.slug!r} has other features than this version: learn again from its labeller")
    if ADDED not in bundle.prepared:
        bundle.prepared[ADDED] = BoostedTrees.from_arrays(arrays_under(bundle.arrays, f"{ADDED}/"))
    found: BoostedTrees = bundle.prepared[ADDED]
    return found


def voxel_scores(
    bundle: ModelBundle, cloud: PointCloud, owner: NDArray[np.integer], n_voxels: int
) -> NDArray[np.float64]:
    """Return the logarithms of the mean class probabilities of a model in voxels."""
    soft = _softly(bundle, cloud)
    n_classes = len(bundle.metadata["classes"])
    sums = np.zeros((n_voxels, n_classes))
    known = (owner >= 0) & (soft.labels != IGNORE)
    if soft.probabilities is not None and soft.owner is not None:
        known &= soft.owner >= 0
        of_point = soft.probabilities[soft.owner[known]]
        sums = np.stack([np.bincount(owner[known], column, minlength=n_voxels) for column in of_point.T], axis=1)
    counts = np.bincount(owner[known], minlength=n_voxels)
    mean = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], 1 / n_classes)
    return np.log(np.maximum(mean, FLOOR))


def _softly(bundle: ModelBundle, cloud: PointCloud) -> SoftLabels:
    """Return the labels of a model with class probabilities; of a method without any, those of its confidences."""
    soft = label_softly(bundle, cloud)
    if soft.probabilities is not None or not (soft.labels != IGNORE).any():
        return soft
    n_classes = len(bundle.metadata["classes"])
    known = soft.labels != IGNORE
    found, row = np.unique(
        np.stack([soft.labels[known].astype(np.float32), soft.confidence[known]], axis=1), axis=0, return_inverse=True
    )
    own = np.clip(found[:, 1], 1 / n_classes, MOST)
    table = np.repeat(((1 - own) / max(n_classes - 1, 1))[:, None], n_classes, axis=1)
    table[np.arange(len(found)), found[:, 0].astype(np.int64)] = own
    owner = np.full(len(cloud), -1, np.int32)
    owner[known] = row.reshape(-1)
    return soft._replace(probabilities=table.astype(np.float32), owner=owner)


def label_cloud_softly(cloud: PointCloud, bundle: ModelBundle) -> SoftLabels:
    """Label the points of a cloud, and return the class probabilities."""
    base, trees = labeller_of(bundle), added_trees(bundle)
    soft = _softly(base, cloud)
    if trees is None or soft.probabilities is None or soft.owner is None or not inliers(cloud).any():
        return SoftLabels(*unlabelled(len(cloud)))
    ground = ground_of(cloud, GroundParameters(**base.metadata.get("parameters", {}).get("ground", {})))
    keep = inlier_rows(cloud)
    features = describe_scene(cloud, ground, voxel_size=float(bundle.metadata["voxel_size"]))
    voxel = np.full(len(cloud), -1, np.int32)
    voxel[keep] = features.owner
    if "near" in cloud:  # the context serves the features alone
        voxel[~cloud["near"]] = -1
    own, second, combination = rank_pairs(soft.owner.astype(np.int32, copy=False), voxel, len(soft.probabilities))
    used, place = np.unique(second, return_inverse=True)
    scores = np.log(np.maximum(soft.probabilities, FLOOR)).astype(np.float64)[own]
    probabilities = softmax(scores + trees.scores(features.values[used])[place.reshape(-1)])
    best, probability = decide(probabilities, base.arrays.get("groups"))
    return labels_of_rows(best, probability, probabilities, combination)
