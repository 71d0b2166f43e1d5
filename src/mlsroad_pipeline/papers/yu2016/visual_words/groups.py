"""Contextual feature groups, a region with its nearest regions, and objects described by them (Yu et al. 2016)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import parse_groups
from mlsroad_pipeline.papers.shared.detection.regions import (
    INTENSITY,
    FeatureRegions,
    RegionParameters,
    describe_regions,
)
from mlsroad_pipeline.papers.shared.detection.types import Segments
from mlsroad_pipeline.papers.yu2016.visual_words.appearance import measure_sizes
from mlsroad_pipeline.papers.yu2016.visual_words.profiles import measure_profiles, without_intensities

MAX_NEIGHBORS = 5
"""Largest number of neighbours in a group; m regions have m! matching orders."""


@dataclass(frozen=True)
class ContextualGroups:
    """Groups of m = k + 1 feature regions, the central region first."""

    descriptors: NDArray[np.float32]  # Descriptors of the regions
    orientations: NDArray[np.float32]  # Their orientations, unit vectors without a sign
    scales: NDArray[np.float32]  # Their scales, metres, above zero

    def __post_init__(self) -> None:
        g, m = self.scales.shape[:2] if self.scales.ndim == 2 else (-1, -1)
        if self.descriptors.shape[:2] != (g, m) or self.orientations.shape != (g, m, 3) or self.descriptors.ndim != 3:
            raise DataError(
                f"groups need descriptors (g, m, d), orientations (g, m, 3) and scales (g, m), got "
                f"{self.descriptors.shape}, {self.orientations.shape} and {self.scales.shape}"
            )

    def __len__(self) -> int:
        """Return the number of groups."""
        return len(self.scales)

    def select(self, index: NDArray) -> ContextualGroups:
        """Return some of the groups."""
        return ContextualGroups(self.descriptors[index], self.orientations[index], self.scales[index])


def build_groups(regions: FeatureRegions, *, k: int = 2) -> ContextualGroups:
    """Group each region with the nearest regions of its object."""
    if not 0 <= k <= MAX_NEIGHBORS:
        raise ParameterError(f"k must be between 0 and {MAX_NEIGHBORS}, got {k!r}")
    members = np.empty((len(regions), k + 1), dtype=np.int64)
    starts = np.append(np.flatnonzero(np.diff(regions.objects, prepend=-1)), len(regions))
    for first, stop in pairwise(starts):
        members[first:stop] = first + _nearest(regions.centres[first:stop], k)
    return ContextualGroups(regions.descriptors[members], regions.orientations[members], regions.scales[members])


def _nearest(centres: NDArray[np.float64], k: int) -> NDArray[np.int64]:
    """Return each centre and its k nearest others; ties in the order of their indices."""
    n = len(centres)
    near = min(k, n - 1)
    own = np.arange(n)[:, None]
    if near == 0:
        return np.repeat(own, k + 1, axis=1)
    # One neighbour more than needed, to detect a tie at the last place.
    distance, neighbor = cKDTree(centres).query(centres, k=min(near + 2, n))
    distance = np.where(neighbor == own, -1.0, np.round(distance, 9))
    order = np.lexsort((neighbor, distance), axis=1)
    ranked = np.take_along_axis(neighbor, order, axis=1)[:, : near + 1]
    repeated = np.resize(np.arange(1, near + 1), k)
    return np.concatenate([ranked[:, :1], ranked[:, repeated]], axis=1)


def join_groups(parts: Sequence[ContextualGroups]) -> ContextualGroups:
    """Join groups of several scenes or objects."""
    if not parts:
        raise DataError("no contextual groups to join")
    sizes = {part.scales.shape[1] for part in parts}
    if len(sizes) > 1:
        raise DataError(f"groups of different sizes cannot be joined: {', '.join(map(str, sorted(sizes)))}")
    return ContextualGroups(
        np.concatenate([part.descriptors for part in parts]),
        np.concatenate([part.orientations for part in parts]),
        np.concatenate([part.scales for part in parts]),
    )


@dataclass(frozen=True)
class GroupParameters:
    """Parameters of the description of objects."""

    regions: RegionParameters  # Supervoxels and neighbourhoods
    k: int = 2  # Neighbours in a contextual group (yu2016: 2)

    def __post_init__(self) -> None:
        parse_groups(self, regions=RegionParameters)


def describe_objects(scene: PointCloud, objects: Segments, *, parameters: GroupParameters) -> dict[str, NDArray]:
    """Describe the objects of a scene by contextual groups."""
    regions = describe_regions(
        scene.xyz, objects["objects"], intensity=scene.get("intensity"), parameters=parameters.regions
    )
    groups = build_groups(regions, k=parameters.k)
    return {
        "descriptors": groups.descriptors,
        "orientations": groups.orientations,
        "scales": groups.scales,
        "objects": regions.objects,
        "n_objects": np.array(int(objects["objects"].max(initial=-1)) + 1),
        "sizes": measure_sizes(scene.xyz, objects["objects"]),
        "profiles": measure_profiles(scene.xyz, objects["objects"], intensity=scene.get("intensity")),
        "intensity": np.array("intensity" in scene),
    }


def groups_of(arrays: Mapping[str, NDArray], *, intensity: bool = True) -> ContextualGroups:
    """Return the groups that `describe_objects` stored."""
    groups = ContextualGroups(arrays["descriptors"], arrays["orientations"], arrays["scales"])
    if intensity:
        return groups
    blind = groups.descriptors.copy()
    blind[..., INTENSITY] = 0.0
    return replace(groups, descriptors=blind)


def profiles_of(arrays: Mapping[str, NDArray], *, intensity: bool = True) -> NDArray[np.float32]:
    """Return the profiles that `describe_objects` stored."""
    profiles = arrays["profiles"]
    return profiles if intensity else without_intensities(profiles)
