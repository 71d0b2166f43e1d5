"""Wiring of the supervoxels."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.supervoxelise.nodes import (
    measure_supervoxels_of_scenes,
    score_supervoxels,
    supervoxelise_scenes,
)


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes to supervoxels."""
    return Pipeline(
        [
            Node(
                supervoxelise_scenes,
                inputs=["scenes", "params:supervoxelise"],
                outputs="supervoxels",
                name="supervoxelise_scenes",
            ),
            Node(
                measure_supervoxels_of_scenes,
                inputs=["scenes", "supervoxels"],
                outputs="supervoxel_quality_of_scenes",
                name="measure_supervoxels_of_scenes",
            ),
            Node(
                score_supervoxels,
                inputs="supervoxel_quality_of_scenes",
                outputs="supervoxel_quality",
                name="score_supervoxels",
            ),
        ]
    )
