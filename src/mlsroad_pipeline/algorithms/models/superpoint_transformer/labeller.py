"""Labels of points and probabilities of superpoints by a trained superpoint transformer, without PyTorch."""

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]  # it has no stubs

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.labels import PointLabels, unlabelled
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import StageParameters
from mlsroad_pipeline.algorithms.core.stage_results import Ground, SupervoxelPartition, SupervoxelTable
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under
from mlsroad_pipeline.algorithms.models.labelling import SoftLabels
from mlsroad_pipeline.algorithms.models.superpoint_transformer.building import (
    build_graph,
    superpoint_feature_names,
)
from mlsroad_pipeline.algorithms.models.superpoint_transformer.graph import SuperpointGraph
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inference import TrainedNetwork
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inputs import (
    Scale,
    even_points,
    n_inputs,
    prepare_inputs,
)
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import (
    SuperpointTransformerParameters,
)
from mlsroad_pipeline.algorithms.stages import (
    find_ground,
    ground_of,
    inlier_rows,
    inliers,
    supervoxels_with_features,
)


def predict_superpoints(
    graph: SuperpointGraph, bundle: ModelBundle, parameters: SuperpointTransformerParameters
) -> NDArray[np.float32]:
    """Return the probabilities of the network for the superpoints of level 1."""
    scale = Scale.from_arrays(bundle.arrays)
    network = _network(bundle, scale, parameters)
    inputs = prepare_inputs(graph, scale, even_points(graph, parameters.training.n_points))
    # One thread: results do not depend on their number. NaN from damaged weights reaches the check of the labels.
    with _libraries().limit(limits=1, user_api="blas"), np.errstate(invalid="ignore", over="ignore"):
        scores = network.scores(inputs)
        weights = np.exp(scores - scores.max(axis=1, keepdims=True))
        probabilities: NDArray[np.float32] = weights / weights.sum(axis=1, keepdims=True)
    return probabilities


@functools.lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    """Return the thread pools of the loaded libraries; finding them takes 2 ms."""
    return ThreadpoolController()


def _network(bundle: ModelBundle, scale: Scale, parameters: SuperpointTransformerParameters) -> TrainedNetwork:
    """Return the network of a model; it is built once."""
    if "network" not in bundle.prepared:
        weights = arrays_under(bundle.arrays, "weights.")
        network = TrainedNetwork(weights, parameters.network, n_inputs(scale), len(bundle.classes))
        bundle.prepared["network"] = network
    kept: TrainedNetwork = bundle.prepared["network"]
    return kept


def prepare(
    scene: PointCloud, stages: StageParameters, *, fresh: bool = False
) -> tuple[Ground, SupervoxelPartition, SupervoxelTable]:
    """Run the stages before the network; `fresh` finds the ground anew where the scene has one."""
    ground = find_ground(scene, stages.ground) if fresh else ground_of(scene, stages.ground)
    features = replace(stages.features, detrend=False)  # the network takes no detrended ones
    return ground, *supervoxels_with_features(scene, ground, stages.supervoxels, features)


def label_scene(
    scene: PointCloud,
    ground: Ground,
    supervoxels: SupervoxelPartition,
    features: SupervoxelTable,
    bundle: ModelBundle,
) -> PointLabels:
    """Label the points of a prepared scene."""
    soft = _label_softly(scene, ground, supervoxels, features, bundle)
    return {"label": soft.labels, "confidence": soft.confidence}


def _label_softly(
    scene: PointCloud,
    ground: Ground,
    supervoxels: SupervoxelPartition,
    features: SupervoxelTable,
    bundle: ModelBundle,
) -> SoftLabels:
    label, confidence = unlabelled(len(scene))
    keep = inliers(scene)
    if not keep.any():
        return SoftLabels(label, confidence)
    names = superpoint_feature_names(features["names"])[0]
    wanted = bundle.metadata["feature_names"]["superpoints"]
    if names != wanted:
        missing = [name for name in wanted if name not in names] or ["the features in the order of the training"]
        raise DataError(f"{scene.source}: the model needs {', '.join(missing)}")
    parameters = parameters_of(bundle)
    graph = build_graph(scene, ground, supervoxels, features, parameters.hierarchy)
    trained = bundle.arrays["class_weights"] > 0
    balanced = np.where(trained, predict_superpoints(graph, bundle, parameters), 0.0).astype(np.float32)
    best, probability = _decide(balanced, bundle.arrays["class_weights"])
    rows = inlier_rows(scene)
    owner = supervoxels["labels"] if isinstance(rows, slice) else np.where(keep, supervoxels["labels"], -1)
    label[rows], confidence[rows] = best[owner[rows]], probability[owner[rows]]
    return SoftLabels(label, confidence, balanced, owner)


def _decide(
    balanced: NDArray[np.float32], class_weights: NDArray[np.float32]
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Return the most probable classes under the weights of the training, and their probabilities without them."""
    plain = balanced / np.where(class_weights > 0, class_weights, 1.0)
    plain /= np.maximum(plain.sum(axis=1, keepdims=True), 1e-12)
    best = balanced.argmax(axis=1)
    return best.astype(np.int16), np.take_along_axis(plain, best[:, None], axis=1)[:, 0].astype(np.float32)


def parameters_of(bundle: ModelBundle) -> SuperpointTransformerParameters:
    """Return the parameters that a model was trained with."""
    return SuperpointTransformerParameters(**bundle.metadata["parameters"]["superpoint_transformer"])


def label_cloud_softly(cloud: PointCloud, bundle: ModelBundle) -> SoftLabels:
    """Label the points of a cloud, and return the class probabilities of the superpoints."""
    if len(cloud) == 0 or not inliers(cloud).any():
        return SoftLabels(*unlabelled(len(cloud)))
    stages = StageParameters.from_stored(bundle.metadata["parameters"])
    return _label_softly(cloud, *prepare(cloud, stages), bundle)
