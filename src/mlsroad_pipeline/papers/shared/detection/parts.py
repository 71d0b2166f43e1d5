"""Description of objects by feature regions, for the Hough forest and the object matching."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.papers.shared.detection.regions import INTENSITY, RegionParameters, describe_regions
from mlsroad_pipeline.papers.shared.detection.types import Description, Segments, object_bounds


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
