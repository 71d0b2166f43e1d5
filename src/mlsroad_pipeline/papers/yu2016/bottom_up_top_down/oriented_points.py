"""Description of objects by evenly spread oriented points and their spin images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_positive, check_xyz
from mlsroad_pipeline.algorithms.features.normals import compute_normals
from mlsroad_pipeline.algorithms.features.spin_image import compute_spin_images
from mlsroad_pipeline.algorithms.geometry.voxels import build_voxel_grid
from mlsroad_pipeline.papers.shared.detection.regions import stand_apart
from mlsroad_pipeline.papers.shared.detection.types import Segments
from mlsroad_pipeline.papers.yu2016.bottom_up_top_down._surfaces import spread_evenly


@dataclass(frozen=True)
class OrientedPointParameters:
    """Parameters of oriented points and spin images."""

    # Points are thinned to one per voxel of this edge, metres, so that near and far surfaces have equal weight
    voxel_size: float = 0.1
    normal_radius: float = 0.3  # Neighbourhood of the normals, metres
    # Neighbourhood of the spin images, metres. Larger describes more of an object and is more sensitive to occlusion.
    image_radius: float = 1.0
    n_radial: int = 9  # Size of the spin images: 153 bins
    n_axial: int = 17  # Size of the spin images: 153 bins
    max_points: int = 40  # Largest number of oriented points of an object, by farthest-point sampling

    def __post_init__(self) -> None:
        for name in ("voxel_size", "normal_radius", "image_radius"):
            check_positive(getattr(self, name), name)
        for name, least in (("n_radial", 2), ("n_axial", 2), ("max_points", 1)):
            if getattr(self, name) < least:
                raise ParameterError(f"{name} must be at least {least}, got {getattr(self, name)!r}")


def describe_surfaces(
    scene: PointCloud, objects: Segments, *, parameters: OrientedPointParameters
) -> dict[str, NDArray]:
    """Describe the objects of a scene by oriented points, each object separately.

    Normals point away from the centre of their object.
    """
    p = parameters
    owner = np.asarray(objects["objects"])
    n = int(owner.max(initial=-1)) + 1
    facts = {"n_objects": np.array(n), "intensity": np.array(False)}
    rows = np.flatnonzero(owner >= 0)
    rows = rows[np.argsort(owner[rows], kind="stable")]
    points, owner = check_xyz(scene.xyz[rows]).astype(np.float64), owner[rows].astype(np.int32)
    if len(rows) == 0:
        images, nothing = np.zeros((0, p.n_radial * p.n_axial), np.float32), np.zeros((0, 3))
        return {"centres": nothing, "normals": nothing, "images": images, "objects": owner, **facts}
    shift = stand_apart(points, owner, cell=p.voxel_size, gap=2.0 * max(p.image_radius, p.normal_radius))
    grid = build_voxel_grid(points + shift, voxel_size=p.voxel_size, anchor=np.zeros(3))
    first = np.unique(grid.voxel_of_point, return_index=True)[1]
    order = np.argsort(owner[first], kind="stable")
    places, back, kinds = grid.centroids[order], shift[first][order], owner[first][order]
    bounds = np.searchsorted(kinds, np.arange(n + 1)).astype(np.int64)
    chosen = spread_evenly(places, bounds, p.max_points)
    normals = compute_normals(places, radius=p.normal_radius)
    sums = np.zeros((n, 3))
    np.add.at(sums, kinds, places)
    middle = sums / np.maximum(np.diff(bounds), 1)[:, None]
    inwards = ((places - middle[kinds]) * normals).sum(axis=1) < 0
    normals = np.where(inwards[:, None], -normals, normals)[chosen]
    images = compute_spin_images(
        places, normals, radius=p.image_radius, n_radial=p.n_radial, n_axial=p.n_axial, queries=places[chosen]
    )
    described = {"centres": (places - back)[chosen], "normals": normals, "images": images}
    return {**described, "objects": kinds[chosen], **facts}
