"""Labels of a scene through its images, in a worker."""

from __future__ import annotations

from collections.abc import Sequence

from mlsroad_pipeline.algorithms.core.labels import ImagePredictions
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.surveys.camera_files import read_images
from mlsroad_pipeline.surveys.images import SurveyImages


def label_scene_through_images(
    scene: PointCloud,
    around: Sequence[PointCloud],
    model: ModelBundle,
    calibration: str | None,
    pictures: str | None,
    *,
    reach: float,
) -> ImagePredictions:
    """Label a scene through the images taken within reach of it."""
    from mlsroad_pipeline.algorithms.image_labels import labeller  # noqa: PLC0415  it imports torch

    images = SurveyImages(()) if calibration is None else read_images(calibration, images=pictures)
    places = scene.xyz[scene["core"], :2]
    low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
    near = [
        (image.group, image.camera, image.load)
        for image in images.relative_to(scene.origin)
        if ((image.camera.centre[:2] >= low) & (image.camera.centre[:2] <= high)).all()
    ]
    return labeller.label_scene(scene, around, near, model)
