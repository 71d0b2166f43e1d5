"""Segmentation of off-ground points into objects, reference objects and segmentation scores."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TypedDict

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.parameter_groups import parse_groups
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_results import GroundMask
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.geometry.sorting import rank_integers
from mlsroad_pipeline.algorithms.segmentation.cut_parameters import NormalizedCutParameters
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import cluster_points, segment
from mlsroad_pipeline.algorithms.segmentation.numbering import number_objects
from mlsroad_pipeline.algorithms.segmentation.pole_parameters import POLE_REFINEMENT, PoleRefinementParameters
from mlsroad_pipeline.algorithms.segmentation.two_step import TwoStepParameters, segment_two_step
from mlsroad_pipeline.algorithms.segmentation.yang_dong import YangDongParameters, segment_yang_dong
from mlsroad_pipeline.algorithms.stages import inliers

OBJECT_TOLERANCE = 0.3
"""Points of one class closer than this are one reference object where a survey has labels but no instances, metres."""


METHODS = (
    "normalized_cut", "normalized_cut_geometry", "normalized_cut_plain", "normalized_cut_printed", "euclidean",
    "yang_dong", "two_step",
)  # fmt: skip
"""Names of the segmentations."""

PLAIN_CUT = NormalizedCutParameters(
    spacing_factor=0.0, max_cut=0.3, low_height=0.0, pole_length=0.0, foot_height=0.0, pole_gap=0.0, plate_gap=0.0
)
"""The cut without intensity that Yu et al. 2016 compare with; `max_cut` is the best of four on six training streets."""

PRINTED_CUT = replace(PLAIN_CUT, sigma_i=1.0, smoothing=0.0, tall_smoothing=0.0)
"""The cut with intensity of Yu et al. 2016, section IV-A and Table I, without the additions of this project."""


class Segments(TypedDict):
    """Objects of a scene, as `segment_scene` returns them.

    Attributes
    ----------
    objects : ndarray of int32, shape (n,)
        Object of each point; -1 for ground, outliers and objects of fewer than `min_points`.
    """

    objects: NDArray[np.int32]


@dataclass(frozen=True)
class SegmentationParameters:
    """Choice and parameters of the segmentation of off-ground points into objects.

    Parameters
    ----------
    method : str, default "normalized_cut"
        One of `METHODS`: the extended normalised cut of Yu et al. 2016, with intensity where the survey has it; the
        same without intensity; the cut without intensity as published; the cut of Yu et al. 2016 with intensity as
        published; Euclidean clusters alone; and the methods of Yang and Dong 2013 and of Zhou et al. 2014.
    normalized_cut : NormalizedCutParameters or mapping
        Parameters of the first two cuts; Euclidean clusters use its distances.
    plain_cut : NormalizedCutParameters or mapping
        Parameters of the published cut without intensity: clusters and cuts, without additions other than the stopping
        rules.
    printed_cut : NormalizedCutParameters or mapping
        Parameters of the published cut with intensity, with the same rules.
    yang_dong : YangDongParameters or mapping
        Parameters of the shape-based segmentation.
    two_step : TwoStepParameters or mapping
        Parameters of the segmentation along and across scan lines.
    min_points : int, default 10
        Objects with fewer points are discarded.

    Raises
    ------
    ParameterError
        If the method is unknown or a number is not positive.
    """

    method: str = "normalized_cut"
    normalized_cut: NormalizedCutParameters = field(default_factory=NormalizedCutParameters)
    plain_cut: NormalizedCutParameters = field(default_factory=lambda: PLAIN_CUT)
    printed_cut: NormalizedCutParameters = field(default_factory=lambda: PRINTED_CUT)
    yang_dong: YangDongParameters = field(default_factory=YangDongParameters)
    two_step: TwoStepParameters = field(default_factory=TwoStepParameters)
    min_points: int = 10

    def __post_init__(self) -> None:
        parse_groups(
            self,
            normalized_cut=NormalizedCutParameters,
            plain_cut=NormalizedCutParameters,
            printed_cut=NormalizedCutParameters,
            yang_dong=YangDongParameters,
            two_step=TwoStepParameters,
        )
        if self.method not in METHODS:
            raise ParameterError(f"segmentation.method must be one of {', '.join(METHODS)}, got {self.method!r}")
        check_positive(self.min_points, "segmentation.min_points")


def segment_scene(
    scene: PointCloud,
    ground: GroundMask,
    parameters: SegmentationParameters,
    refinement: PoleRefinementParameters = POLE_REFINEMENT,
) -> Segments:
    """Segment the off-ground points of a scene into objects.

    Parameters
    ----------
    scene : PointCloud
        The scene.
    ground : GroundMask
        Which points are ground, see `find_ground`.
    parameters : SegmentationParameters
        The method and its parameters.
    refinement : PoleRefinementParameters
        Limits and weights of the separation of poles, gantries and plates by the extended normalised cut.

    Returns
    -------
    Segments
        Object of each point.

    Raises
    ------
    DataError
        If a coordinate is not finite.
    MissingColumnError
        If the method requires the order of the scan and the scene lacks `gps_time` or `scanner`.
    """
    rows = np.flatnonzero(inliers(scene) & ~ground["ground"])
    xyz = np.ascontiguousarray(scene.xyz[rows], dtype=np.float64)
    objects = np.full(len(scene), -1, dtype=np.int32)
    objects[rows] = _segment(scene, rows, xyz, parameters, refinement)
    return {"objects": objects}


def _segment(
    scene: PointCloud,
    rows: NDArray[np.int64],
    xyz: NDArray[np.float64],
    parameters: SegmentationParameters,
    refinement: PoleRefinementParameters,
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
        return segment(xyz, parameters=parameters.plain_cut, min_points=min_points, refinement=refinement)
    cuts = parameters.printed_cut if method == "normalized_cut_printed" else parameters.normalized_cut
    if method == "euclidean":
        return number_objects(cluster_points(xyz, cuts).astype(np.int64), min_points)
    lit = method in ("normalized_cut", "normalized_cut_printed") and "intensity" in scene
    intensity = scene["intensity"][rows] if lit else None
    return segment(xyz, intensity=intensity, parameters=cuts, min_points=min_points, refinement=refinement)


def reference_objects(scene: PointCloud, scheme: ClassScheme) -> tuple[NDArray[np.int32], NDArray[np.int16]]:
    """Return the reference object of each point, and the class of each object.

    Parameters
    ----------
    scene : PointCloud
        A scene with `label` and perhaps `instance`, as in simulated surveys. Without instances the connected components
        of each class are objects.
    scheme : ClassScheme
        The classes.

    Returns
    -------
    instances : ndarray of int32, shape (n,)
        Number of the object, from 1; 0 for none.
    classes : ndarray of int16, shape (number of objects + 1,)
        Majority class of each object's points; -1 for number 0 and where no point is labelled.

    Raises
    ------
    MissingColumnError
        If the scene has no labels.
    UnknownClassError
        If a label is not in the scheme.
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
    """Return which objects a scene owns: those whose lowest point lies in its core.

    Parameters
    ----------
    scene : PointCloud
        The scene.
    objects : ndarray of int, shape (n,)
        Object of each point, 0 to n_objects - 1; negative is none.
    n_objects : int
        Number of objects.

    Returns
    -------
    ndarray of bool, shape (n_objects,)
        True where the scene owns the object; False for objects without points.
    """
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
