"""Classes and stations of the patches of a training scene."""

from __future__ import annotations

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.scenes.corridor import CorridorArrays, corridor_from_arrays
from mlsroad_pipeline.papers.shared.patches.labelling import label_patches
from mlsroad_pipeline.papers.shared.patches.types import PatchLabels, ScenePatches


def label_patches_along(
    scene: PointCloud, patches: ScenePatches, corridor: CorridorArrays, *, scheme: ClassScheme
) -> PatchLabels:
    """Return the class of each patch and its station along the corridor that the survey is cut along."""
    line = corridor_from_arrays(corridor)
    station = None if line is None else line.locate(patches["centroid"], origin=scene.origin)[0]
    return label_patches(scene, patches, scheme, station=station)
