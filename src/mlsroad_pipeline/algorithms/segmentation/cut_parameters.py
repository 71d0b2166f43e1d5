"""Parameters of the extended normalised cut (Yu et al. 2016, section IV-A)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive


@dataclass(frozen=True)
class NormalizedCutParameters:
    """Parameters of the clusters and of their normalised cuts.

    Parameters
    ----------
    tolerance : float, default 0.15
        Clustering distance d_c, metres (yu2016: 0.15). Larger joins more into one cluster.
    spacing_factor : float, default 1.5
        Clustering distance in units of the spacing of the points, where these are sparse (yu2016: 0, `tolerance`
        everywhere). Larger joins sparse objects, and also objects close to them.
    max_tolerance : float, default 0.5
        Upper limit of the clustering distance, metres; values up to `tolerance` disable the use of spacing.
    voxel_size : float, default 0.1
        Edge of the voxels w_s, metres (yu2016: 0.1).
    sigma_h, sigma_v : float, default 2.0, 10.0
        Distances over which the weight of two voxels falls to 1/e, horizontally and vertically, metres (yu2016: 2 and
        10). A smaller `sigma_h` separates close objects, and splits wide ones.
    sigma_i : float, default 0.2
        The same for the intensity, in [0, 1] (yu2016: 1). Smaller cuts more between different reflectivities.
    smoothing, tall_smoothing : float, default 0.2, 2.0
        Edge of cells, metres. Edges compare mean intensities over 3 x 3 x 3 cells within a cluster; the second value
        applies to groups higher than `low_height`, whose boughs vary in intensity. Larger suppresses differences within
        an object, and also small objects. 0 compares voxels, as the paper.
    max_distance : float, default 5.0
        Largest horizontal distance d_H of two voxels with an edge, metres (yu2016: 5).
    max_cut : float, default 0.45
        Largest normalised cut that splits a group, 0 to 2. Larger cuts more. Not in the paper.
    min_voxels : int, default 20
        Fewest voxels of a part. Not in the paper.
    max_smoothness : float, default 0.2
        A group is not split where the smallest bin of the histogram of its eigenvector exceeds this share of the
        largest (Shi and Malik 2000). 1 never stops; smaller cuts less.
    max_nodes : int, default 256
        Largest number of nodes of the graph. Larger follows the voxels more closely; time grows with the square.
    low_height : float, default 3.0
        Height up to which groups without a cut are cut again with each of `low_sigma_h` and `low_max_cut`, metres: cars
        and shrubs stand closer together than trees. Larger cuts more (yu2016: 0, no second attempt).
    low_sigma_h, low_max_cut : sequence of float, default (0.5, 1.0), (0.045, 0.14)
        Values of `sigma_h` and `max_cut` of these attempts, in this order until a cut is found. Weakly connected
        objects have a small cut at the smallest scale. Not in the paper.
    pole_length : float, default 1.2
        Least length over which a pole stands free, below a crown or above a shrub, to be separated from its cluster
        before the cuts, metres; see `separate_poles`. Larger separates fewer (yu2016: 0, none).
    foot_height : float, default 2.0
        A part that does not reach down to this height above the foot of its cluster is merged with the part that it
        touches most, metres; see `rejoin_floating_parts`. Larger merges fewer (yu2016: 0, none).
    pole_gap : float, default 2.0
        Largest gap across which narrow collinear upright parts are merged, metres; see `join_stacked_poles`. Larger
        merges more (yu2016: 0, none).
    plate_gap : float, default 1.2
        Least length of a mast above a bright or thin plate for the plate to be an object of its own, metres; see
        `separate_plates`. Larger separates fewer (yu2016: 0, none).

    Raises
    ------
    ParameterError
        If a value is outside its domain.
    """

    tolerance: float = 0.15
    spacing_factor: float = 1.5
    max_tolerance: float = 0.5
    voxel_size: float = 0.1
    sigma_h: float = 2.0
    sigma_v: float = 10.0
    sigma_i: float = 0.2
    smoothing: float = 0.2
    tall_smoothing: float = 2.0
    max_distance: float = 5.0
    max_cut: float = 0.45
    min_voxels: int = 20
    max_smoothness: float = 0.2
    max_nodes: int = 256
    low_height: float = 3.0
    low_sigma_h: Sequence[float] = (0.5, 1.0)
    low_max_cut: Sequence[float] = (0.045, 0.14)
    pole_length: float = 1.2
    foot_height: float = 2.0
    pole_gap: float = 2.0
    plate_gap: float = 1.2

    def __post_init__(self) -> None:
        for name in ("low_sigma_h", "low_max_cut"):
            object.__setattr__(self, name, tuple(np.atleast_1d(getattr(self, name)).tolist()))
        for name in (
            "tolerance", "max_tolerance", "voxel_size", "sigma_h", "sigma_v", "sigma_i", "max_distance", "min_voxels",
        ):  # fmt: skip
            check_positive(getattr(self, name), name)
        for name, value in (("max_cut", self.max_cut), *(("low_max_cut", value) for value in self.low_max_cut)):
            if not 0 <= value <= 2:
                raise ParameterError(f"{name} must be between 0 and 2, got {value!r}")
        for value in self.low_sigma_h:
            check_positive(value, "low_sigma_h")
        if len(self.low_sigma_h) != len(self.low_max_cut):
            raise ParameterError(
                f"low_sigma_h and low_max_cut must have the same number of values, got {len(self.low_sigma_h)} and "
                f"{len(self.low_max_cut)}"
            )
        for name in (
            "spacing_factor", "smoothing", "tall_smoothing", "max_smoothness", "low_height", "pole_length",
            "foot_height", "pole_gap", "plate_gap",
        ):  # fmt: skip
            if not 0 <= getattr(self, name) < np.inf:
                raise ParameterError(f"{name} must be at least 0, got {getattr(self, name)!r}")
        if self.max_nodes < 8:
            raise ParameterError(f"max_nodes must be at least 8, got {self.max_nodes!r}")
