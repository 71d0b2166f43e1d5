"""Warm-up of a worker: import the libraries and load the compiled kernels of `label`."""

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import FeatureParameters, GroundParameters, SupervoxelParameters
from mlsroad_pipeline.algorithms.core.stage_results import Ground
from mlsroad_pipeline.algorithms.features.voxel_scales import compute_voxel_features, smooth_by_cells
from mlsroad_pipeline.algorithms.features.voxel_table import voxel_feature_names
from mlsroad_pipeline.algorithms.geometry.polyline import locate
from mlsroad_pipeline.algorithms.geometry.thinning import first_in_cells
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.kerb_lines import kerb_steps
from mlsroad_pipeline.algorithms.inventory.lines.markings.marking_lines import marking_stripes
from mlsroad_pipeline.algorithms.inventory.objects.boxes import vehicle_box
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import GROUPS, ClassEvidence
from mlsroad_pipeline.algorithms.inventory.objects.extraction import extract_objects
from mlsroad_pipeline.algorithms.inventory.objects.merging import merge_across_scenes
from mlsroad_pipeline.algorithms.inventory.objects.panels import fit_panel
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees
from mlsroad_pipeline.algorithms.models.machines.combinations import decide, rank_pairs
from mlsroad_pipeline.algorithms.models.superpoint_transformer.building import build_graph
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inference import TrainedNetwork
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inputs import (
    even_points,
    find_scale,
    n_inputs,
    prepare_inputs,
)
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import (
    HierarchyParameters,
    NetworkParameters,
    TrainingParameters,
)
from mlsroad_pipeline.algorithms.models.superpoint_transformer.weights import weight_shapes
from mlsroad_pipeline.algorithms.quality.chunks import inspect_chunk
from mlsroad_pipeline.algorithms.scenes.binning import cut_range
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.algorithms.stages import build_supervoxels, describe_supervoxels, find_ground
from mlsroad_pipeline.label.scene import label_pieces
from mlsroad_pipeline.label.written_file import write_file
from mlsroad_pipeline.model_store.object_classifiers import shipped_classifier
from mlsroad_pipeline.surveys.reading import read_and_cut

STAGES = (read_and_cut, label_pieces, write_file)
"""Tasks of `label`; importing them imports their libraries."""

_ONE_TREE = BoostedTrees(
    n_leaves=np.array([2], np.uint8),
    tree_class=np.zeros(1, np.uint8),
    feature=np.zeros(1, np.int16),
    threshold=np.zeros(1, np.float32),
    missing_left=np.zeros(1, np.bool_),
    left=np.array([-1], np.int8),
    right=np.array([-2], np.int8),
    leaf=np.zeros(2, np.float32),
    initial=np.zeros(1),
    n_features=len(voxel_feature_names()),
)
"""A tree with the dtypes of a trained one."""


def small_street() -> PointCloud:
    """Return 10 m of a flat street with a post, with the dtypes of the readers."""
    x, y = np.meshgrid(np.arange(0.0, 10.0, 0.25), np.arange(0.0, 10.0, 0.25))
    ground = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    post = np.column_stack([np.full((100, 2), 5.0), np.linspace(0.1, 4.0, 100)])
    xyz = np.concatenate([ground, post])
    n = len(xyz)
    columns: dict[str, NDArray] = {
        "rgb": np.full((n, 3), 120, np.uint8),
        "intensity": np.full(n, 0.4, np.float32),
        "gps_time": np.linspace(0.0, 1.0, n),
    }
    return PointCloud(xyz, columns, source="small street")


def _short_drive() -> Trajectory:
    return Trajectory.from_positions(np.array([[0.0, 5.0, 2.0], [10.0, 5.0, 2.0]]), np.array([0.0, 1.0]))


def load_first_kernel() -> None:
    """Load one kernel: the first one of a process initialises Numba, which takes 0.2 s."""
    _short_drive().locate(np.zeros((1, 3)))


def is_first_run() -> bool:
    """Return whether the first kernel was compiled in this process, not loaded."""
    return bool(locate.stats.cache_misses)


def _small_scene() -> PointCloud:
    street = small_street()
    columns = {"rgb": street["rgb"], "intensity": street["intensity"], "core": np.ones(len(street), np.bool_)}
    return PointCloud(street.xyz.astype(np.float32), columns, source=street.source)


def run_network() -> None:
    """Run the network of the default model with weights of 0, and steps whose kernels few others share."""
    scene = _small_scene()
    height = scene.xyz[:, 2].copy()
    ground: Ground = {"ground": height < 0.05, "height": height}
    supervoxels = build_supervoxels(scene, SupervoxelParameters())
    features = describe_supervoxels(scene, ground, supervoxels, FeatureParameters(detrend=False))
    graph = build_graph(scene, ground, supervoxels, features, HierarchyParameters())
    scale, layers = find_scale([graph]), NetworkParameters()
    shapes = weight_shapes(layers, n_inputs(scale), 1)
    weights = {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}
    network = TrainedNetwork(weights, layers, n_inputs(scale), 1)
    network.scores(prepare_inputs(graph, scale, even_points(graph, TrainingParameters().n_points)))
    pairs = np.zeros(2, np.int32)
    rank_pairs(pairs, pairs, 1)
    decide(np.ones((1, 2)))
    first_in_cells(scene.xyz, 0.1)
    post = scene.xyz[-100:].astype(np.float64)
    fit_panel(post)
    vehicle_box(post[:, :2])


def run_stages() -> None:
    """Run the steps of `label` with the default model, without its weights, on a small street.

    Workers load the kernels of other methods when they need them.
    """
    run_network()
    run_other_stages()


def run_other_stages() -> None:
    """Run all steps but those of `run_network`."""
    street = small_street()
    inspect_chunk(street, n_total=len(street))
    drive = _short_drive()
    cut_range(street, drive, bin_length=1.0, first_row=0, file=0)
    scene = _small_scene()
    ground = find_ground(scene, GroundParameters())
    levels = np.arange(len(scene), dtype=np.float32)
    voxels = compute_voxel_features(scene.xyz, height=ground["height"], intensity=levels)
    smooth_by_cells(voxels, _ONE_TREE.scores(voxels.values), level=1)
    decide(np.ones((1, 2)), np.arange(2))
    labels, heights = np.where(ground["ground"], 0, 1).astype(np.int16), ground["height"]
    rules = {"pole": ObjectRule("pole", (1,), 0.3, split_spacing=1.0)}
    groups = np.eye(2, len(GROUPS), dtype=np.float32)
    evidence = ClassEvidence(np.full((len(scene), 2), 0.5, np.float32), np.arange(len(scene), dtype=np.int32), groups)
    objects = extract_objects(
        scene.xyz,
        labels,
        np.ones(len(scene), np.float32),
        classes=rules,
        core=scene["core"],
        origin=scene.origin,
        height_above_ground=np.nan_to_num(heights),
        scene="small",
        evidence=evidence,
        classifier=shipped_classifier(),
    )
    merge_across_scenes([objects], classes=rules, trajectory=drive)
    is_ground, core, origin = np.array([True, False]), scene["core"], scene.origin
    kerb_steps(scene.xyz, heights, labels, is_ground=is_ground, core=core, origin=origin)
    device = np.zeros(len(scene), np.int64)
    marking_stripes(
        *(scene.xyz, heights, labels, scene["intensity"], device),
        is_paved=is_ground,
        is_ground=is_ground,
        core=core,
        origin=origin,
    )
