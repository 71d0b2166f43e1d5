"""Segmentation of a scene into objects, its reference objects, and the scores of the one against the other."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, TypedDict

import numpy as np
import pandas as pd
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.scene_key import group_by_split
from mlsroad_pipeline.algorithms.core.stage_results import GroundMask
from mlsroad_pipeline.algorithms.core.validation import check_positive, parse_groups
from mlsroad_pipeline.algorithms.geometry.sorting import rank_integers
from mlsroad_pipeline.algorithms.metrics.instances import InstanceScores, find_overlaps, score_segmentation
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster, number_objects
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import NormalizedCutParameters, cluster_points, segment
from mlsroad_pipeline.algorithms.segmentation.two_step import TwoStepParameters, segment_two_step
from mlsroad_pipeline.algorithms.segmentation.yang_dong import YangDongParameters, segment_yang_dong
from mlsroad_pipeline.algorithms.stages import inliers

OBJECT_TOLERANCE = 0.3
"""Points of one class closer than this are one reference object where a survey has labels but no instances, metres."""

METHODS = (
    "normalized_cut", "normalized_cut_geometry", "normalized_cut_plain", "normalized_cut_printed", "euclidean",
    "yang_dong", "two_step",
)  # fmt: skip
"""Names of the segmentations: the extended cut with and without intensity, as published, and others; see the manual."""

SEGMENTATION_SCORES = (
    "coverage", "weighted_coverage", "precision", "recall", "over_segmentation", "under_segmentation",
)  # fmt: skip
"""Columns of scores of `segmentation_table`, in order."""

PLAIN_CUT = NormalizedCutParameters(
    spacing_factor=0.0, max_cut=0.3, low_height=0.0, pole_length=0.0, foot_height=0.0, pole_gap=0.0, plate_gap=0.0
)
"""The cut without intensity that Yu et al. 2016 compare with; `max_cut` is the best of four on six training streets."""

PRINTED_CUT = replace(PLAIN_CUT, sigma_i=1.0, smoothing=0.0, tall_smoothing=0.0)
"""The cut with intensity of Yu et al. 2016, section IV-A and Table I, without the additions of this project."""


class Segments(TypedDict):
    """Objects of a scene, as `segment_scene` returns them."""

    objects: NDArray[np.int32]  # object of each point; -1 for ground, outliers and objects below `min_points`


@dataclass(frozen=True)
class SegmentationParameters:
    """Choice and parameters of the segmentation of off-ground points into objects."""

    method: str = "normalized_cut"  # one of `METHODS`
    normalized_cut: NormalizedCutParameters = field(default_factory=NormalizedCutParameters)  # extended; and clusters
    plain_cut: NormalizedCutParameters = field(default_factory=lambda: PLAIN_CUT)  # as published, without intensity
    printed_cut: NormalizedCutParameters = field(default_factory=lambda: PRINTED_CUT)  # as published, with intensity
    yang_dong: YangDongParameters = field(default_factory=YangDongParameters)  # Yang and Dong 2013
    two_step: TwoStepParameters = field(default_factory=TwoStepParameters)  # Zhou et al. 2014
    min_points: int = 10  # points; smaller objects are discarded

    def __post_init__(self) -> None:
        cuts = dict.fromkeys(("normalized_cut", "plain_cut", "printed_cut"), NormalizedCutParameters)
        parse_groups(self, **cuts, yang_dong=YangDongParameters, two_step=TwoStepParameters)
        if self.method not in METHODS:
            raise ParameterError(f"segmentation.method must be one of {', '.join(METHODS)}, got {self.method!r}")
        check_positive(self.min_points, "segmentation.min_points")


def segment_scene(scene: PointCloud, ground: GroundMask, parameters: SegmentationParameters) -> Segments:
    """Segment the points of a scene that are neither ground nor outliers into objects."""
    rows = np.flatnonzero(inliers(scene) & ~ground["ground"])
    xyz = np.ascontiguousarray(scene.xyz[rows], dtype=np.float64)
    objects = np.full(len(scene), -1, dtype=np.int32)
    objects[rows] = _segment(scene, rows, xyz, parameters)
    return {"objects": objects}


def _segment(
    scene: PointCloud, rows: NDArray[np.int64], xyz: NDArray[np.float64], parameters: SegmentationParameters
) -> NDArray[np.int32]:
    """Segment the points of some rows by the chosen method."""
    method, min_points = parameters.method, parameters.min_points
    if method == "yang_dong":
        return segment_yang_dong(xyz, parameters=parameters.yang_dong, min_points=min_points)
    if method == "two_step":
        return segment_two_step(
            xyz, gps_time=scene["gps_time"][rows], scanner=scene["scanner"][rows], parameters=parameters.two_step,
            min_points=min_points,
        )  # fmt: skip
    if method == "normalized_cut_plain":
        return segment(xyz, parameters=parameters.plain_cut, min_points=min_points)
    cuts = parameters.printed_cut if method == "normalized_cut_printed" else parameters.normalized_cut
    if method == "euclidean":
        return number_objects(cluster_points(xyz, cuts), min_points)
    lit = method in ("normalized_cut", "normalized_cut_printed") and "intensity" in scene
    intensity = scene["intensity"][rows] if lit else None
    return segment(xyz, intensity=intensity, parameters=cuts, min_points=min_points)


def reference_objects(scene: PointCloud, scheme: ClassScheme) -> tuple[NDArray[np.int32], NDArray[np.int16]]:
    """Return the reference object of each point, from 1 (0 for none), and the majority class of each object (or -1).

    Without a column `instance`, the connected components of each class are objects. Number 0 has class -1.
    """
    labels = scheme.encode(scene["label"], source=scene.source)
    if "instance" in scene:
        _, numbers = rank_integers(np.append(0, scene["instance"]))
        instances = numbers[1:].astype(np.int32)
    else:
        instances = _components(scene.xyz, labels)
    n = int(instances.max(initial=0)) + 1
    known = (labels != IGNORE) & (instances > 0)
    cells = instances[known].astype(np.int64) * len(scheme) + labels[known]
    table = np.bincount(cells, minlength=n * len(scheme)).reshape(n, len(scheme))
    return instances, np.where(table.any(axis=1), table.argmax(axis=1), IGNORE).astype(np.int16)


def _components(xyz: NDArray[np.floating], labels: NDArray[np.int16]) -> NDArray[np.int32]:
    """Number the connected components of each class from 1."""
    instances = np.zeros(len(xyz), dtype=np.int32)
    last = 0
    for label in np.unique(labels[labels != IGNORE]):
        rows = np.flatnonzero(labels == label)
        component = cluster(xyz[rows], tolerance=OBJECT_TOLERANCE)
        instances[rows] = component + last + 1
        last += int(component.max()) + 1
    return instances


def owned_by_core(scene: PointCloud, objects: NDArray[np.integer], n_objects: int) -> NDArray[np.bool_]:
    """Return which objects, 0 to `n_objects` - 1, have their lowest point in the core; negative numbers are none."""
    owned = np.zeros(n_objects, dtype=np.bool_)
    lowest = _lowest_points(np.ascontiguousarray(scene.xyz[:, 2], dtype=np.float64), objects, n_objects)
    present = lowest >= 0
    owned[present] = scene["core"][lowest[present]]
    return owned


@njit(cache=True, nogil=True)
def _lowest_points(z: NDArray[np.float64], objects: NDArray[np.integer], n_objects: int) -> NDArray[np.int64]:
    """Return the first of the lowest points of each object; -1 where it has none."""
    lowest = np.full(n_objects, -1, np.int64)
    for i in range(len(objects)):
        mine = objects[i]
        if mine >= 0 and (lowest[mine] < 0 or z[i] < z[lowest[mine]]):
            lowest[mine] = i
    return lowest


class SegmentationMeasures(TypedDict):
    """Scores of one scene, as `measure_segmentation` returns them."""

    scores: NDArray[np.float64]  # in the order of `SEGMENTATION_SCORES`
    weights: NDArray[np.int64]  # numbers of instances, of their points, and of segments, over which they are means


def measure_segmentation(
    scene: PointCloud, objects: Segments, *, scheme: ClassScheme, min_points: int
) -> SegmentationMeasures:
    """Score the objects of a scene against the instances of `min_points` or more that it owns."""
    instances, _ = reference_objects(scene, scheme)
    owned = owned_by_core(scene, instances, int(instances.max(initial=0)) + 1)
    mine = np.where(owned[instances], instances, 0)
    scores: InstanceScores = score_segmentation(mine, objects["objects"], min_points=min_points)
    sizes = find_overlaps(mine, objects["objects"]).instance_sizes
    points = int(sizes[sizes >= min_points].sum())
    return {
        "scores": np.array([asdict(scores)[name] for name in SEGMENTATION_SCORES], dtype=np.float64),
        "weights": np.array([scores.n_instances, points, scores.n_segments]),
    }


def segmentation_table(measured: Mapping[str, SegmentationMeasures]) -> pd.DataFrame:
    """Return the scores of each split, from measures by scene: means weighted by the denominator of each score."""
    by = {"coverage": 0, "weighted_coverage": 1, "precision": 2, "recall": 0, "over_segmentation": 0}
    rows: list[dict[str, Any]] = []
    for split, scenes in group_by_split(measured).items():
        scores, weights = np.array([s["scores"] for s in scenes]), np.array([s["weights"] for s in scenes])
        row: dict[str, Any] = {"split": split}
        for column, name in enumerate(SEGMENTATION_SCORES):
            weight = weights[:, by.get(name, 2)] * np.isfinite(scores[:, column])
            total = float((np.nan_to_num(scores[:, column]) * weight).sum())
            row[name] = total / weight.sum() if weight.sum() else np.nan
        rows.append({**row, "n_instances": int(weights[:, 0].sum()), "n_segments": int(weights[:, 2].sum())})
    return pd.DataFrame(rows)
