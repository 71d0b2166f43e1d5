"""How points are clustered and how their clusters are cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive


@dataclass(frozen=True)
class NormalizedCutParameters:
    """How points are grouped and groups are cut.

    Parameters
    ----------
    tolerance : float, default 0.15
        The clustering distance d_c of the paper, metres. Larger joins more into one cluster.
    spacing_factor : float, default 1.5
        Where points lie farther apart, the clustering distance is this times their spacing; 0 keeps to `tolerance`
        as the paper does. Larger joins sparse objects, and what stands close to them.
    max_tolerance : float, default 0.5
        The longest clustering distance that spacing leads to, metres; at `tolerance` and below spacing changes
        nothing.
    voxel_size : float, default 0.1
        The voxels' edge w_s, metres.
    sigma_h, sigma_v : float, default 2.0, 10.0
        Metres over which the weight of two voxels falls to 1/e, horizontally and vertically. A smaller `sigma_h` cuts
        objects that stand closer together, and wide ones in pieces.
    sigma_i : float, default 0.2
        The same for the intensity, in [0, 1] (yu2016: 1). Smaller separates by reflectivity more eagerly.
    smoothing, tall_smoothing : float, default 0.2, 2.0
        Intensities that cuts compare are means over three times this in each direction within a cluster, metres; the
        second in groups higher than `low_height`. Voxels of a body differ more than a crown and a car do, and boughs of
        one crown more than two crowns of a species. Larger tells what is larger. 0 compares those of voxels, as the
        paper. Not in the paper.
    max_distance : float, default 5.0
        Voxels farther apart horizontally, d_H, have no edge, metres.
    max_cut : float, default 0.45
        A group is left whole where the least normalised cut is above this; 0 to 2. Larger cuts more. Not in the paper.
    min_voxels : int, default 20
        No part is made smaller than this. Not in the paper.
    max_smoothness : float, default 0.2
        A group is left whole where the values of its eigenvector are spread more evenly than this: the emptiest bin of
        their histogram over the fullest (Shi and Malik 2000). 1 never stops; smaller cuts less.
    max_nodes : int, default 256
        Size of the graph that a cut is found on; more follows the voxels more closely, and time grows with its square.
    low_height : float, default 3.0
        A group no higher than this that stays whole is tried again with each of `low_sigma_h` and `low_max_cut`,
        metres: cars and shrubs stand closer together than trees. Larger cuts more; 0 tries none, as the paper.
    low_sigma_h, low_max_cut : sequence of float, default (0.5, 1.0), (0.045, 0.14)
        In place of `sigma_h` and `max_cut` then, in this order, until a cut is found: what hangs together by little
        shows best at the smallest scale, where a cut of it costs next to nothing. Not in the paper.
    pole_length : float, default 1.2
        Poles that stand free over this length, below a crown or above a shrub, are taken out of their clusters before
        these are cut, metres; see `separate_poles`. Larger takes out fewer; 0 takes out none, as the paper.
    foot_height : float, default 2.0
        A part that does not come down to within this height above the foot of its cluster is joined again with the
        part that it touches most, metres: half a crown is no object. Larger joins fewer; 0 joins none, as the paper.
    pole_gap : float, default 2.0
        Narrow upright parts that lie in one line are joined over a gap of at most this, metres: something hides a
        stretch of a pole. Larger joins more; 0 joins none, as the paper.
    plate_gap : float, default 1.2
        Plates brighter than the mast that they hang on, and thin ones of any intensity, are objects of their own where
        the mast goes on for this length above them, metres; see `separate_plates`. Larger takes off fewer; 0 takes off
        none, as the paper.

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
                f"low_sigma_h and low_max_cut go together: {len(self.low_sigma_h)} and {len(self.low_max_cut)} values"
            )
        for name in (
            "spacing_factor", "smoothing", "tall_smoothing", "max_smoothness", "low_height", "pole_length",
            "foot_height", "pole_gap", "plate_gap",
        ):  # fmt: skip
            if not 0 <= getattr(self, name) < np.inf:
                raise ParameterError(f"{name} must be at least 0, got {getattr(self, name)!r}")
        if self.max_nodes < 8:
            raise ParameterError(f"max_nodes must be at least 8, got {self.max_nodes!r}")
