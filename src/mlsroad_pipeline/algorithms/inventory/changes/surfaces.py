"""Changes of surfaces: M3C2 distances with their level of detection, their raster, and areas of significant change.

M3C2 and its level of detection are those of Lague et al. (2013), computed by py4dgeo.
"""

import logging
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from scipy.ndimage import label as connected
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError

SURFACES = ("road", "kerb", "facade")
"""Surfaces in the order of their numbers."""
CELL = 0.5
"""Edge of the cells of rasters and areas, metres."""
MOST_CELLS = 25_000_000
"""Largest number of cells of a raster; the edge grows beyond it."""
LEAST_POINTS, LEAST_SIGNIFICANT = 2, 0.6
"""Fewest core points of a cell of significant change, and the share of them with one."""
LEAST_CELLS = 3
"""Fewest connected cells of an area."""


@dataclass(frozen=True)
class M3C2Parameters:
    """Parameters of M3C2, metres."""

    spacing: float = 0.25  # Distance between core points
    cylinder: float = 0.25  # Radius of the cylinders in which distances are measured
    normal: float = 0.5  # Radius around a core point from which its normal is computed
    reach: float = 1.0  # Largest distance along the normal


class SurfaceDistances(NamedTuple):
    """M3C2 distances of core points."""

    xyz: NDArray[np.float64]  # Core points, shape (n, 3), metres
    surface: NDArray[np.uint8]  # Number of the surface of each in `SURFACES`
    distance: NDArray[np.float64]  # Metres along the normal, NaN where not measured; facades: towards the path
    detection: NDArray[np.float64]  # Level of detection at 95 %, metres

    @property
    def significant(self) -> NDArray[np.bool_]:
        """Core points whose distance is larger than their level of detection."""
        return np.abs(self.distance) > self.detection


def py4dgeo() -> Any:
    """Return the library; ParameterError where it is not installed."""
    try:
        library = import_module("py4dgeo")  # optional, and it takes seconds to load
    except ImportError as error:
        raise ParameterError(
            "surfaces are compared by py4dgeo, which is not installed: install it (pip install "
            "'mlsroad_pipeline[change]'), or leave them out with --no-surfaces"
        ) from error
    # Its own handlers print progress on standard output and into a file of the working folder.
    logger = logging.getLogger("py4dgeo")
    logger.setLevel(logging.WARNING)
    for handler in logger.handlers[:]:
        logger.removeHandler(handler)
    return library


def surface_distances(
    first: NDArray[np.float64],
    second: NDArray[np.float64],
    core: NDArray[np.float64],
    surface: NDArray[np.uint8],
    path: NDArray[np.float64] | None,
    *,
    registration_error: float,
    parameters: M3C2Parameters,
) -> SurfaceDistances:
    """Return the M3C2 distances from the earlier to the later points at core points, positive above the road.

    Normals of facades point, and their distances are positive, towards the path; `registration_error` in metres is a
    part of the level of detection.
    """
    library = py4dgeo()
    if not (len(first) and len(second) and len(core)):
        nothing = np.full(len(core), np.nan)
        return SurfaceDistances(core, surface, nothing, nothing.copy())
    origin = np.floor(first.min(axis=0))
    epochs = tuple(library.Epoch(np.ascontiguousarray(points - origin)) for points in (first, second))
    given = {"epochs": epochs, "corepoints": np.ascontiguousarray(core - origin), "cyl_radius": parameters.cylinder}
    given |= {"max_distance": parameters.reach, "registration_error": registration_error}
    normals = np.array(library.M3C2(normal_radii=[parameters.normal], **given).directions())
    facade = surface == SURFACES.index("facade")
    if path is not None and len(path) and facade.any():
        _, near = cKDTree(path[:, :2]).query(core[facade, :2])
        away = ((path[near] - core[facade]) * normals[facade]).sum(axis=1) < 0
        normals[np.flatnonzero(facade)[away]] *= -1.0
    distance, uncertainty = library.M3C2(corepoint_normals=normals, **given).run()
    return SurfaceDistances(core, surface, np.array(distance), np.array(uncertainty["lodetection"]))


class Raster(NamedTuple):
    """Median distance of the core points of each cell, rows from north to south; NaN without a distance."""

    values: NDArray[np.float32]
    west: float
    north: float  # Corner of the first cell, metres
    edge: float  # Of a cell, metres


def distance_raster(found: SurfaceDistances) -> Raster | None:
    """Return the raster of the distances of road and kerbs; None without any."""
    rows = np.flatnonzero(np.isfinite(found.distance) & (found.surface != SURFACES.index("facade")))
    if not len(rows):
        return None
    xy, edge = found.xyz[rows, :2], CELL
    while np.prod(np.ptp(xy, axis=0) / edge + 2) > MOST_CELLS:
        edge *= 2
    west, south = np.floor(xy.min(axis=0) / edge) * edge
    column, row = np.floor((xy - [west, south]) / edge).astype(np.int64).T
    values = np.full((row.max() + 1, column.max() + 1), np.nan, dtype=np.float32)
    median = pd.Series(found.distance[rows]).groupby([row, column]).median()
    values[median.index.get_level_values(0), median.index.get_level_values(1)] = median
    return Raster(values[::-1].copy(), float(west), float(south + edge * len(values)), edge)


def changed_areas(found: SurfaceDistances) -> tuple[pd.DataFrame, NDArray[np.object_]]:
    """Return areas of significant change: connected cells in plan of one surface and direction, and their polygons.

    Distances, and the level of detection, are medians in metres; the area of facades is that in plan.
    """
    records: list[dict[str, Any]] = []
    shapes: list[Any] = []
    measured = np.isfinite(found.distance)
    for number, name in enumerate(SURFACES):
        for way in (-1, 1):
            rows = np.flatnonzero(measured & (found.surface == number))
            for part in _connected(found, rows, way):
                own = part[found.significant[part] & (np.sign(found.distance[part]) == way)]
                cells = np.unique(np.floor(found.xyz[part, :2] / CELL).astype(np.int64), axis=0) * CELL
                shape = shapely.union_all(shapely.box(*cells.T, *(cells + CELL).T))
                distance = found.distance[own]
                records.append(
                    {
                        "surface": name,
                        "area": float(shape.area),
                        "mean_distance": float(distance.mean()),
                        "largest_distance": float(distance[np.abs(distance).argmax()]),
                        "detection": float(np.median(found.detection[own])),
                        "core_points": len(own),
                    }
                )
                shapes.append(shape if shape.geom_type == "MultiPolygon" else shapely.MultiPolygon([shape]))
    columns = ["surface", "area", "mean_distance", "largest_distance", "detection", "core_points"]
    table = pd.DataFrame(records, columns=columns).astype({"surface": object, "core_points": np.int64})
    polygons = np.empty(len(shapes), dtype=object)
    polygons[:] = shapes
    return table, polygons


def _connected(found: SurfaceDistances, rows: NDArray[np.int64], way: int) -> list[NDArray[np.int64]]:
    """Return the core points of connected cells whose distances are significant and of one sign."""
    if not len(rows):
        return []
    cell = np.floor(found.xyz[rows, :2] / CELL).astype(np.int64)
    cells, owner, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    owner = owner.reshape(-1)
    hit = found.significant[rows] & (np.sign(found.distance[rows]) == way)
    share = np.bincount(owner, hit) / count
    chosen = np.flatnonzero((count >= LEAST_POINTS) & (share >= LEAST_SIGNIFICANT))
    if not len(chosen):
        return []
    low = cells[chosen].min(axis=0)
    grid = np.zeros(cells[chosen].max(axis=0) - low + 1, dtype=np.bool_)
    grid[tuple((cells[chosen] - low).T)] = True
    parts, n_parts = connected(grid, structure=np.ones((3, 3)))
    of_cell = np.zeros(len(cells), dtype=np.int64)
    of_cell[chosen] = parts[tuple((cells[chosen] - low).T)]
    sizes = np.bincount(of_cell, minlength=n_parts + 1)
    return [rows[of_cell[owner] == k] for k in range(1, n_parts + 1) if sizes[k] >= LEAST_CELLS]
