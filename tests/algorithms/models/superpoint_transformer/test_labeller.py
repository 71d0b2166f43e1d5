"""Hierarchy, training and labels on small streets: overfitting, resuming, order of points, missing attributes."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from references.patches import SCHEME, street
from threadpoolctl import threadpool_limits

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import (
    FeatureParameters,
    GroundParameters,
    StageParameters,
    SupervoxelParameters,
)
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.algorithms.models.superpoint_transformer.augmentation import change_graph, cut_view
from mlsroad_pipeline.algorithms.models.superpoint_transformer.building import build_graph, rank
from mlsroad_pipeline.algorithms.models.superpoint_transformer.graph import SuperpointGraph, join_graphs, subgraph
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inputs import (
    drawn_points,
    even_points,
    find_scale,
    prepare_inputs,
)
from mlsroad_pipeline.algorithms.models.superpoint_transformer.labeller import prepare
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import (
    AugmentationParameters,
    HierarchyParameters,
    SuperpointTransformerParameters,
)
from mlsroad_pipeline.algorithms.models.superpoint_transformer.training import _Run, fit, train_network
from mlsroad_pipeline.algorithms.models.superpoint_transformer.training_graphs import training_graphs
from mlsroad_pipeline.model_store.torch_checkpoints import TorchCheckpoints

STAGES = StageParameters(
    GroundParameters(),
    SupervoxelParameters(),
    FeatureParameters(detrend=False, ball_radii=[0.5], footprint_radii=[1.5]),
)
SMALL = {"width": 16, "point_widths": [8, 16], "n_heads": 4, "edge_width": 8, "blocks_down": [1, 1, 1]}
QUICK = SuperpointTransformerParameters(
    network=SMALL,
    augmentation={"cuts": 1, "jitter": 0.0, "drop": 0.1},
    training={"n_steps": 40, "batch_size": 2, "crop": 4.0, "n_points": 8, "learning_rate": 0.01},
)


def graphs_of(*clouds, parameters=QUICK):
    return [
        graph
        for cloud in clouds
        for graph in training_graphs(
            cloud, *prepare(cloud, STAGES), parameters=parameters, stages=STAGES, scheme=SCHEME
        ).values()
    ]


@pytest.fixture(scope="module")
def arrays():
    """Graphs of a street: as it is, and cut."""
    return graphs_of(street(0))


@pytest.fixture(scope="module")
def model(arrays):
    return fit(arrays, parameters=QUICK, stages=STAGES, scheme=SCHEME, trained_on={})


def test_the_hierarchy_is_nested_and_complete(arrays):
    graph, cloud = SuperpointGraph.from_arrays(arrays[0]), street(0)
    n = [len(level) for level in graph.levels]
    assert n[0] > n[1] > n[2] >= 1 and len(graph.offset) == graph.indptr[-1] > n[0]
    for below, above in zip(graph.levels[:-1], graph.levels[1:], strict=True):
        assert set(below.parent.tolist()) == set(range(len(above)))
        summed = np.zeros_like(above.histogram)
        np.add.at(summed, below.parent, below.histogram)
        assert np.array_equal(summed, above.histogram)
    assert graph.levels[0].histogram.sum() == cloud["core"].sum()
    for level in graph.levels:
        edges = set(zip(level.targets().tolist(), level.indices.tolist(), strict=True))
        assert len(edges) == len(level.indices) and all((b, a) in edges for a, b in edges)
        assert all((i, i) in edges for i in range(len(level)))


def test_the_loss_falls_and_the_street_is_learned(model):
    bundle, losses = model
    assert np.mean(losses[-5:]) < 0.3 * np.mean(losses[:3])
    cloud = street(0)
    labels, confidence = label_cloud(bundle, cloud)
    truth = SCHEME.encode(cloud["label"], source=cloud.source)
    assert (labels == truth).mean() > 0.95
    assert 0.5 < confidence.mean() <= 1.0 and confidence.min() >= 0.0
    assert SCHEME.classes.index("vehicle") not in labels  # no training points
    assert bundle.metadata["attributes"] == ["rgb"] and bundle.metadata["n_weights"] < 30_000


def test_labels_do_not_depend_on_the_order_of_the_points(model):
    bundle, cloud = model[0], street(1)
    order = np.random.default_rng(3).permutation(len(cloud))
    labels, confidence = label_cloud(bundle, cloud)
    moved, moved_confidence = label_cloud(bundle, cloud.select(order))
    assert (moved == labels[order]).mean() > 0.999
    assert np.abs(moved_confidence - confidence[order]).mean() < 1e-3


def test_labels_do_not_depend_on_the_number_of_threads(model):
    bundle, cloud = model[0], street(1)
    found = []
    for n_threads in (1, 2):
        with threadpool_limits(n_threads):
            found.append(label_cloud(bundle, cloud)[1].tobytes())
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        (
            "weights.heads.0.bias",
            lambda a: a[1:],
            "weights do not fit superpoint_transformer with 4 classes: heads.0.b",
        ),
        ("weights.points.0.weight", lambda a: a * np.nan, "returned a confidence of nan: the model is damaged"),
        ("scale.deviation_0", lambda a: a[1:], "scale does not fit the 11 features of a point: the model is damaged"),
    ],
)
def test_damaged_arrays_are_an_error(model, name, change, message):
    bundle = model[0]
    damaged = ModelBundle(bundle.slug, {**bundle.arrays, name: change(bundle.arrays[name])}, bundle.metadata)
    with pytest.raises(DataError, match=message):
        label_cloud(damaged, street(1))


def test_a_cloud_without_attributes_and_with_outliers_is_labelled(model):
    bundle, cloud = model[0], street(2, colour=False)
    outlier = np.zeros(len(cloud), bool)
    outlier[::50] = True
    labels, confidence = label_cloud(bundle, cloud.with_columns(outlier=outlier))
    assert (labels[outlier] == -1).all() and (confidence[outlier] == 0).all() and (labels[~outlier] >= 0).all()
    truth = SCHEME.encode(cloud["label"], source=cloud.source)
    assert (labels == truth)[~outlier].mean() > 0.8
    empty = label_cloud(bundle, cloud.select(np.zeros(0, int)))
    assert len(empty[0]) == 0 == len(empty[1])
    alone, _ = label_cloud(bundle, PointCloud(np.zeros((1, 3))))
    assert alone[0] >= 0


class Interrupted(Exception):
    pass


class Stopping(TorchCheckpoints):
    """Checkpoints that interrupt the training after some savings."""

    left = 3

    def save(self, name, state):
        super().save(name, state)
        object.__setattr__(self, "left", self.left - 1)
        if not self.left:
            raise Interrupted


def test_a_resumed_training_gives_the_same_bytes(arrays, tmp_path):
    graphs = [SuperpointGraph.from_arrays(graph) for graph in arrays]
    short = replace(QUICK, training=replace(QUICK.training, n_steps=8, checkpoint_seconds=1e-6))
    whole = train_network(graphs, n_classes=len(SCHEME), parameters=short)
    with pytest.raises(Interrupted):
        train_network(graphs, n_classes=len(SCHEME), parameters=short, checkpoints=Stopping(tmp_path / "states"))
    [file] = (tmp_path / "states").iterdir()
    assert len(torch.load(file, weights_only=True)["losses"]) == 3
    resumed = train_network(
        graphs, n_classes=len(SCHEME), parameters=short, checkpoints=TorchCheckpoints(tmp_path / "states")
    )
    assert resumed.losses == whole.losses
    for name, value in whole.network.state_dict().items():
        assert torch.equal(value, resumed.network.state_dict()[name]), name
    assert not (tmp_path / "states").exists()


def test_a_checkpoint_of_another_training_is_refused(arrays, tmp_path):
    graphs = [SuperpointGraph.from_arrays(graph) for graph in arrays]
    checkpoints = TorchCheckpoints(tmp_path)
    name = f"training_{_Run(graphs, len(SCHEME), QUICK).identity[:12]}"
    checkpoints.save(name, {"identity": "another"})
    with pytest.raises(ReadError, match=rf"{name}.pt is a checkpoint of another training"):
        train_network(graphs, n_classes=len(SCHEME), parameters=QUICK, checkpoints=checkpoints)


def test_parts_of_joined_graphs_are_the_graphs(arrays):
    graphs = [SuperpointGraph.from_arrays(graph) for graph in arrays]
    joined = join_graphs(graphs)
    first = np.arange(len(joined.levels[0])) < len(graphs[0].levels[0])
    scale = find_scale(graphs)
    for graph, keep in zip(graphs, (first, ~first), strict=True):
        part, whole = prepare_inputs(subgraph(joined, keep), scale), prepare_inputs(graph, scale)
        assert np.array_equal(part.points, whole.points) and np.array_equal(part.owner, whole.owner)
        for a, b in zip(part.levels[:2], whole.levels[:2], strict=True):
            assert all(np.array_equal(getattr(a, name), getattr(b, name)) for name in vars(a))


def test_inputs_are_finite_and_points_are_taken_from_every_superpoint(arrays):
    graph = SuperpointGraph.from_arrays(arrays[0])
    scale, rng = find_scale([graph]), np.random.default_rng(0)
    changed = change_graph(graph, scale, AugmentationParameters(hide_intensity=1.0, hide_colour=1.0), rng)
    for rows in (even_points(changed, 4), drawn_points(changed, 4, rng)):
        inputs = prepare_inputs(changed, scale, rows)
        taken = np.bincount(inputs.owner, minlength=len(changed.levels[0]))
        assert np.array_equal(taken, np.minimum(np.diff(changed.indptr), 4)) and (np.diff(rows) > 0).all()
        assert np.isfinite(inputs.points).all()
        assert all(np.isfinite(level.nodes).all() and np.isfinite(level.edges).all() for level in inputs.levels)


def test_a_rotation_changes_directions_alone(arrays):
    graph = SuperpointGraph.from_arrays(arrays[0])
    still = AugmentationParameters(stretch=0.0, jitter=0.0, drop=0.0, hide_intensity=0.0, hide_colour=0.0)
    turned = change_graph(graph, find_scale([graph]), still, np.random.default_rng(1))
    for a, b in zip(graph.levels, turned.levels, strict=True):
        assert not np.allclose(a.centroid, b.centroid) and np.array_equal(a.indices, b.indices)
        assert np.allclose(a.centroid[:, 2], b.centroid[:, 2]) and np.array_equal(a.values, b.values, equal_nan=True)
        gaps = [np.linalg.norm(x.centroid[x.targets()] - x.centroid[x.indices], axis=1) for x in (a, b)]
        assert np.allclose(*gaps, atol=1e-4)


def test_a_cut_view_has_no_points_above_the_line_of_sight():
    cloud = street(0)
    flat = AugmentationParameters(elevation=[0.0, 0.0], thin=0.0)
    seen = cut_view(cloud, cloud.xyz[:, 2], flat, np.random.default_rng(0))
    limit = seen.xyz[:, 2].max()
    assert 1.5 < limit < 2.6 and len(seen) == (cloud.xyz[:, 2] <= limit).sum()
    thinner = cut_view(cloud, cloud.xyz[:, 2], replace(flat, thin=0.9), np.random.default_rng(0))
    assert 0 < len(thinner) < len(seen)
    high = PointCloud(np.array([[0.0, 0, 9], [1, 0, 9]]))
    assert len(cut_view(high, high.xyz[:, 2], flat, np.random.default_rng(0))) == 2  # nothing would be left


def test_ranks_do_not_depend_on_the_unit():
    values = np.array([0.1, np.nan, 0.7, 0.3, 0.3])
    expected = [0.125, np.nan, 0.875, 0.5, 0.5]
    assert np.allclose(rank(values), expected, equal_nan=True)
    assert np.allclose(rank(values**2 * 65535), expected, equal_nan=True)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda graphs: [], "no training scenes: the split 'train' is empty"),
        (lambda graphs: [{**graphs[0], "level_1.histogram": 0 * graphs[0]["level_1.histogram"]}], "no labelled points"),
        (lambda graphs: [graphs[0], {**graphs[1], "names": graphs[1]["names"][1:]}], "different features: superpoint_"),
    ],
)
def test_unusable_training_scenes_are_refused(arrays, change, message):
    with pytest.raises(DataError, match=message):
        fit(change(arrays), parameters=QUICK, stages=STAGES, scheme=SCHEME, trained_on={})


@pytest.mark.parametrize(
    ("group", "key", "value", "message"),
    [
        ("hierarchy", "regularisation", [0.1], "hierarchy.regularisation must be 2 numbers"),
        ("network", "n_heads", 7, "network.n_heads must divide network.width = 64, got 7"),
        ("augmentation", "elevation", [20.0, 1.0], "elevation must be two ascending angles"),
        ("augmentation", "drop", 1.0, "augmentation.drop must be below 1, got 1.0"),
        ("training", "n_steps", 0, "training.n_steps must be at least 1, got 0"),
        ("training", "device", "tpu", "training.device must be auto, cpu or cuda, got 'tpu'"),
    ],
)
def test_parameters_outside_their_domain_are_named(group, key, value, message):
    with pytest.raises(ParameterError, match=message):
        SuperpointTransformerParameters(**{group: {key: value}})


def test_single_points_are_superpoints_of_all_levels():
    """Two points far apart are not merged by their shape, which is unknown, but by the edge between them."""
    cloud = PointCloud(np.array([[0.0, 0, 0], [0, 0, 3.0]]))
    graph = build_graph(cloud, *prepare(cloud, STAGES), HierarchyParameters())
    assert [len(level) for level in graph.levels] == [2, 2, 1]
    assert [level.indices.tolist() for level in graph.levels] == [[0, 1, 0, 1], [0, 1, 0, 1], [0]]
    inputs = prepare_inputs(graph, find_scale([graph]))
    assert all(np.isfinite(level.nodes).all() for level in inputs.levels)
