"""The images of a comparison's drives, and what workers do with them; torch is imported where it is needed."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.labels import ImagePredictions
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.image_labels.cityscapes import encode_label_image
from mlsroad_pipeline.algorithms.image_labels.training_parameters import ImageLabelsParameters
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.datasets.models.model_bundle_dataset import open_model
from mlsroad_pipeline.surveys.camera_files import read_images
from mlsroad_pipeline.surveys.images import SurveyImages
from mlsroad_pipeline.surveys.plan import SurveyPlan, training_keys

logger = logging.getLogger(__name__)

_KEPT = 2**30  # bytes of decoded images


@dataclass(frozen=True)
class DriveImages:
    """Where the images of a drive lie.

    Parameters
    ----------
    calibration : str
        The file of cameras and poses.
    images : SurveyImages
        The images.
    """

    calibration: str
    images: SurveyImages

    @property
    def folder(self) -> str:
        """The folder of the pictures."""
        return str(self.images[0].path.parent)


def images_of_drives(plan: SurveyPlan, calibration: str) -> dict[str, DriveImages]:
    """Find the images of each drive of a survey."""
    found, without = {}, []
    for drive, files in plan.drives().items():
        path = Path(files[0].source.path).parent / calibration
        images = read_images(path) if path.is_file() else SurveyImages(())
        if len(images):
            found[drive] = DriveImages(str(path), images)
        else:
            without.append(drive)
    if not training_keys(found):
        drives = "no drive" if not found else "no training drive"
        raise ReadError(
            f"labels through images need images: {drives} of the survey has a {calibration} with images beside its "
            f"points, such as {Path(plan.files[0].source.path).parent / calibration}"
        )
    if without:
        logger.warning("Drives without images, whose points no camera sees: %s", ", ".join(without))
    return found


class LabelledImages(Sequence[tuple[NDArray[np.uint8], NDArray[np.int16]]]):
    """Images and their labels, read when they are asked for; a gigabyte of them is kept.

    Parameters
    ----------
    drives : sequence of DriveImages
        Drives to learn from.
    folder : str
        Folder of the label images beside that of the pictures.
    scheme : ClassScheme
        The classes.
    """

    def __init__(self, drives: Sequence[DriveImages], folder: str, scheme: ClassScheme) -> None:
        self._images = [image for drive in drives for image in drive.images]
        self._folder, self._scheme = folder, scheme
        self._kept: dict[int, tuple[NDArray[np.uint8], NDArray[np.int16]]] = {}
        self._room = _KEPT

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self._images)

    def __getitem__(self, index: Any) -> Any:
        """Return an image and its labels."""
        if index in self._kept:
            return self._kept[index]
        image = self._images[index]
        codes = image.load_labels(self._folder)
        labels = encode_label_image(codes, self._scheme, source=f"labels of image {image.name!r}")
        pair = image.load(), labels
        if pair[0].nbytes + labels.nbytes <= self._room:
            self._room -= pair[0].nbytes + labels.nbytes
            self._kept[index] = pair
        return pair


def label_scene_through_images(
    scene: PointCloud, around: Sequence[PointCloud], model: str, calibration: str | None, pictures: str | None, *,
    reach: float,
) -> ImagePredictions:  # fmt: skip
    """Label a scene of a comparison with a stored model."""
    from mlsroad_pipeline.algorithms.image_labels import labeller  # noqa: PLC0415  it imports torch

    images = SurveyImages(()) if calibration is None else read_images(calibration, images=pictures)
    places = scene.xyz[scene["core"], :2]
    low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
    near = [
        (image.group, image.camera, image.load)
        for image in images.relative_to(scene.origin)
        if ((image.camera.centre[:2] >= low) & (image.camera.centre[:2] <= high)).all()
    ]
    return labeller.label_scene(scene, around, near, open_model(model))


def scenes_beside(key: str, keys: Iterable[str]) -> list[str]:
    """Name the scenes before and after a scene on its drive."""
    drive = [name for name in keys if SceneKey.parse(name).parent == SceneKey.parse(key).parent]
    place = drive.index(key)
    return [*drive[max(place - 1, 0) : place], *drive[place + 1 : place + 2]]


def train_on_drives(
    drives: Mapping[str, DriveImages],
    parameters: ImageLabelsParameters,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
) -> tuple[ModelBundle, list[float]]:
    """Train a network on the images of the training drives."""
    from mlsroad_pipeline.algorithms.image_labels import labeller  # noqa: PLC0415  it imports torch

    chosen = [drives[drive] for drive in training_keys(drives)]
    samples = LabelledImages(chosen, parameters.labels, scheme)
    cameras = sorted({group for images in drives.values() for group in images.images.groups})
    return labeller.fit(samples, parameters=parameters, scheme=scheme, cameras=cameras, trained_on=trained_on)
