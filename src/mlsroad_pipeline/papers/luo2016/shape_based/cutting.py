"""Location, segmentation and features of objects (Golovinskiy, Kim and Funkhouser 2009, sections 4 to 6)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive
from mlsroad_pipeline.algorithms.energy.binary_cut import CutGraph
from mlsroad_pipeline.algorithms.geometry.graphs import connected_components

_CELL = 0.25  # edge of the cells of the map, about the size of a patch, metres


@dataclass(frozen=True)
class CutParameters:
    """Parameters of location and segmentation."""

    # Least distance in plan between two locations, and twice the standard deviation of the map's blur, metres. Larger
    # values find fewer.
    spacing: float = 0.6
    # Candidate background radii at each location, metres, ascending. The smallest that isolates an object is used.
    radii: tuple[float, ...] = (1.0, 2.0, 4.0)
    core: float = 0.3  # Sites within this distance of the location in plan are foreground, metres
    neighbours: int = 8  # Number of nearest sites that each site is linked to (golovinskiy2009: 4)
    link: float = 0.3  # Distance over which the weight of a link falls to 1/e, metres
    # Cost of a foreground site at the radius, in links of length 0. Larger values cut closer to the location.
    background: float = 0.05
    # A cut isolates an object where its links weigh less than this share of the number of foreground sites
    isolated: float = 0.1

    def __post_init__(self) -> None:
        object.__setattr__(self, "radii", tuple(float(radius) for radius in self.radii))
        for name in ("spacing", "core", "link", "background", "isolated"):
            check_positive(getattr(self, name), f"shape_based.cut.{name}")
        if not self.radii or self.radii[0] <= self.core or any(np.diff(self.radii) <= 0):
            raise ParameterError(f"shape_based.cut.radii must ascend from above core = {self.core}, got {self.radii}")
        check_at_least(self.neighbours, 1, "shape_based.cut.neighbours")


def locate(sites: NDArray[np.float64], *, spacing: float) -> NDArray[np.float64]:
    """Return the locations of possible objects."""
    cell = np.floor(sites[:, :2] / _CELL).astype(np.int64)
    cell -= cell.min(axis=0)
    height_map = np.zeros(cell.max(axis=0) + 1)
    np.add.at(height_map, (cell[:, 0], cell[:, 1]), 1.0)
    smooth = gaussian_filter(height_map, 0.5 * spacing / _CELL, mode="constant")
    reach = int(np.ceil(spacing / _CELL))
    peak = (smooth == maximum_filter(smooth, size=2 * reach + 1, mode="constant")) & (smooth > 1e-9)
    value = np.where(peak, smooth, -1.0)[cell[:, 0], cell[:, 1]]
    candidates = np.flatnonzero(value >= 0)
    order = candidates[np.lexsort((candidates, -value[candidates]))]
    _, first = np.unique(cell[order], axis=0, return_index=True)
    chosen = order[np.sort(first)]
    means = [sites[np.all(cell == cell[i], axis=1), :2].mean(axis=0) for i in chosen]
    return np.array(means).reshape(-1, 2)


def link_sites(
    sites: NDArray[np.float64], *, neighbours: int, link: float
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Link each site to its nearest neighbours."""
    k = min(neighbours + 1, len(sites))
    distance, nearest = cKDTree(sites).query(sites, k=k)
    rows = np.repeat(np.arange(len(sites)), k)
    pairs = np.sort(np.column_stack([rows, nearest.ravel()]), axis=1)
    proper = pairs[:, 0] != pairs[:, 1]
    edges, first = np.unique(pairs[proper], axis=0, return_index=True)
    return edges.astype(np.int32), np.exp(-distance.ravel()[proper][first] / link)


def cut_out(
    place: NDArray[np.float64],
    sites: NDArray[np.float64],
    edges: NDArray[np.int32],
    weights: NDArray[np.float64],
    graph: CutGraph,
    parameters: CutParameters,
) -> tuple[NDArray[np.bool_], bool]:
    """Divide the sites around a location into foreground and background."""
    distance = np.linalg.norm(sites[:, :2] - place, axis=1)
    core = distance <= parameters.core
    front = core
    for radius in parameters.radii:
        fixed = core | (distance > radius)
        cost = parameters.background * np.minimum(distance / radius, 1.0)
        i, j = edges[:, 0], edges[:, 1]
        free = ~fixed[i] & ~fixed[j]
        gain = -cost  # of being background rather than foreground
        for a, b in ((i, j), (j, i)):
            border = ~fixed[a] & fixed[b]
            pull = np.where(core[b[border]], weights[border], -weights[border])
            gain += np.bincount(a[border], pull, minlength=len(sites))
        behind = graph.minimize(gain, np.where(free, weights, 0.0), fixed)
        front = core | ~(behind | fixed)
        if weights[front[i] != front[j]].sum() < parameters.isolated * np.count_nonzero(front):
            return front, True
    return front, False


def segment_objects(sites: NDArray[np.float64], parameters: CutParameters) -> NDArray[np.int32]:
    """Segment off-ground sites into objects.

    Locations within an object that an earlier cut isolated are skipped. A site in several foregrounds belongs to the
    foreground of the nearest location in plan.
    """
    if len(sites) == 0:
        return np.zeros(0, np.int32)
    places = locate(sites, spacing=parameters.spacing)
    edges, weights = link_sites(sites, neighbours=parameters.neighbours, link=parameters.link)
    owner, nearest = np.full(len(sites), -1, np.int64), np.full(len(sites), np.inf)
    sealed = np.zeros(len(sites), np.bool_)
    tree = cKDTree(sites[:, :2])
    closest = tree.query(places)[1]
    place_of = np.full(len(sites), -1, np.int32)
    start, incident = _rows(edges, len(sites))
    for number, around in enumerate(tree.query_ball_point(places, parameters.radii[-1] * 1.25)):
        if sealed[closest[number]]:
            continue
        rows = np.sort(np.asarray(around, dtype=np.int64))
        place_of[rows] = np.arange(len(rows))
        own = np.concatenate([incident[start[row] : start[row + 1]] for row in rows])
        local = place_of[edges[own]]
        inside = own[(local >= 0).all(axis=1)]
        local = place_of[edges[inside]]
        graph = CutGraph(local, len(rows))
        front, isolated = cut_out(places[number], sites[rows], local, weights[inside], graph, parameters)
        sealed[rows[front]] |= isolated
        distance = np.linalg.norm(sites[rows, :2] - places[number], axis=1)
        better = front & (distance < nearest[rows])
        owner[rows[better]], nearest[rows[better]] = number, distance[better]
        place_of[rows] = -1
    together = edges[owner[edges[:, 0]] == owner[edges[:, 1]]]
    rest = together[owner[together[:, 0]] < 0]
    leftover = connected_components(rest, n_nodes=len(sites)) + len(places)
    _, first, member = np.unique(np.where(owner >= 0, owner, leftover), return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int32)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[member]


def _rows(edges: NDArray[np.int32], n_nodes: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the edges sorted by first node, and the index of the first edge of each node."""
    order = np.argsort(edges[:, 0], kind="stable")
    return np.searchsorted(edges[order, 0], np.arange(n_nodes + 1)), order


SPIN_RADII = (0.0, 0.25, 0.5, 1.0, 2.0, np.inf)
SPIN_HEIGHTS = (-np.inf, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0, np.inf)
"""Edges of the spin image's bins, metres: from the vertical axis through the object's mean, and above the ground."""
CONTEXT_RADII = (2.0, 5.0, 15.0)
"""Distances in plan within which other objects and their sites are counted, metres."""


def _grouped_means(values: NDArray[np.float64], owner: NDArray[np.int32], sizes: NDArray[np.float64]) -> NDArray:
    """Return the means of columns per object."""
    sums = np.empty((len(sizes), values.shape[1]))
    for k in range(values.shape[1]):
        sums[:, k] = np.bincount(owner, values[:, k], len(sizes))
    return sums / sizes[:, None]


def _shape(sites: NDArray[np.float64], owner: NDArray[np.int32], sizes: NDArray[np.float64]) -> list[NDArray]:
    """Return extents along the horizontal axes, standard deviations, shape features and slopes of each object."""
    means = _grouped_means(sites, owner, sizes)
    offset = sites - means[owner]
    products = (offset[:, :, None] * offset[:, None, :]).reshape(-1, 9)
    covariance = _grouped_means(products, owner, sizes).reshape(-1, 3, 3)
    values, axes = np.linalg.eigh(covariance)
    spread = np.sqrt(np.maximum(values, 0.0))
    largest = np.maximum(spread[:, 2], 1e-9)
    _, plan_axes = np.linalg.eigh(covariance[:, :2, :2])
    along = np.einsum("nk,nkj->nj", offset[:, :2], plan_axes[owner])
    extents = []
    for j in (1, 0):
        low, high = np.full(len(sizes), np.inf), np.full(len(sizes), -np.inf)
        np.minimum.at(low, owner, along[:, j])
        np.maximum.at(high, owner, along[:, j])
        extents.append(high - low)
    shares = [(spread[:, 2] - spread[:, 1]) / largest, (spread[:, 1] - spread[:, 0]) / largest, spread[:, 0] / largest]
    return [*extents, *spread.T, *shares, np.abs(axes[:, 2, 2]), np.abs(axes[:, 2, 0])]


def _heights(height: NDArray[np.float64], owner: NDArray[np.int32], sizes: NDArray[np.float64]) -> list[NDArray]:
    """Return minimum, mean, maximum, range and standard deviation of the heights of each object."""
    mean = np.bincount(owner, height, len(sizes)) / sizes
    spread = np.sqrt(np.bincount(owner, (height - mean[owner]) ** 2, len(sizes)) / sizes)
    low, high = np.full(len(sizes), np.inf), np.full(len(sizes), -np.inf)
    np.minimum.at(low, owner, height)
    np.maximum.at(high, owner, height)
    return [low, mean, high, high - low, spread]


def _spin_images(
    sites: NDArray[np.float64], height: NDArray[np.float64], owner: NDArray[np.int32], sizes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the share of each object's sites per ring around its axis and per height (Johnson and Hebert 1999)."""
    means = _grouped_means(sites[:, :2], owner, sizes)
    ring = np.searchsorted(SPIN_RADII[1:-1], np.linalg.norm(sites[:, :2] - means[owner], axis=1), side="right")
    level = np.searchsorted(SPIN_HEIGHTS[1:-1], height, side="right")
    n_bins = (len(SPIN_RADII) - 1) * (len(SPIN_HEIGHTS) - 1)
    cells = owner.astype(np.int64) * n_bins + ring * (len(SPIN_HEIGHTS) - 1) + level
    return np.bincount(cells, minlength=len(sizes) * n_bins).reshape(-1, n_bins) / sizes[:, None]


def _context(sites: NDArray[np.float64], owner: NDArray[np.int32], sizes: NDArray[np.float64]) -> list[NDArray]:
    """Count the other objects and the other sites around each object in plan."""
    means = _grouped_means(sites[:, :2], owner, sizes)
    objects, everything = cKDTree(means), cKDTree(sites[:, :2])
    columns = []
    for radius in CONTEXT_RADII:
        inside = np.linalg.norm(sites[:, :2] - means[owner], axis=1) <= radius
        own = np.bincount(owner[inside], minlength=len(sizes))
        columns.append(objects.query_ball_point(means, radius, return_length=True) - 1.0)
        columns.append(np.log1p(everything.query_ball_point(means, radius, return_length=True) - own))
    return columns


def describe_objects(
    sites: NDArray[np.float64], height: NDArray[np.floating], appearance: NDArray[np.floating], owner: NDArray[np.int32]
) -> NDArray[np.float32]:
    """Return the features of each object."""
    if len(sites) == 0:
        return np.zeros((0, 1), np.float32)
    sizes = np.bincount(owner).astype(np.float64)
    place = sites - sites.mean(axis=0)
    levels = height.astype(np.float64)
    columns = [np.log(sizes), *_shape(place, owner, sizes), *_heights(levels, owner, sizes)]
    columns += [*_spin_images(place, levels, owner, sizes).T, *_context(place, owner, sizes)]
    columns += [*_grouped_means(appearance.astype(np.float64), owner, sizes).T]
    return np.stack(columns, axis=1).astype(np.float32)
