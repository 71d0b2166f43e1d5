"""Images of the drives of a comparison: labels for training, and labelling of a scene through them."""

import logging
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.cityscapes import encode_label_image
from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.labels import ImagePredictions
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.surveys.camera_files import read_images
from mlsroad_pipeline.surveys.images import SurveyImages
from mlsroad_pipeline.surveys.masks import MaskLegend, masks_folder, read_mask, with_masks
from mlsroad_pipeline.surveys.plan import SurveyPlan, training_keys

logger = logging.getLogger(__name__)

_CACHE_BYTES = 2**30


@dataclass(frozen=True)
class DriveImages:
    """Images of a drive."""

    calibration: str  # File of cameras and poses
    images: SurveyImages  # The images

    @property
    def folder(self) -> str:
        """Folder of the pictures."""
        return str(self.images[0].root)

    def folder_of(self, masks: str | None) -> str:
        """Return the folder of the pictures, or that of the masks."""
        return self.folder if masks is None else str(masks_folder(self.images[0], masks))


def images_of_drives(
    plan: SurveyPlan, calibration: str, drives: Collection[str] | None = None, *, training: bool = True
) -> dict[str, DriveImages]:
    """Return the images of each drive of a survey, or of the named ones; `training` needs some of training drives."""
    with_images, without = {}, []
    for drive, files in plan.passes().items():
        if drives is not None and drive not in drives:
            continue
        path = Path(files[0].source.path).parent / calibration
        images = read_images(path) if path.is_file() else SurveyImages(())
        if len(images):
            with_images[drive] = DriveImages(str(path), images)
        else:
            without.append(drive)
    if not with_images or (training and not training_keys(with_images)):
        absent = "no drive" if not with_images else "no training drive"
        raise ReadError(
            f"labels through images need images: {absent} of the survey has a {calibration} with images beside its "
            f"points, such as {Path(plan.files[0].source.path).parent / calibration}"
        )
    if without:
        logger.warning("Drives without images, whose points no camera sees: %s", ", ".join(without))
    return with_images


class LabelledImages(Sequence[tuple[NDArray[np.uint8], NDArray[np.int16]]]):
    """Images and their labels, read on access; the first GiB stays in memory."""

    def __init__(self, drives: Sequence[DriveImages], folder: str, scheme: ClassScheme) -> None:
        self._images = [image for drive in drives for image in drive.images]
        self._folder, self._scheme = folder, scheme
        self._cache: dict[int, tuple[NDArray[np.uint8], NDArray[np.int16]]] = {}
        self._room = _CACHE_BYTES

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self._images)

    def __getitem__(self, index: Any) -> Any:
        """Return an image and its labels."""
        if index in self._cache:
            return self._cache[index]
        image = self._images[index]
        codes = image.load_labels(self._folder)
        labels = encode_label_image(codes, self._scheme, source=f"labels of image {image.name!r}")
        pair = image.load(), labels
        if pair[0].nbytes + labels.nbytes <= self._room:
            self._room -= pair[0].nbytes + labels.nbytes
            self._cache[index] = pair
        return pair


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
    from mlsroad_pipeline.papers.tomic2019.image_labels import labeller, segmentation  # noqa: PLC0415  they import torch

    masked = segmentation.segmentation_of(model)["source"] == segmentation.MASKS
    images = SurveyImages(()) if calibration is None else read_images(calibration, images=None if masked else pictures)
    if masked and pictures is not None:
        images = with_masks(images, pictures)
        known = MaskLegend(segmentation.legend_of(model), bundle_scheme(model))
    places = scene.xyz[scene["core"], :2]
    low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
    near = [
        (image.group, image.camera, partial(read_mask, image.path, image.camera, known) if masked else image.load)
        for image in images.relative_to(scene.origin)
        if ((image.camera.centre[:2] >= low) & (image.camera.centre[:2] <= high)).all()
    ]
    return labeller.label_scene(scene, around, near, model)
