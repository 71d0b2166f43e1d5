"""Construction of the hierarchy of superpoints of a scene from its ground, supervoxels and supervoxel features."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.labels import core_labels
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_results import Ground, SupervoxelPartition, SupervoxelTable
from mlsroad_pipeline.algorithms.features.supervoxel_moments import COLOUR_FEATURES, INTENSITY_FEATURES
from mlsroad_pipeline.algorithms.features.surroundings import BALL_FEATURES, describe_balls
from mlsroad_pipeline.algorithms.geometry.sorting import rank_floats, rank_integers
from mlsroad_pipeline.algorithms.geometry.voxels.grid import build_voxel_grid
from mlsroad_pipeline.algorithms.models.superpoint_transformer.graph import (
    Level,
    SuperpointGraph,
    with_histograms,
)
from mlsroad_pipeline.algorithms.models.superpoint_transformer.levels import OWN_FEATURES, build_levels, means
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import N_LEVELS, HierarchyParameters
from mlsroad_pipeline.algorithms.stages import inlier_rows, inliers

SHAPES = ("linearity", "planarity", "scattering", "verticality", "direction_z", "horizontal_linearity")
"""Shape features of a point per radius."""

ATTRIBUTES = ("intensity_rank", "red", "green", "blue")
"""Last features of a point; NaN where a survey lacks them."""


def point_feature_names(parameters: HierarchyParameters) -> list[str]:
    """Return the names of the features of a point."""
    shapes = [f"{name}_{radius:g}m" for radius in parameters.ball_radii for name in SHAPES]
    return [*shapes, "height", *ATTRIBUTES]


def shared_columns(names: NDArray[np.str_]) -> NDArray[np.int64]:
    """Return the columns of a supervoxel table that the network takes: no radiometry, nothing detrended."""
    radiometry = {*COLOUR_FEATURES, *INTENSITY_FEATURES}
    return np.flatnonzero([name not in radiometry and not name.endswith("_detrended") for name in names.tolist()])


def superpoint_feature_names(names: NDArray[np.str_]) -> tuple[list[str], list[str], list[str]]:
    """Return the names of the features of the superpoints of each level, given those of the supervoxel table."""
    shared = [str(names[column]) for column in shared_columns(names)]
    own = list(OWN_FEATURES)
    return [*(f"superpoint_{name}" for name in own), *shared], own, own


def build_graph(
    scene: PointCloud,
    ground: Ground,
    supervoxels: SupervoxelPartition,
    features: SupervoxelTable,
    parameters: HierarchyParameters,
) -> SuperpointGraph:
    """Build the hierarchy of superpoints of a scene."""
    keep = inlier_rows(scene)
    xyz = scene.xyz[keep]
    labels = supervoxels["labels"][keep]
    n = supervoxels["adjacency"].shape[0]
    voxel = build_voxel_grid(xyz, voxel_size=parameters.voxel_size).voxel_of_point.astype(np.int64)
    owner, row = points_of_superpoints(labels, voxel)
    places = means(row, xyz, len(owner))
    values = _describe_points(scene, keep, row, places, ground, parameters)
    height = values[:, len(parameters.ball_radii) * len(SHAPES)].astype(np.float64)
    levels, parents = build_levels(places, height, owner, n, supervoxels["adjacency"], parameters)
    shared = features["values"][:, shared_columns(features["names"])]
    levels[0]["values"] = np.hstack([levels[0]["values"], shared]).astype(np.float32)
    return SuperpointGraph(
        offset=(places - levels[0]["centroid"][owner]).astype(np.float32),
        values=values,
        indptr=np.append(0, np.cumsum(np.bincount(owner, minlength=n))),
        levels=tuple(
            _level(level, parents[i] if i + 1 < N_LEVELS else np.zeros(len(level["centroid"]), np.int32))
            for i, level in enumerate(levels)
        ),
    )


def points_of_superpoints(
    superpoint: NDArray[np.integer], voxel: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the points of level 0, the parts of voxels that lie in one superpoint."""
    n_voxels = int(voxel.max(initial=0)) + 1
    of_voxel = np.full(n_voxels, -1, np.int64)
    if _fill_whole_voxels(superpoint, voxel, of_voxel):  # voxels half as large as those of the superpoints mostly do
        keys, rank_of_voxel = rank_integers(of_voxel * n_voxels + np.arange(n_voxels))
        return keys // n_voxels, rank_of_voxel.take(voxel)
    keys, row = rank_integers(superpoint.astype(np.int64) * n_voxels + voxel)
    return keys // n_voxels, row


@njit(cache=True, nogil=True)
def _fill_whole_voxels(superpoint: NDArray[np.integer], voxel: NDArray[np.int64], of_voxel: NDArray[np.int64]) -> bool:
    """Write the superpoint of each voxel; return False if a voxel has points of several ones, or none."""
    for i in range(len(voxel)):
        of_voxel[voxel[i]] = superpoint[i]
    for i in range(len(voxel)):
        if of_voxel[voxel[i]] != superpoint[i]:
            return False
    lowest = 0
    for v in range(len(of_voxel)):
        lowest = min(lowest, of_voxel[v])
    return lowest >= 0


def count_labels(
    scene: PointCloud, supervoxels: SupervoxelPartition, graph: SuperpointGraph, scheme: ClassScheme
) -> SuperpointGraph:
    """Return the graph with the label histograms of the core points of a training scene."""
    keep = inliers(scene)
    labels = core_labels(scene, scheme)
    known = keep & (labels != IGNORE)
    n, n_classes = len(graph.levels[0]), len(scheme)
    cells = supervoxels["labels"][known].astype(np.int64) * n_classes + labels[known]
    return with_histograms(graph, np.bincount(cells, minlength=n * n_classes).reshape(n, n_classes))


def _describe_points(
    scene: PointCloud,
    keep: NDArray[np.bool_] | slice,
    row: NDArray[np.integer],
    places: NDArray[np.float64],
    ground: Ground,
    parameters: HierarchyParameters,
) -> NDArray[np.float32]:
    """Return the features of the points of level 0, in the order of `point_feature_names`."""
    n, radii = len(places), list(parameters.ball_radii)
    balls = describe_balls(places, places, radii=radii, voxel_size=parameters.ball_voxel_size)
    chosen = [k * len(BALL_FEATURES) + BALL_FEATURES.index(name) for k in range(len(radii)) for name in SHAPES]
    out = np.full((n, len(chosen) + 1 + len(ATTRIBUTES)), np.nan, np.float32)
    out[:, : len(chosen)] = balls.take(chosen, axis=1)
    attributes = out[:, len(chosen) :]
    attributes[:, 0] = means(row, ground["height"][keep, None], n)[:, 0]
    intensity, colours = scene.get("intensity"), scene.get("rgb")
    if intensity is not None:
        attributes[:, 1] = rank(means(row, intensity[keep, None], n)[:, 0])
    if colours is not None:
        attributes[:, 2:] = means(row, colours[keep] / 255.0, n)
    return out


def rank(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rank of each value as a share of the finite values, 0 to 1; NaN stays NaN."""
    finite = np.isfinite(values)
    out = np.full(len(values), np.nan)
    out[finite] = (rank_floats(values[finite]) - 0.5) / max(int(finite.sum()), 1)
    return out


def _level(attributes: dict[str, NDArray], parent: NDArray[np.int32]) -> Level:
    single = {name: attributes[name].astype(np.float32) for name in ("centroid", "normal", "size", "radius", "values")}
    n = len(parent)
    return Level(
        **single,
        parent=parent,
        indptr=attributes["indptr"],
        indices=attributes["indices"],
        histogram=np.empty((n, 0), np.float32),
    )
