"""Feature regions of objects and their structural-spectral descriptors (Yu et al. 2016, III-B and III-C)."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_column, check_positive, check_xyz
from mlsroad_pipeline.algorithms.features.eigen_solver import solve_symmetric
from mlsroad_pipeline.algorithms.features.fpfh import compute_fpfh
from mlsroad_pipeline.algorithms.features.normals import compute_normals
from mlsroad_pipeline.algorithms.features.supervoxel_moments import SupervoxelMoments, sum_moments
from mlsroad_pipeline.algorithms.supervoxels.vccs import Supervoxels, segment_supervoxels
from mlsroad_pipeline.papers.shared.detection.types import Description, Segments, object_bounds

N_FEATURES = 20
"""Length of a descriptor: three shape features, an FPFH of 16 bins, the intensity."""

INTENSITY = N_FEATURES - 1
"""Index of the intensity in a descriptor."""

_BINS = 4  # of each of the four pair features: 16 in all


@dataclass(frozen=True)
class RegionParameters:
    """Parameters of feature regions."""

    # voxel_size, seed_resolution: voxel size and seed resolution of the supervoxels, metres (yu2016: 0.05 and 0.1).
    # Larger values give fewer and coarser words.
    voxel_size: float = 0.1
    seed_resolution: float = 0.2
    # A region is a supervoxel with its first-order neighbours, as in the paper, or alone (its Figure 12a)
    pattern: Literal["first_order", "single"] = "first_order"
    normal_radius: float = 0.25  # Neighbourhood of the normals, metres. Not in the paper.
    # Neighbourhood of the FPFH, metres. Larger values describe a larger surrounding of a region. Not in the paper.
    fpfh_radius: float = 0.5

    def __post_init__(self) -> None:
        for name in ("voxel_size", "seed_resolution", "normal_radius", "fpfh_radius"):
            check_positive(getattr(self, name), name)
        if self.pattern not in ("first_order", "single"):
            raise ParameterError(f"pattern must be 'first_order' or 'single', got {self.pattern!r}")


@dataclass(frozen=True)
class FeatureRegions:
    """Feature regions of objects, ordered by object."""

    # a_1D, a_2D, a_3D (equations 5 to 7), the FPFH, which sums to 1, and the intensity (equation 8); 0 without
    # intensity
    descriptors: NDArray[np.float32]
    # First eigenvector of the scatter matrix (equation 10), a unit vector without a sign
    orientations: NDArray[np.float32]
    scales: NDArray[np.float32]  # The longest distance to a first-order neighbour, at least the seed resolution, metres
    centres: NDArray[np.float64]  # Centres of the supervoxels, metres, in the coordinates of the points
    objects: NDArray[np.int32]  # Object of each region

    def __len__(self) -> int:
        """Return the number of regions."""
        return len(self.scales)


def describe_regions(
    xyz: ArrayLike,
    objects: ArrayLike,
    *,
    intensity: ArrayLike | None = None,
    parameters: RegionParameters = RegionParameters(),
    n_threads: int = 1,
) -> FeatureRegions:
    """Segment objects into supervoxels, and describe each with its neighbours.

    Objects are first moved apart by whole voxels, so that neither supervoxels nor neighbourhoods reach from one object
    into another.
    """
    points = check_xyz(xyz).astype(np.float64)
    owner = check_column(objects, len(points), "objects")
    if not np.issubdtype(owner.dtype, np.integer):
        raise DataError(f"objects must be integers, got {owner.dtype}")
    values = None if intensity is None else check_column(intensity, len(points), "intensity").astype(np.float64)
    rows = np.flatnonzero(owner >= 0)
    if len(rows) == 0:
        return _no_regions()
    rows = rows[np.argsort(owner[rows], kind="stable")]
    owner, points = owner[rows].astype(np.int32), points[rows]
    gap = 2.0 * max(parameters.fpfh_radius, parameters.normal_radius, parameters.seed_resolution)
    shift = stand_apart(points, owner, cell=parameters.voxel_size, gap=gap)
    apart = points + shift
    supervoxels = segment_supervoxels(
        apart,
        voxel_size=parameters.voxel_size,
        seed_resolution=parameters.seed_resolution,
        anchor=np.zeros(3),
        n_threads=n_threads,
    )
    first = np.unique(supervoxels.labels, return_index=True)[1]
    own, around = sum_moments(apart, supervoxels.labels, len(supervoxels), supervoxels.adjacency)
    assert around is not None  # an adjacency was given
    region = own if parameters.pattern == "single" else around
    reach = csr_array(supervoxels.adjacency.shape) if parameters.pattern == "single" else supervoxels.adjacency
    descriptors = np.zeros((len(supervoxels), N_FEATURES), dtype=np.float32)
    descriptors[:, :3], orientations = _shape_and_orientation(region, supervoxels.centroids)
    descriptors[:, 3:INTENSITY] = _histograms(supervoxels, reach, parameters, n_threads)
    if values is not None:
        sums = _intensity_sums(values[rows], supervoxels.labels, len(supervoxels))
        descriptors[:, INTENSITY] = _interpolated_intensity(sums, reach.indptr, reach.indices)
    adjacency = supervoxels.adjacency
    scales = _longest_step(supervoxels.centroids, adjacency.indptr, adjacency.indices)
    return FeatureRegions(
        descriptors,
        orientations,
        np.maximum(scales, parameters.seed_resolution).astype(np.float32),
        supervoxels.centroids - shift[first],
        owner[first],
    )


def _no_regions() -> FeatureRegions:
    return FeatureRegions(
        np.zeros((0, N_FEATURES), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.float32),
        np.zeros((0, 3)), np.zeros(0, np.int32),
    )  # fmt: skip


def stand_apart(
    points: NDArray[np.float64], owner: NDArray[np.integer], *, cell: float, gap: float
) -> NDArray[np.float64]:
    """Return translations that place objects side by side along x, so that neighbourhoods of objects do not overlap."""
    starts = np.flatnonzero(np.diff(owner, prepend=-1))
    low = np.minimum.reduceat(points, starts)
    width = np.maximum.reduceat(points[:, 0], starts) - low[:, 0]
    place = np.concatenate([[0.0], np.cumsum(np.ceil((width[:-1] + gap) / cell) + 1)])
    move = np.column_stack(
        [place - np.floor(low[:, 0] / cell), -np.floor(low[:, 1] / cell), -np.floor(low[:, 2] / cell)]
    )
    return np.repeat(move * cell, np.diff(np.append(starts, len(points))), axis=0)


def _shape_and_orientation(
    region: SupervoxelMoments, centres: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Return the shape features of equations 5 to 7 and the first eigenvector of equation 10."""
    n = len(centres)
    values, largest, unused = np.empty((3, n)), np.empty((3, n)), np.empty((3, n))
    solve_symmetric(np.ascontiguousarray(region.covariances), n, values, unused, largest)
    root = np.sqrt(values)
    extended = root[0] > 0
    longest = np.where(extended, root[0], 1.0)
    # A region without extent is volumetric.
    shape = np.column_stack([(root[0] - root[1]) / longest, (root[1] - root[2]) / longest, root[2] / longest])
    shape[~extended] = (0.0, 0.0, 1.0)
    off = (region.centroids - centres).T
    scatter = region.covariances + np.stack(
        [off[0] * off[0], off[0] * off[1], off[0] * off[2], off[1] * off[1], off[1] * off[2], off[2] * off[2]]
    )
    solve_symmetric(np.ascontiguousarray(scatter), n, values, unused, largest)
    orientation = largest.T.astype(np.float32)
    orientation[~(values[0] > 0)] = (0.0, 0.0, 1.0)
    return shape, orientation


def _histograms(
    supervoxels: Supervoxels, reach: csr_array, parameters: RegionParameters, n_threads: int
) -> NDArray[np.float32]:
    """Return the mean FPFH over the voxels of each region, normalised to sum 1; 0 where no voxel has one."""
    voxels = supervoxels.grid.centroids
    normals = compute_normals(voxels, radius=parameters.normal_radius, n_threads=n_threads)
    fpfh = compute_fpfh(
        voxels, normals, radius=parameters.fpfh_radius, n_bins=_BINS, use_distance=True, n_threads=n_threads
    )
    sums = np.zeros((len(supervoxels), fpfh.shape[1]))
    np.add.at(sums, supervoxels.voxel_labels, fpfh)
    total = sums + reach @ sums
    mass = total.sum(axis=1, keepdims=True)
    return np.divide(total, mass, out=np.zeros_like(total), where=mass > 0).astype(np.float32)


def _intensity_sums(values: NDArray[np.float64], labels: NDArray[np.int32], n: int) -> NDArray[np.float64]:
    """Return number, sum, sum of squares, least and greatest intensity of each supervoxel."""
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(low, labels, values)
    np.maximum.at(high, labels, values)
    sums = (np.bincount(labels, weights, n) for weights in (np.ones(len(values)), values, values * values))
    return np.column_stack([*sums, low, high])


def _interpolated_intensity(sums: NDArray[np.float64], indptr: NDArray, indices: NDArray) -> NDArray[np.float64]:
    """Return the intensity of equation 8 with the weights of equation 9; the mean of equal intensities."""
    rows, whole = np.repeat(np.arange(len(sums)), np.diff(indptr)), sums.copy()
    np.add.at(whole[:, :3], rows, sums[indices, :3])
    np.minimum.at(whole[:, 3], rows, sums[indices, 3])
    np.maximum.at(whole[:, 4], rows, sums[indices, 4])
    n, total, squares, low, high = whole.T
    weight = total - n * low
    unequal = weight > 1e-12 * np.maximum(n * high, 1.0)
    return np.divide(squares - low * total, weight, out=total / n, where=unequal)


def _longest_step(centres: NDArray[np.float64], indptr: NDArray, indices: NDArray) -> NDArray[np.float64]:
    rows, out = np.repeat(np.arange(len(centres)), np.diff(indptr)), np.zeros(len(centres))
    np.maximum.at(out, rows, ((centres[rows] - centres[indices]) ** 2).sum(axis=1))
    return np.sqrt(out)


def describe_parts(scene: PointCloud, objects: Segments, *, parameters: RegionParameters) -> dict[str, NDArray]:
    """Describe the objects of a scene by their feature regions, as the visual words do.

    Returns a `Description` with ``descriptors`` (g, 20), ``orientations`` (g, 3) and ``centres`` (g, 3) of the regions.
    """
    regions = describe_regions(scene.xyz, objects["objects"], intensity=scene.get("intensity"), parameters=parameters)
    return {
        "descriptors": regions.descriptors,
        "orientations": regions.orientations,
        "centres": regions.centres,
        "objects": regions.objects,
        "n_objects": np.array(int(objects["objects"].max(initial=-1)) + 1),
        "intensity": np.array("intensity" in scene),
    }


def descriptors_of(parts: Description, *, intensity: bool) -> NDArray[np.float32]:
    """Return the descriptors of parts, float32 (g, 20); with intensity 0 unless `intensity` is set."""
    descriptors = np.ascontiguousarray(parts["descriptors"], dtype=np.float32).copy()
    if not intensity:
        descriptors[:, INTENSITY] = 0.0
    return descriptors


def heights_of(parts: Description) -> NDArray[np.float64]:
    """Return the height of each part above the lowest part of its object, metres, shape (g,)."""
    lowest = np.full(int(parts["n_objects"]), np.inf)
    np.minimum.at(lowest, parts["objects"], parts["centres"][:, 2])
    return parts["centres"][:, 2] - lowest[parts["objects"]]


def relative_centres(parts: Description) -> NDArray[np.float64]:
    """Return centres of parts relative to the mean (x, y) and lowest part (z) of their object, metres, shape (g, 3)."""
    bounds = object_bounds(parts)
    counts = np.diff(bounds)
    sums = np.zeros((len(counts), 2))
    np.add.at(sums, parts["objects"], parts["centres"][:, :2])
    middle = sums / np.maximum(counts, 1)[:, None]
    return np.column_stack([parts["centres"][:, :2] - middle[parts["objects"]], heights_of(parts)])
