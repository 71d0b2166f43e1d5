"""What holds for every stateless kernel: a registry of them, and relations between their results on changed inputs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array
from sklearn.metrics import adjusted_rand_score

from mlsroad_pipeline.algorithms.exceptions import DataError
from mlsroad_pipeline.algorithms.features.accumulation_images import compute_images
from mlsroad_pipeline.algorithms.features.eigen import compute_eigen_features
from mlsroad_pipeline.algorithms.features.fpfh import compute_fpfh
from mlsroad_pipeline.algorithms.features.spin_image import compute_spin_images
from mlsroad_pipeline.algorithms.features.supervoxel_features import compute_supervoxel_features
from mlsroad_pipeline.algorithms.ground.surface import height_above_ground
from mlsroad_pipeline.algorithms.ground.upward_growing import classify_ground
from mlsroad_pipeline.algorithms.image_labels.camera import Camera
from mlsroad_pipeline.algorithms.image_labels.projection import project_points
from mlsroad_pipeline.algorithms.image_labels.visibility import DepthBuffer, HiddenPointRemoval, visible_points
from mlsroad_pipeline.algorithms.outliers import keep_inliers
from mlsroad_pipeline.algorithms.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.scene_stages import (
    FeatureParameters,
    GroundParameters,
    SupervoxelParameters,
    build_supervoxels,
    describe_supervoxels,
    find_ground,
)
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import NormalizedCutParameters, segment
from mlsroad_pipeline.algorithms.segmentation.spacing import cluster_by_spacing
from mlsroad_pipeline.algorithms.segmentation.two_step import segment_two_step
from mlsroad_pipeline.algorithms.segmentation.yang_dong import segment_yang_dong
from mlsroad_pipeline.algorithms.supervoxels.vccs import segment_supervoxels

DIRECTED = ("nx", "ny", "direction_x", "direction_y")
"""Features that turn with the points."""

UTM = np.array([500_000.0, 5_800_000.0, 300.0])


@dataclass(frozen=True)
class Kernel:
    """A function of coordinates, and what its result keeps.

    Attributes
    ----------
    run : callable
        Coordinates to arrays.
    threads : bool
        Whether it takes `n_threads`.
    partition : bool
        Whether its first array numbers groups of points, so that only the groups count.
    shift : float
        Share of the points whose result may change when all are moved to UTM coordinates: the lattice of its voxels
        stays where it is.
    turn : float or None
        The same for a quarter turn about the z axis; None where groups are numbered in another order then.
    permute : float
        The same for another order of the points.
    minimum : int
        The fewest points that it takes.
    tolerance : float
        What a number may change by when points are moved or turned, beside two thousandths: neighbourhoods made of
        voxels change by the points at a border.
    """

    run: Callable[..., tuple[Any, ...]]
    threads: bool = False
    partition: bool = False
    shift: float = 0.0
    turn: float | None = 0.0
    permute: float = 0.0
    minimum: int = 0
    tolerance: float = 0.0


def _ground(xyz, **options):
    return (classify_ground(xyz, **options),)


def _height(xyz, **options):
    return (height_above_ground(xyz, xyz[:, 2] - xyz[:, 2].min(initial=np.inf) < 0.05, **options),)


def _supervoxels(xyz, **options):
    found = segment_supervoxels(xyz, voxel_size=0.2, seed_resolution=0.6, **options)
    return found.labels, found.centroids, found.adjacency


def _eigen(xyz, **options):
    found = compute_eigen_features(xyz, radius=0.5, **options)
    return tuple(found[name] for name in sorted(found) if name not in DIRECTED)


def _nearest_eigen(xyz, **options):
    found = compute_eigen_features(xyz, k=12, **options)
    return tuple(found[name] for name in sorted(found) if name not in DIRECTED)


def _outward(xyz):
    """Return normals that point away from the middle, and so turn with the points."""
    known = np.nan_to_num(xyz, posinf=0.0)
    away = known - (known.mean(axis=0) if len(xyz) else 0.0)
    length = np.linalg.norm(away, axis=1, keepdims=True)
    return np.divide(away, length, out=np.zeros_like(away, dtype=np.float64), where=length > 0)


def _fpfh(xyz, **options):
    return (compute_fpfh(xyz, _outward(xyz), radius=0.4, **options),)


def _spin(xyz, **options):
    return (compute_spin_images(xyz, _outward(xyz), radius=0.4, **options),)


def _two_step(xyz):
    """Scan lines of two scanners; the time follows from the place, so that it moves with the points."""
    known = np.nan_to_num(xyz, posinf=0.0)
    low = known.min(axis=0) if len(xyz) else np.zeros(3)
    across = np.linalg.norm(known - low, axis=1)
    return (segment_two_step(xyz, gps_time=across, scanner=np.zeros(len(xyz), np.uint8)),)


def _images(xyz, **options):
    return tuple(images.reshape(1, -1) for images in compute_images([xyz], **options))


def _features(xyz):
    """Features of supervoxels that are cells of a metre; cells that touch are neighbours."""
    low = xyz.min(axis=0) if len(xyz) else np.zeros(3)
    cells, labels = np.unique(np.floor(xyz - low + 0.2503).astype(np.int64), axis=0, return_inverse=True)
    steps = np.abs(cells[:, None] - cells[None]).max(axis=2)
    adjacency = csr_array((steps == 1).astype(np.float64))
    labels, height = labels.ravel().astype(np.int32), (xyz[:, 2] - low[2]).astype(np.float32)
    return (compute_supervoxel_features(xyz, labels, adjacency, height_above_ground=height).values,)


def _camera(xyz):
    """A camera 6 m above the middle of the points that looks down."""
    known = np.nan_to_num(xyz, posinf=0.0).astype(np.float64)
    middle = (known.min(axis=0) + known.max(axis=0)) / 2 if known.size and known.shape[1] == 3 else np.zeros(3)
    down = np.diag([1.0, -1.0, -1.0])
    return Camera([[300, 0, 320], [0, 300, 320], [0, 0, 1]], None, down, -down @ (middle + [0, 0, 6]), 641, 641)


def _pixels(xyz):
    return project_points(xyz, _camera(xyz))[:2]


def _seen(method, xyz):
    return (visible_points(xyz, _camera(xyz), method=method),)


def _stages(xyz):
    """All stages that a model needs, from raw coordinates on."""
    scene = PointCloud(xyz)
    ground = find_ground(scene, GroundParameters())
    supervoxels = build_supervoxels(scene, SupervoxelParameters())
    features = describe_supervoxels(scene, ground, supervoxels, FeatureParameters())
    return supervoxels["labels"], ground["ground"], features["values"]


KERNELS = {
    "classify_ground": Kernel(_ground, threads=True, shift=0.02, turn=0.05),
    "height_above_ground": Kernel(_height, shift=0.02, turn=0.02),
    "segment_supervoxels": Kernel(
        _supervoxels, threads=True, partition=True, shift=0.2, turn=0.6, permute=0.05, minimum=1
    ),
    "compute_eigen_features": Kernel(_eigen, threads=True),
    "compute_eigen_features of k": Kernel(_nearest_eigen, threads=True),
    "compute_fpfh": Kernel(_fpfh, threads=True),
    "compute_spin_images": Kernel(_spin, threads=True),
    "compute_images": Kernel(_images, threads=True, turn=None, minimum=1),
    "cluster": Kernel(partial(lambda xyz: (cluster(xyz, tolerance=0.3),)), partition=True),
    # By the spacing of this road all of it would be one cluster, with many cuts that are as good as each other.
    "segment": Kernel(
        lambda xyz: (segment(xyz, parameters=NormalizedCutParameters(spacing_factor=0)),),
        partition=True,
        shift=0.05,
        turn=0.05,
    ),
    "cluster_by_spacing": Kernel(
        lambda xyz: (cluster_by_spacing(xyz, tolerance=0.1, spacing_factor=1.5, max_tolerance=0.5),),
        partition=True,
        shift=0.05,
        turn=0.05,
    ),
    "segment_yang_dong": Kernel(lambda xyz: (segment_yang_dong(xyz),), partition=True, shift=0.1, turn=0.2),
    "segment_two_step": Kernel(_two_step, partition=True, shift=0.1, turn=0.1),
    "keep_inliers": Kernel(lambda xyz: (keep_inliers(xyz, n_neighbors=8, std_ratio=2.0),)),
    "compute_supervoxel_features": Kernel(_features, turn=None, minimum=1, shift=0.02, tolerance=0.15),
    "project_points": Kernel(_pixels, turn=None),
    "visible_points": Kernel(partial(_seen, DepthBuffer()), turn=0.01),
    "visible_points by their hull": Kernel(partial(_seen, HiddenPointRemoval()), shift=0.01, turn=0.1, permute=0.005),
    "stages of a model": Kernel(_stages, partition=True, shift=0.2, turn=None, permute=0.05, minimum=1),
}
registry = pytest.mark.parametrize("kernel", KERNELS.values(), ids=KERNELS)


@pytest.fixture(scope="module")
def xyz():
    """A road, a wall, a pole and a bush: 3,000 points, float64, no two of them alike."""
    rng = np.random.default_rng(7)
    road = np.column_stack([rng.uniform(0, 8, 1500), rng.uniform(0, 6, 1500), rng.normal(0, 0.01, 1500)])
    wall = np.column_stack([rng.uniform(0, 8, 800), rng.normal(6.5, 0.01, 800), rng.uniform(0.05, 3, 800)])
    pole = np.column_stack([rng.normal(4, 0.05, 300), rng.normal(3, 0.05, 300), rng.uniform(0.05, 4, 300)])
    bush = rng.normal([6.5, 1.5, 0.8], 0.25, (400, 3))
    return np.round(np.concatenate([road, wall, pole, bush]), 3)  # millimetres, which survive the move to UTM


def as_bytes(results):
    parts = [[r.data, r.indices, r.indptr] if isinstance(r, csr_array) else [r] for r in results]
    return [array.tobytes() for group in parts for array in group]


def changed_share(kernel, one, other, tolerance=0.0):
    """Share of points whose result differs, as far as a result has one row per point."""
    if kernel.partition:
        return 1.0 - adjusted_rand_score(one[0], other[0])
    worst = 0.0
    for first, second in zip(one, other, strict=True):
        assert first.shape == second.shape and first.dtype == second.dtype
        if first.dtype == np.bool_:
            same = first == second
        else:
            same = np.isclose(first, second, rtol=2e-3, atol=2e-3 + tolerance, equal_nan=True)
        worst = max(worst, float((~same).reshape(len(first), -1).any(axis=1).mean()))
    return worst


@registry
def test_input_is_not_modified(kernel, xyz):
    given = xyz.copy()
    given.flags.writeable = False
    kernel.run(given)
    assert np.array_equal(given, xyz)


@registry
def test_same_input_gives_the_same_bytes(kernel, xyz):
    assert as_bytes(kernel.run(xyz)) == as_bytes(kernel.run(xyz.copy()))


@registry
def test_layout_of_the_array_does_not_matter(kernel, xyz):
    padded = np.zeros((len(xyz), 5))
    padded[:, 1:4] = xyz
    assert as_bytes(kernel.run(padded[:, 1:4])) == as_bytes(kernel.run(xyz))
    assert as_bytes(kernel.run(np.asfortranarray(xyz))) == as_bytes(kernel.run(xyz))


@pytest.mark.parametrize("name", [name for name, kernel in KERNELS.items() if kernel.threads])
def test_threads_give_the_bytes_of_one(name, xyz):
    run = KERNELS[name].run
    assert as_bytes(run(xyz, n_threads=1)) == as_bytes(run(xyz, n_threads=2))


@registry
def test_place_on_earth_does_not_matter(kernel, xyz):
    """Float64 coordinates of UTM size keep their millimetres, so results stay but for points at a voxel's border."""
    assert changed_share(kernel, kernel.run(xyz), kernel.run(xyz + UTM), kernel.tolerance) <= kernel.shift + 0.002


@registry
def test_quarter_turn_does_not_matter(kernel, xyz):
    if kernel.turn is None:
        return
    turned = np.column_stack([-xyz[:, 1], xyz[:, 0], xyz[:, 2]])
    assert changed_share(kernel, kernel.run(xyz), kernel.run(turned)) <= kernel.turn + 0.002


def test_directions_turn_with_the_points(xyz):
    turned = np.column_stack([-xyz[:, 1], xyz[:, 0], xyz[:, 2]])
    one, other = compute_eigen_features(xyz, k=12), compute_eigen_features(turned, k=12)
    for x, y, z in (("nx", "ny", "nz"), ("direction_x", "direction_y", "direction_z")):
        before = np.column_stack([-one[y], one[x], one[z]])
        after = np.column_stack([other[x], other[y], other[z]])
        cosine = np.abs((before * after).sum(axis=1))  # an axis has no sign
        assert (cosine > 0.999).mean() > 0.99


@registry
def test_order_of_the_points_does_not_matter(kernel, xyz):
    order = np.random.default_rng(3).permutation(len(xyz))
    one, other = kernel.run(xyz), kernel.run(xyz[order])
    if len(one[0]) != len(xyz):  # one row per supervoxel, which are numbered as they come
        one, other = ([np.sort(part, axis=0) for part in parts] for parts in (one, other))
        assert changed_share(kernel, one, other) <= 0.002
        return
    moved = [part[order] if getattr(part, "shape", (0,))[0] == len(xyz) else part for part in one]
    assert changed_share(kernel, moved[:1], other[:1]) <= kernel.permute + 0.002


@registry
def test_labels_are_numbered_by_first_point(kernel, xyz):
    labels = kernel.run(xyz)[0]
    if not kernel.partition:
        assert labels.dtype != np.int64
        return
    found = labels[labels >= 0]
    _, first = np.unique(found, return_index=True)
    assert labels.dtype == np.int32 and np.all(np.diff(first) > 0)


@registry
@pytest.mark.parametrize("n_points", [0, 1, 2])
def test_hardly_any_points_are_no_error(kernel, n_points):
    given = np.arange(3.0 * n_points).reshape(n_points, 3)
    if n_points < kernel.minimum:
        with pytest.raises(DataError, match=f"needs at least {kernel.minimum} points, got {n_points}"):
            kernel.run(given)
        return
    results = kernel.run(given)
    per_point = results[0]
    assert len(per_point) == n_points or per_point.ndim == 2


@registry
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_coordinates_that_are_no_numbers_are_named_with_their_row(kernel, xyz, value):
    broken = xyz.copy()
    broken[11, 2] = value
    if kernel.run is _features:  # its labels cannot be made of such points
        labels = np.zeros(len(xyz), dtype=np.int32)
        height = np.zeros(len(xyz), dtype=np.float32)
        with pytest.raises(DataError, match="row 11"):
            compute_supervoxel_features(broken, labels, csr_array((1, 1)), height_above_ground=height)
        return
    with pytest.raises(DataError, match="row 11"):
        kernel.run(broken)


@registry
def test_wrong_shape_is_named(kernel):
    if kernel.run in (_features, _stages, _height):
        return
    with pytest.raises(DataError, match=r"\(n, 3\).*\(4, 2\)"):
        kernel.run(np.zeros((4, 2)))
