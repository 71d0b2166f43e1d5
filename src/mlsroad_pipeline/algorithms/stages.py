"""What every method needs of a scene, stage by stage: ground, heights, supervoxels, features.

Each stage is one function from a scene and the results before it to a mapping of arrays whose rows are aligned with
the scene's points or with its supervoxels. The pipelines store the results; a registered model runs the same functions
in memory on a cloud that it has never seen.

Points that the outlier filter has marked (column `outlier`) take no part: they are no ground, their height is NaN and
their supervoxel is -1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.features.supervoxel_features import SupervoxelFeatures, compute_supervoxel_features
from mlsroad_pipeline.algorithms.ground.surface import height_above_ground
from mlsroad_pipeline.algorithms.ground.upward_growing import classify_ground
from mlsroad_pipeline.algorithms.supervoxels.vccs import segment_supervoxels


@dataclass(frozen=True)
class GroundParameters:
    """Parameters of the ground filter; `classify_ground` says what each does.

    Parameters
    ----------
    voxel_size : float, default 0.1
        Edge of a voxel, metres.
    block_size : float, default 8.0
        Edge of a block in plan, metres.
    local_height : float, default 0.2
        How far a region may climb above its own bottom, metres.
    global_height : float, default 0.3
        How far ground may lie above the reference surface, metres.
    reference : {"surface", "block"}, default "surface"
        Robust lower surface, or the lowest point of a block as in the paper.
    surface_cell : float, default 0.5
        Cell of the surface that heights are measured from, metres.

    Raises
    ------
    ParameterError
        If a length is not above zero or `reference` is unknown.
    """

    voxel_size: float = 0.1
    block_size: float = 8.0
    local_height: float = 0.2
    global_height: float = 0.3
    reference: Literal["surface", "block"] = "surface"
    surface_cell: float = 0.5

    def __post_init__(self) -> None:
        for name in ("voxel_size", "block_size", "local_height", "global_height", "surface_cell"):
            check_positive(getattr(self, name), f"ground_removal.{name}")
        if self.reference not in ("surface", "block"):
            raise ParameterError(f"ground_removal.reference must be 'surface' or 'block', got {self.reference!r}")


@dataclass(frozen=True)
class SupervoxelParameters:
    """Parameters of VCCS; `segment_supervoxels` says what each does.

    Parameters
    ----------
    voxel_size : float, default 0.2
        Edge of a voxel, metres (tomic2019: 0.2).
    seed_resolution : float, default 0.6
        Distance between seeds, metres (tomic2019: 0.6).
    colour_weight : float, default 0.0
        Weight of colour (tomic2019 uses space and normals only).
    spatial_weight : float, default 0.4
        Weight of distance in space.
    normal_weight : float, default 1.0
        Weight of the difference of normals.
    distance : {"papon", "tomic"}, default "papon"
        How distance in space is normalised.

    Raises
    ------
    ParameterError
        If a length is not above zero, a weight is negative or `distance` is unknown.
    """

    voxel_size: float = 0.2
    seed_resolution: float = 0.6
    colour_weight: float = 0.0
    spatial_weight: float = 0.4
    normal_weight: float = 1.0
    distance: Literal["papon", "tomic"] = "papon"

    def __post_init__(self) -> None:
        for name in ("voxel_size", "seed_resolution"):
            check_positive(getattr(self, name), f"supervoxelise.{name}")
        for name in ("colour_weight", "spatial_weight", "normal_weight"):
            if not np.isfinite(getattr(self, name)) or getattr(self, name) < 0:
                raise ParameterError(f"supervoxelise.{name} must be a number >= 0, got {getattr(self, name)!r}")
        if self.distance not in ("papon", "tomic"):
            raise ParameterError(f"supervoxelise.distance must be 'papon' or 'tomic', got {self.distance!r}")


@dataclass(frozen=True)
class FeatureParameters:
    """Which supervoxel features; `compute_supervoxel_features` says what each parameter does.

    Parameters
    ----------
    detrend : bool, default True
        Whether the detrended part of equations 2 and 3 is appended.
    region : {"own", "neighborhood", "both"}, default "both"
        Whose points give shape and orientation (tomic2019: the supervoxel's own).
    column_size : float, default 0.5
        Raster cell of the column features, metres.
    relief_radius : float, default 5.0
        How far the lowest point is sought, metres.
    ball_radii : sequence of float, default [0.5, 1.0, 2.0]
        Radii of the balls whose shape is described, metres.
    ball_voxel_size : float, default 0.2
        Edge of the voxels in them, metres.
    footprint_radii : sequence of float, default [1.5, 3.0, 6.0]
        Radii within which the columns around are described, metres.

    Raises
    ------
    ParameterError
        If a length is not above zero or `region` is unknown.
    """

    detrend: bool = True
    region: Literal["own", "neighborhood", "both"] = "both"
    column_size: float = 0.5
    relief_radius: float = 5.0
    ball_radii: Sequence[float] = field(default_factory=lambda: [0.5, 1.0, 2.0])
    ball_voxel_size: float = 0.2
    footprint_radii: Sequence[float] = field(default_factory=lambda: [1.5, 3.0, 6.0])

    def __post_init__(self) -> None:
        for name in ("column_size", "relief_radius"):
            check_positive(getattr(self, name), f"features.{name}")
        if self.region not in ("own", "neighborhood", "both"):
            raise ParameterError(f"features.region must be 'own', 'neighborhood' or 'both', got {self.region!r}")


def inliers(scene: PointCloud) -> NDArray[np.bool_]:
    """Tell which points take part in what follows.

    Parameters
    ----------
    scene : PointCloud
        The scene; its column `outlier` marks the points that do not.

    Returns
    -------
    ndarray of bool, shape (n,)
        All True where there is no such column.
    """
    outlier = scene.get("outlier")
    return np.ones(len(scene), dtype=np.bool_) if outlier is None else ~outlier.astype(np.bool_)


def find_ground(scene: PointCloud, parameters: GroundParameters) -> dict[str, NDArray]:
    """Tell the ground points of a scene and every point's height above them.

    Parameters
    ----------
    scene : PointCloud
        The scene.
    parameters : GroundParameters
        Parameters of the filter.

    Returns
    -------
    dict of str to ndarray
        ``ground`` bool (n,), ``height`` float32 (n,) in metres, NaN where there is no ground to measure from.

    Raises
    ------
    DataError
        If a coordinate is NaN or infinite.
    """
    keep = inliers(scene)
    options = asdict(parameters)
    cell = options.pop("surface_cell")
    xyz = scene.xyz[keep]
    ground = np.zeros(len(scene), dtype=np.bool_)
    height = np.full(len(scene), np.nan, dtype=np.float32)
    ground[keep] = classify_ground(xyz, **options)
    height[keep] = height_above_ground(xyz, ground[keep], cell_size=cell)
    return {"ground": ground, "height": height}


def build_supervoxels(scene: PointCloud, parameters: SupervoxelParameters) -> dict[str, Any]:
    """Partition a scene into supervoxels.

    Parameters
    ----------
    scene : PointCloud
        The scene.
    parameters : SupervoxelParameters
        Parameters of VCCS.

    Returns
    -------
    dict
        ``labels`` int32 (n,), ``adjacency`` csr_array (s, s).

    Raises
    ------
    DataError
        If a coordinate is NaN or infinite.
    """
    keep = inliers(scene)
    colours = scene.get("rgb")
    use_colour = colours is not None and parameters.colour_weight > 0
    found = segment_supervoxels(
        scene.xyz[keep], rgb=colours[keep] if use_colour and colours is not None else None, **asdict(parameters)
    )
    labels = np.full(len(scene), -1, dtype=np.int32)
    labels[keep] = found.labels
    return {"labels": labels, "adjacency": found.adjacency}


def describe_supervoxels(
    scene: PointCloud,
    ground: Mapping[str, NDArray],
    supervoxels: Mapping[str, Any],
    parameters: FeatureParameters,
) -> dict[str, NDArray]:
    """Compute the features of a scene's supervoxels.

    Parameters
    ----------
    scene : PointCloud
        The scene.
    ground : mapping
        What `find_ground` gave.
    supervoxels : mapping
        What `build_supervoxels` gave.
    parameters : FeatureParameters
        Which features.

    Returns
    -------
    dict of str to ndarray
        ``values`` float32 (s, f), ``names`` str (f,), ``centroids`` float64 (s, 3), ``counts`` int64 (s,).

    Raises
    ------
    DataError
        If the results do not belong to the scene.
    """
    keep = inliers(scene)
    colours, intensity = scene.get("rgb"), scene.get("intensity")
    found: SupervoxelFeatures = compute_supervoxel_features(
        scene.xyz[keep],
        supervoxels["labels"][keep],
        supervoxels["adjacency"],
        height_above_ground=ground["height"][keep],
        rgb=None if colours is None else colours[keep],
        intensity=None if intensity is None else intensity[keep],
        **asdict(parameters),
    )
    return {
        "values": found.values,
        "names": np.array(found.names),
        "centroids": found.centroids,
        "counts": found.counts,
    }
