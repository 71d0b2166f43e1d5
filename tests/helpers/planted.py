"""Streets of planted poles, cars and bushes for tests of detectors, and detectors of a suitable size."""

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import NormalizedCutParameters
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters
from mlsroad_pipeline.papers.shared.detection.detector import DetectionStages
from mlsroad_pipeline.papers.shared.detection.regions import describe_parts
from mlsroad_pipeline.papers.shared.detection.scoring import DetectionParameters
from mlsroad_pipeline.papers.shared.detection.training import DetectorTraining, train_object_detector
from mlsroad_pipeline.papers.yu2016.bottom_up_top_down.detector import BottomUpTopDownParameters
from mlsroad_pipeline.papers.yu2016.bottom_up_top_down.oriented_points import (
    OrientedPointParameters,
    describe_surfaces,
)
from mlsroad_pipeline.papers.yu2016.hough_forest.detector import HoughForestParameters
from mlsroad_pipeline.papers.yu2016.object_matching.detector import ObjectMatchingParameters

SCHEME = ClassScheme(
    "test", ("pole", "car", "other"), (("light_pole",), ("car",), ("tree",)), ("unlabelled",), (64, 66, 1)
)
WANTED = DetectionParameters(scheme="test", classes=("pole", "car"), min_points=5)
STAGES = DetectionStages(
    GroundParameters(), SegmentationParameters("euclidean", NormalizedCutParameters(tolerance=0.6))
)
FOREST = HoughForestParameters(n_trees=8)
MATCHING = ObjectMatchingParameters(candidates=4, n_turns=6)
SURFACES = OrientedPointParameters(voxel_size=0.15, max_points=30)
DESCRIPTORS = BottomUpTopDownParameters(surfaces=SURFACES, candidates=4, max_images=300)
METHODS = {"hough_forest": FOREST, "object_matching": MATCHING, "bottom_up_top_down": DESCRIPTORS}


def pole(rng):
    height = rng.uniform(5, 7)
    mast = np.column_stack([rng.normal(0, 0.05, (150, 2)), rng.uniform(0.1, height, 150)])
    arm = np.column_stack([rng.uniform(0, 1.5, 60), rng.normal(0, 0.04, 60), np.full(60, height)])
    return np.concatenate([mast, arm]), 0.6


def car(rng):
    size = np.array([4.2, 1.8, 1.4]) * rng.uniform(0.9, 1.1)
    side = rng.integers(0, 3, 500)
    points = rng.uniform(-0.5, 0.5, (500, 3))
    points[side == 0, 2] = 0.5
    points[side == 1, 1] = np.sign(points[side == 1, 1]) * 0.5
    points[side == 2, 0] = np.sign(points[side == 2, 0]) * 0.5
    return points * size + [0, 0, 0.9], 0.3


def bush(rng):
    return rng.normal(0, 0.5, (400, 3)) * rng.uniform(0.7, 1.3, 3) + [0, 0, 1.6], 0.1


def street(rng, n=6, *, intensity=True):
    """Poles, cars and bushes in a row, each rotated at random, without ground."""
    parts, labels, values = [], [], []
    for place in range(3 * n):
        points, bright = (pole, car, bush)[place % 3](rng)
        angle = rng.uniform(0, 2 * np.pi)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        points[:, :2] = points[:, :2] @ turn.T + [8.0 * place, rng.uniform(-2, 2)]
        parts.append(points)
        labels += [TAXONOMY[("light_pole", "car", "tree")[place % 3]]] * len(points)
        values += list(rng.normal(bright, 0.05, len(points)))
    xyz = np.concatenate(parts)
    numbers = np.repeat(np.arange(3 * n), [len(p) for p in parts]).astype(np.int32)
    columns = {"label": np.array(labels, np.uint8), "core": np.ones(len(xyz), bool)}
    if intensity:
        columns["intensity"] = np.clip(values, 0, 1).astype(np.float32)
    return PointCloud(xyz, columns), {"objects": numbers}


def described(slug, scene, objects):
    if slug == "bottom_up_top_down":
        return describe_surfaces(scene, objects, parameters=SURFACES)
    return describe_parts(scene, objects, parameters=METHODS[slug].regions)


def trained(slug, scene, objects, labels):
    own = np.ones(len(labels), bool)
    return train_object_detector(
        {"train.a": described(slug, scene, objects)}, {"train.a": {"label": labels, "own": own}},
        DetectorTraining(slug, METHODS[slug], STAGES, WANTED, SCHEME, {}),
    )  # fmt: skip


LABELS = np.array([0, 1, -1], np.int16)
