"""Labelled graphs of training scenes: as they were scanned, and in the views of virtual scanners."""

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import StageParameters
from mlsroad_pipeline.algorithms.core.stage_results import Ground, SupervoxelPartition, SupervoxelTable
from mlsroad_pipeline.algorithms.models.superpoint_transformer.augmentation import cut_view
from mlsroad_pipeline.algorithms.models.superpoint_transformer.building import (
    build_graph,
    count_labels,
    superpoint_feature_names,
)
from mlsroad_pipeline.algorithms.models.superpoint_transformer.labeller import prepare
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import SuperpointTransformerParameters


def training_graphs(
    scene: PointCloud,
    ground: Ground,
    supervoxels: SupervoxelPartition,
    features: SupervoxelTable,
    *,
    parameters: SuperpointTransformerParameters,
    stages: StageParameters,
    scheme: ClassScheme,
) -> dict[str, dict[str, NDArray]]:
    """Return the labelled graphs of a training scene: as it was scanned, and in views of virtual scanners."""
    rng = np.random.default_rng([parameters.training.seed, len(scene)])
    graphs = {"scanned": _labelled_graph(scene, ground, supervoxels, features, parameters, scheme)}
    for number in range(1, parameters.augmentation.cuts + 1):
        view = cut_view(scene, ground["height"], parameters.augmentation, rng)
        graphs[f"view_{number}"] = _labelled_graph(view, *prepare(view, stages, fresh=True), parameters, scheme)
    return graphs


def _labelled_graph(
    scene: PointCloud,
    ground: Ground,
    supervoxels: SupervoxelPartition,
    features: SupervoxelTable,
    parameters: SuperpointTransformerParameters,
    scheme: ClassScheme,
) -> dict[str, NDArray]:
    graph = build_graph(scene, ground, supervoxels, features, parameters.hierarchy)
    graph = count_labels(scene, supervoxels, graph, scheme)
    attributes = [name for name in ("rgb", "intensity") if name in scene]
    return {
        **graph.to_arrays(),
        "names": np.asarray(superpoint_feature_names(features["names"])[0], dtype=np.str_),
        "attributes": np.asarray(attributes, dtype=np.str_),
    }
