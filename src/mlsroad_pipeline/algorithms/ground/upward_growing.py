"""Ground classification by voxel-based upward growing (Yu et al. 2016, section III-A, and its reference [17])."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive
from mlsroad_pipeline.algorithms.geometry.threads import run_ranges
from mlsroad_pipeline.algorithms.ground import blocks
from mlsroad_pipeline.algorithms.ground.growing import LAYERS, label_points, occupy, reaching, rising_regions
from mlsroad_pipeline.algorithms.ground.reference import SurfaceParameters, block_surface, lower_surface


def classify_ground(
    xyz: ArrayLike,
    *,
    voxel_size: float = 0.1,
    block_size: float = 8.0,
    local_height: float = 0.2,
    global_height: float = 0.3,
    reference: Literal["surface", "block"] = "surface",
    base_tolerance: float = 0.03,
    cell_size: float = 1.0,
    surface_slope: float = 0.3,
    surface_step: float = 0.2,
    surface_drop: float = 0.5,
    surface_share: float = 0.2,
    surface_patch: float = 10.0,
    n_threads: int = 1,
) -> NDArray[np.bool_]:
    """Classify ground points by upward growing of voxels.

    The points are partitioned into blocks in the XY plane, and each block into voxels. Every voxel grows upward through
    its nine upper neighbours while they are occupied. A voxel is ground if its region ends at most `global_height`
    above the reference and rises at most `local_height` above the voxel. The foot of a pole thus belongs to the pole.

    The paper measures heights from the lowest point of each block (``reference="block"``; with ``base_tolerance=0``
    exactly its method, with separate blocks). This classifies slopes as objects, and a car roof as ground if no point
    below it was measured. The default measures heights from a robust lower surface (``reference="surface"``), grows
    regions across block borders, and classifies points on the surface as ground.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates in metres, z up; float32 or float64, local or projected.
    voxel_size : float, default 0.1
        Edge of a voxel in metres. Larger voxels bridge gaps between scan lines, but assign more ground around a foot to
        the object. Not given in the paper.
    block_size : float, default 8.0
        Side of a block in metres, rounded to whole cells, at least two. It affects the result only with
        ``reference="block"``: larger blocks contain ground beside wider objects, but tolerate less slope.
    local_height : float, default 0.2
        Maximum height of a region above a ground voxel, metres. Larger values include curbs and rough verges, but also
        the feet of objects.
    global_height : float, default 0.3
        Maximum height of ground above the reference, metres, below 63 voxels. With ``reference="block"`` it must cover
        the height range of the ground within a block.
    reference : {"surface", "block"}, default "surface"
        Reference of the heights: lower surface, or lowest point of the block (the paper).
    base_tolerance : float, default 0.03
        Points less than this above the reference are ground even below an object, metres. 0 assigns the whole voxel of
        a foot to the object.
    cell_size : float, default 1.0
        Side of a cell of the lower surface, metres, rounded to whole voxels.
    surface_slope : float, default 0.3
        Maximum slope of ground without further conditions; steeper ground must continue the slope of its surroundings.
        Larger values misclassify wide low objects.
    surface_step : float, default 0.2
        Unevenness of the ground between cells, metres. Points more than this below the surface are outliers, not
        ground.
    surface_drop : float, default 0.5
        Maximum depth of patches smaller than `surface_patch` below their surroundings, metres.
    surface_share : float, default 0.2
        Fraction of the columns of a cell that must have their lowest point within 0.3 m above the lowest one.
        Outliers below the ground have less support.
    surface_patch : float, default 10.0
        Minimum area of a connected patch of cells that counts as ground level, square metres. If no patch is as large,
        the largest counts.
    n_threads : int, default 1
        Threads over the points; the result does not depend on them. 1 runs in the calling thread.

    Returns
    -------
    ndarray of bool, shape (n,)
        True for ground. Empty without points. A single point is ground.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3) or not finite, or spans more than 1e5 m in z or 2**31 blocks in x or y.
    ParameterError
        If a size, slope or `local_height` is not positive, a tolerance is negative, `surface_share` is outside 0 to 1,
        `global_height` is not positive or too large, `reference` is unknown, or `n_threads` is below 1.

    Notes
    -----
    The points are read five times, in scan order without sorting or copying. Points in random order are sorted by block
    into a copy first. Memory is 1 byte per point and 12 to 40 bytes per column of the occupied blocks, part of it per
    thread.

    References
    ----------
    Y. Yu, J. Li, H. Guan, C. Wang, "Automated extraction of urban road facilities using mobile laser scanning data",
    IEEE Transactions on Intelligent Transportation Systems 16(4), 2015 (the method). Y. Yu, J. Li, H. Guan, C. Wang,
    C. Wen, "Bag of contextual-visual words for road scene object detection from mobile laser scanning data", IEEE
    Transactions on Intelligent Transportation Systems, 2016, section III-A (its summary).

    Examples
    --------
    >>> import numpy as np
    >>> x, y = np.meshgrid(np.arange(0, 4, 0.05), np.arange(0, 4, 0.05))
    >>> street = np.column_stack([x.ravel(), y.ravel(), 0.02 * x.ravel()])
    >>> pole = np.column_stack([np.full(50, 2.0), np.full(50, 2.0), 0.1 + np.arange(50) * 0.05])
    >>> is_ground = classify_ground(np.concatenate([street, pole]))
    >>> bool(is_ground[: len(street)].all()), bool(is_ground[len(street) :].any())
    (True, False)
    """
    _check_parameters(voxel_size, local_height, global_height, reference, n_threads)
    check_positive(block_size, "block_size")
    check_positive(cell_size, "cell_size")
    _check_tolerance(base_tolerance, "base_tolerance")
    parameters = SurfaceParameters(surface_slope, surface_step, surface_drop, surface_share, surface_patch)
    _check_surface(parameters)
    points, bounds = blocks.bounds_of(xyz, n_threads)
    if len(points) == 0:
        return np.zeros(0, dtype=np.bool_)
    per_cell = max(1, round(cell_size / voxel_size))
    n_columns = per_cell * max(2, round(block_size / (per_cell * voxel_size)))
    grid = blocks.build_blocks(points, bounds, width=voxel_size, n_columns=n_columns, n_threads=n_threads)
    order = None
    if grid.scattered:
        points, order = blocks.sort_by_block(points, grid, n_threads)
    minima = _column_minima(points, grid, n_threads)
    if reference == "block":
        surface = block_surface(minima)
        around = np.full((len(grid.keys), 9), -1, dtype=np.int32)
    else:
        surface = lower_surface(grid, minima, per_cell=per_cell, parameters=parameters)
        around = blocks.neighbour_slots(grid.keys, grid.table_keys, grid.table_slots, grid.stride)
    del minima
    masks = _occupied_voxels(points, grid, surface, n_threads)
    objects = rising_regions(masks, around, _layers(local_height, voxel_size)) | reaching(
        masks, around, _layers(global_height, voxel_size)
    )
    heights = np.float32(-surface_step), np.float32(base_tolerance), np.float32(global_height)
    volume = (surface, objects)
    labels = run_ranges(lambda *span: label_points(points, span, grid.lookup, volume, heights), len(points), n_threads)
    is_ground = labels[0] if n_threads == 1 else np.concatenate(labels)
    return is_ground if order is None else blocks.in_rows(is_ground, order)


def _layers(height: float, voxel_size: float) -> int:
    """Return the index of the first layer above a height; the tolerance makes 0.3 m three layers of 0.1 m."""
    return int(height / voxel_size + 1e-6) + 1


def _check_parameters(
    voxel_size: float, local_height: float, global_height: float, reference: str, n_threads: int
) -> None:
    for name, value in (("voxel_size", voxel_size), ("local_height", local_height), ("global_height", global_height)):
        check_positive(value, name)
    if _layers(global_height, voxel_size) >= LAYERS:
        raise ParameterError(
            f"global_height {global_height!r} is more than {LAYERS - 2} voxels of {voxel_size!r} m: raise voxel_size"
        )
    if reference not in ("surface", "block"):
        raise ParameterError(f"reference must be 'surface' or 'block', got {reference!r}")
    check_at_least(n_threads, 1, "n_threads")


def _check_surface(parameters: SurfaceParameters) -> None:
    check_positive(parameters.slope, "surface_slope")
    for name in ("step", "drop", "share", "patch"):
        _check_tolerance(getattr(parameters, name), f"surface_{name}")
    if parameters.share > 1:
        raise ParameterError(f"surface_share must be at most 1, got {parameters.share!r}")


def _check_tolerance(value: float, name: str) -> None:
    if not np.isfinite(value) or value < 0:
        raise ParameterError(f"{name} must be a finite number >= 0, got {value!r}")


def _column_minima(points: NDArray[np.floating], grid: blocks.BlockGrid, n_threads: int) -> NDArray[np.float32]:
    """Return the lowest z of each column, as the minimum over the arrays of the threads."""
    shape = (len(grid.keys), grid.n_columns, grid.n_columns)

    def work(*span: int) -> NDArray[np.float32]:
        minima = np.full(shape, np.inf, dtype=np.float32)
        blocks.column_minima(points, span, grid.lookup, minima)
        return minima

    parts = run_ranges(work, len(points), n_threads)
    for part in parts[1:]:
        np.minimum(parts[0], part, out=parts[0])
    return parts[0]


def _occupied_voxels(
    points: NDArray[np.floating], grid: blocks.BlockGrid, surface: NDArray[np.float32], n_threads: int
) -> NDArray[np.uint64]:
    """Return the word of occupied voxels of each column, merged over the threads."""

    def work(*span: int) -> NDArray[np.uint64]:
        masks = np.zeros(surface.shape, dtype=np.uint64)
        occupy(points, span, grid.lookup, surface, masks)
        return masks

    parts = run_ranges(work, len(points), n_threads)
    for part in parts[1:]:
        np.bitwise_or(parts[0], part, out=parts[0])
    return parts[0]
