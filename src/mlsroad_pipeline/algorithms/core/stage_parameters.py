"""Parameters of the stages that all methods share: ground, supervoxels and supervoxel features."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Self

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive


@dataclass(frozen=True)
class GroundParameters:
    """Parameters of the ground filter, see `classify_ground`.

    Parameters
    ----------
    voxel_size : float, default 0.1
        Edge of a voxel, metres.
    block_size : float, default 8.0
        Edge of a block in plan, metres.
    local_height : float, default 0.2
        Maximum height of ground above the bottom of its region, metres.
    global_height : float, default 0.3
        Maximum height of ground above the reference surface, metres.
    reference : {"surface", "block"}, default "surface"
        Reference of the global height: a robust lower surface, or the lowest point of the block (yu2016).
    surface_cell : float, default 0.5
        Cell of the ground surface from which heights are measured, metres.

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
    """Parameters of VCCS, see `segment_supervoxels`.

    Parameters
    ----------
    voxel_size : float, default 0.2
        Edge of a voxel, metres (tomic2019: 0.2).
    seed_resolution : float, default 0.6
        Distance between seeds, metres (tomic2019: 0.6).
    colour_weight : float, default 0.0
        Weight of the colour distance (tomic2019: 0).
    spatial_weight : float, default 0.4
        Weight of the spatial distance.
    normal_weight : float, default 1.0
        Weight of the angle between normals.
    distance : {"papon", "tomic"}, default "papon"
        Normalisation of the spatial distance: that of Papon et al. 2013, or equation 1 of tomic2019.

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
    """Selection of supervoxel features, see `compute_supervoxel_features`.

    Parameters
    ----------
    detrend : bool, default True
        Whether to append the detrended features (tomic2019, equations 2 and 3).
    region : {"own", "neighborhood", "both"}, default "both"
        Points that define shape and orientation (tomic2019: the supervoxel's own).
    column_size : float, default 0.5
        Raster cell of the column features, metres.
    relief_radius : float, default 5.0
        Radius of the search for the lowest point, metres.
    ball_radii : sequence of float, default [0.5, 1.0, 2.0]
        Radii of the spherical neighbourhoods of the shape features, metres.
    ball_voxel_size : float, default 0.2
        Edge of the voxels that represent the points of these neighbourhoods, metres.
    footprint_radii : sequence of float, default [1.5, 3.0, 6.0]
        Radii of the column features of the surroundings, metres.

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


@dataclass(frozen=True)
class StageParameters:
    """Parameters of the stages; a model stores them, and new surveys are prepared with the same.

    Parameters
    ----------
    ground : GroundParameters
        The ground filter.
    supervoxels : SupervoxelParameters
        The partition.
    features : FeatureParameters
        The features of the supervoxels.
    """

    ground: GroundParameters
    supervoxels: SupervoxelParameters
    features: FeatureParameters

    @classmethod
    def from_stored(cls, stored: Mapping[str, Any]) -> Self:
        """Return the parameters that a model stores, among others.

        Parameters
        ----------
        stored : mapping of str to mapping
            Name of the stage to its parameters.

        Returns
        -------
        StageParameters
            The parameters.
        """
        return cls(
            GroundParameters(**stored["ground"]),
            SupervoxelParameters(**stored["supervoxels"]),
            FeatureParameters(**stored["features"]),
        )
