"""Images of a survey to label: discovery, checks, and selection for a scene."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.members import member
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.algorithms.scenes.corridor import Corridor
from mlsroad_pipeline.algorithms.scenes.spans import SceneSpan
from mlsroad_pipeline.surveys.images import PosedImage, SurveyImages
from mlsroad_pipeline.surveys.masks import masks_of_drives
from mlsroad_pipeline.surveys.plan import PlannedFile, SurveyPlan, trajectory_beside

logger = logging.getLogger(__name__)

IMAGE_LABELS, FUSION = "image_labels", "fusion"


@dataclass(frozen=True)
class LabelImages:
    """Images of a survey by drive; empty for methods without images."""

    drives: Mapping[str, SurveyImages]  # Key of a drive to its images; drives without images are left out
    reach: float = 0.0  # Largest distance along the road between a scene and the cameras of its images, metres

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras, sorted."""
        return tuple(sorted({group for images in self.drives.values() for group in images.groups}))


def images_to_label(plan: SurveyPlan, bundle: ModelBundle, name: str | None, masks: str | None = None) -> LabelImages:
    """Return the images of a survey that a model uses, or the masks in their place, and check their files."""
    if not needs_images(bundle.slug):
        return LabelImages({})
    with_images, without = {}, []
    for drive, files in plan.drives().items():
        images = images_beside(files, name)
        if len(images):
            with_images[drive] = images
        else:
            without.append(_place_of(files))
    network = member(bundle, IMAGE_LABELS)
    reach = float(network.metadata["parameters"]["reach"])
    result = LabelImages(with_images, reach)
    place = Path(plan.files[0].source.path).parent / (name or "calibration.json")
    if not with_images and bundle.slug == IMAGE_LABELS:
        raise ReadError(
            f"label.method {IMAGE_LABELS!r} needs images: there is no {place} with images; use label.method {FUSION!r} "
            "for surveys without images"
        )
    if without:
        logger.warning(
            "No images (%s) beside the points of %s: %s", place.name, ", ".join(without), effect_without_images(bundle)
        )
    if bundle.slug == FUSION:
        _check_cameras(result.cameras, bundle)
    if network.metadata.get("segmentation", {}).get("source") == "masks":
        if masks is None:
            raise ParameterError(f"model {bundle.slug!r} labels through masks: set image_labels.masks to their folder")
        return LabelImages(masks_of_drives(with_images, masks), reach)
    for images in with_images.values():
        for image in images:
            image.check()
    return result


def effect_without_images(bundle: ModelBundle) -> str:
    """Return what the points of a drive without images get, as a clause."""
    return f"its points have {'no class' if bundle.slug == IMAGE_LABELS else 'the labels of the features alone'}"


def images_of_survey(plan: SurveyPlan, name: str | None) -> dict[str, SurveyImages]:
    """Return the images of each drive that has some; log a warning for the others."""
    found = {drive: images_beside(files, name) for drive, files in plan.drives().items()}
    without = [_place_of(files) for drive, files in plan.drives().items() if not len(found[drive])]
    if without:
        logger.warning("No images (%s) beside the points of %s: no photos of objects", name, ", ".join(without))
    return {drive: images for drive, images in found.items() if len(images)}


def _place_of(files: Sequence[PlannedFile]) -> str:
    """Return the folder of the points of a drive for messages: its name below the root, or the path of the root."""
    source = files[0].source
    return str(Path(source.path).parent) if source.folder == "." else source.folder


def images_beside(files: Sequence[PlannedFile], name: str | None) -> SurveyImages:
    """Return the images of a drive from the file `name` beside its points, or from a path."""
    path = None if name is None else Path(files[0].source.path).parent / name
    if path is None or not path.is_file():
        return SurveyImages(())
    from mlsroad_pipeline.surveys.camera_files import read_images  # noqa: PLC0415  few methods use images

    return read_images(path, trajectory=trajectory_beside(files))


def _check_cameras(cameras: Sequence[str], bundle: ModelBundle) -> None:
    known = list(bundle.metadata["cameras"])
    unknown = [camera for camera in cameras if camera not in known]
    if unknown:
        raise DataError(
            f"the survey has a camera {unknown[0]!r}; model {bundle.slug!r} was trained with the cameras "
            f"{', '.join(known)}: rename it, or use label.method {IMAGE_LABELS!r}"
        )


def views_of_scene(
    span: SceneSpan, images: SurveyImages, corridor: Corridor, *, bin_length: float, reach: float
) -> tuple[PosedImage, ...]:
    """Return the images taken within `reach` of a scene along the corridor; all images without a corridor."""
    if corridor is None or len(images) == 0:
        return tuple(images)
    centres: NDArray[np.float64] = np.array([image.camera.centre for image in images])
    station, _ = corridor.locate(centres, origin=images.origin)
    near = (station >= span.first * bin_length - reach) & (station <= span.stop * bin_length + reach)
    return tuple(image for image, chosen in zip(images, near, strict=True) if chosen)
