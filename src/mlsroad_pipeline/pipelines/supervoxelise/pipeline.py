"""Pipeline of the supervoxels."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.stages import build_supervoxels
from mlsroad_pipeline.papers.shared.evaluation.stages import measure_supervoxels
from mlsroad_pipeline.pipelines.per_scene import PerScene
from mlsroad_pipeline.pipelines.supervoxelise.nodes import score_supervoxels


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes to supervoxels, and the quality of the partition."""
    return Pipeline(
        [
            Node(
                PerScene(build_supervoxels),
                inputs={"scene": "scenes", "parameters": "params:supervoxelise"},
                outputs="supervoxels",
                name="supervoxelise_scenes",
            ),
            Node(
                PerScene(measure_supervoxels),
                inputs={"scene": "scenes", "supervoxels": "supervoxels"},
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
