"""Inputs of the network against their reference, for graphs as they are and as the training changes them."""

import numpy as np
import pytest
from references.patches import street
from references.superpoint_inputs import edge_inputs, point_inputs

from mlsroad_pipeline.algorithms.core.stage_parameters import (
    FeatureParameters,
    GroundParameters,
    StageParameters,
    SupervoxelParameters,
)
from mlsroad_pipeline.algorithms.models.superpoint_transformer.augmentation import change_graph
from mlsroad_pipeline.algorithms.models.superpoint_transformer.building import build_graph
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
)

STAGES = StageParameters(GroundParameters(), SupervoxelParameters(), FeatureParameters(detrend=False))


@pytest.mark.parametrize("colour", [True, False])
@pytest.mark.parametrize("changed", [True, False])
def test_inputs_have_the_bytes_of_the_reference(rng, colour, changed):
    cloud = street(0, colour=colour)
    graph = build_graph(cloud, *prepare(cloud, STAGES), HierarchyParameters())
    scale = find_scale([graph])
    if changed:
        graph = change_graph(graph, scale, AugmentationParameters(), rng)
    for rows in (None, even_points(graph, 4), drawn_points(graph, 4, rng)):
        inputs = prepare_inputs(graph, scale, rows)
        taken = np.arange(len(graph.offset)) if rows is None else rows
        np.testing.assert_array_equal(inputs.points, point_inputs(graph, scale, taken))
    for level, made in zip(graph.levels, inputs.levels, strict=True):
        np.testing.assert_array_equal(made.edges, edge_inputs(level))
