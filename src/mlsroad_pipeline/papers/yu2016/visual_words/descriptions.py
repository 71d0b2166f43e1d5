"""Description of objects by contextual groups, sizes and profiles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.parameter_groups import parse_groups
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.papers.shared.detection.regions import INTENSITY, RegionParameters, describe_regions
from mlsroad_pipeline.papers.shared.detection.types import Segments
from mlsroad_pipeline.papers.yu2016.visual_words.groups import ContextualGroups, build_groups
from mlsroad_pipeline.papers.yu2016.visual_words.profiles import measure_profiles, without_intensities
from mlsroad_pipeline.papers.yu2016.visual_words.sizes import measure_sizes


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
