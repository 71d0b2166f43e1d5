"""Pipeline of the segmentation."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.segmentation.stage import measure_segmentation, segment_scene
from mlsroad_pipeline.papers.shared.detection.scoring import object_classes
from mlsroad_pipeline.pipelines.per_scene import PerScene
from mlsroad_pipeline.pipelines.schemes import detection_scheme
from mlsroad_pipeline.pipelines.segmentation.nodes import min_points, score_segmentation
from mlsroad_pipeline.surveys.plan import training_keys


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes and their ground to objects, and the scores of the segmentation."""
    inputs = {
        "scene": "scenes",
        "objects": "objects",
        "parameters": "params:detection",
        "classes": "params:classes",
    }
    return Pipeline(
        [
            Node(
                PerScene(segment_scene),
                inputs={"scene": "scenes", "ground": "ground", "parameters": "params:segmentation"},
                outputs="objects",
                name="segment_scenes",
            ),
            Node(
                PerScene(object_classes, keys=training_keys, scheme=detection_scheme),
                inputs=inputs,
                outputs="object_classes",
                name="name_objects_of_scenes",
            ),
            Node(
                PerScene(measure_segmentation, scheme=detection_scheme, min_points=min_points),
                inputs=inputs,
                outputs="segmentation_quality_of_scenes",
                name="measure_segmentation_of_scenes",
            ),
            Node(
                score_segmentation,
                inputs="segmentation_quality_of_scenes",
                outputs="segmentation_scores",
                name="score_segmentation",
            ),
        ]
    )
