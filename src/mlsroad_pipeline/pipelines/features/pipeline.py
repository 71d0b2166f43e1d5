"""Wiring of the supervoxel features."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.features.nodes import describe_supervoxels_of_scenes


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes, ground and supervoxels to features."""
    return Pipeline(
        [
            Node(
                describe_supervoxels_of_scenes,
                inputs=["scenes", "ground", "supervoxels", "params:features"],
                outputs="supervoxel_features",
                name="describe_supervoxels_of_scenes",
            ),
        ]
    )
