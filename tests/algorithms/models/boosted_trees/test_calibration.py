"""Confidences of boosted trees on streets that they were not trained on."""

from dataclasses import replace

import numpy as np
from references.patches import SCHEME, street

from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.metrics.calibration import reliability_table
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import BoostedTreesParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.sampling import training_voxels
from mlsroad_pipeline.algorithms.models.boosted_trees.training import fit
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.algorithms.stages import find_ground

QUICK = BoostedTreesParameters(smoothing=0.0)
WRONG = 0.3


def doubtful_street(seed):
    """Return a street where the two most frequent classes are exchanged in a part of the cells of 0.5 m."""
    cloud = street(seed)
    classes, counts = np.unique(cloud["label"], return_counts=True)
    first, second = classes[np.argsort(-counts)[:2]]
    cells = np.floor(cloud.xyz[:, :2] / 0.5).astype(np.int64) % 1000
    exchanged = np.random.default_rng(seed).random((1000, 1000))[cells[:, 0], cells[:, 1]] < WRONG
    label = cloud["label"].copy()
    label[exchanged & (cloud["label"] == first)] = second
    label[exchanged & (cloud["label"] == second)] = first
    return replace(cloud, columns={**cloud.columns, "label": label})


def voxels_of(seed):
    cloud = doubtful_street(seed)
    return training_voxels(cloud, find_ground(cloud, GroundParameters()), parameters=QUICK, scheme=SCHEME)


def model(rounds):
    parameters = replace(QUICK, rounds=rounds, checkpoint_rounds=rounds)
    scenes = [voxels_of(seed) for seed in range(3)]
    return fit(scenes, parameters=parameters, ground=GroundParameters(), scheme=SCHEME, trained_on={})


def calibration_error(bundle):
    total = None
    for seed in (8, 9):
        cloud = doubtful_street(seed)
        truth = SCHEME.encode(cloud["label"], source="street")
        label, confidence = label_cloud(bundle, cloud)
        table = reliability_table(confidence[truth >= 0], (label == truth)[truth >= 0])
        total = table if total is None else total + table
    assert 0.6 < total.hits.sum() / total.counts.sum() < 0.9  # labels cannot be right where they are doubtful
    return total.calibration_error


def test_confidence_is_the_probability_that_the_label_is_right():
    assert calibration_error(model(20)) < 0.06
