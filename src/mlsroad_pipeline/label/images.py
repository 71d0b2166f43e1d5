"""The images of a survey that `label` labels: where they lie, whether they are whole, and which show a scene."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.members import member
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.algorithms.scenes.corridor import Corridor
from mlsroad_pipeline.algorithms.scenes.tiling import SceneSpan
from mlsroad_pipeline.surveys.images import PosedImage, SurveyImages
from mlsroad_pipeline.surveys.plan import PlannedFile, SurveyPlan, trajectory_beside

logger = logging.getLogger(__name__)

IMAGE_LABELS, FUSION = "image_labels", "fusion"


@dataclass(frozen=True)
class LabelImages:
    """The images of a survey, as far as the method looks at any.

    Parameters
    ----------
    drives : mapping of str to SurveyImages
        Drive to its images; drives without are left out.
    reach : float
        Farthest camera from a scene, along the road, whose images are looked at, metres.
    """

    drives: Mapping[str, SurveyImages]
    reach: float = 0.0

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the survey's cameras, in the order of the alphabet."""
        return tuple(sorted({group for images in self.drives.values() for group in images.groups}))


def images_to_label(plan: SurveyPlan, bundle: ModelBundle, name: str | None) -> LabelImages:
    """Find the images of a survey, and look whether all pictures are there."""
    if not needs_images(bundle.slug):
        return LabelImages({})
    found, without = {}, []
    for drive, files in plan.drives().items():
        images = _images_beside(files, name)
        if len(images):
            found[drive] = images
        else:
            without.append(drive)
    reach = float(member(bundle, IMAGE_LABELS).metadata["parameters"]["reach"])
    result = LabelImages(found, reach)
    place = Path(plan.files[0].source.path).parent / (name or "calibration.json")
    if not found and bundle.slug == IMAGE_LABELS:
        raise ReadError(
            f"label.method {IMAGE_LABELS!r} needs images: there is no {place} with images; label.method {FUSION!r} "
            f"labels a survey with and without"
        )
    if without:
        instead = "have no class" if bundle.slug == IMAGE_LABELS else "have the labels of the features alone"
        logger.warning("No images (%s) for %s: the points there %s", place.name, ", ".join(without), instead)
    if bundle.slug == FUSION:
        _check_cameras(result.cameras, bundle)
    for images in found.values():
        for image in images:
            image.check()
    return result


def _images_beside(files: Sequence[PlannedFile], name: str | None) -> SurveyImages:
    """Return the images of a drive; a name that is a path is the file itself."""
    path = None if name is None else Path(files[0].source.path).parent / name
    if path is None or not path.is_file():
        return SurveyImages(())
    from mlsroad_pipeline.surveys.camera_files import read_images  # noqa: PLC0415  most methods look at no images

    return read_images(path, trajectory=trajectory_beside(files))


def _check_cameras(cameras: Sequence[str], bundle: ModelBundle) -> None:
    known = list(bundle.metadata["cameras"])
    strange = [camera for camera in cameras if camera not in known]
    if strange:
        raise DataError(
            f"the survey has a camera {strange[0]!r}; model {bundle.slug!r} has learned how far to believe the cameras "
            f"{', '.join(known)}: rename it, or use label.method {IMAGE_LABELS!r}"
        )


def views_of_scene(
    span: SceneSpan, images: SurveyImages, corridor: Corridor, *, bin_length: float, reach: float
) -> tuple[PosedImage, ...]:
    """Choose the images that may show a scene."""
    if corridor is None or len(images) == 0:
        return tuple(images)
    centres: NDArray[np.float64] = np.array([image.camera.centre for image in images])
    station, _ = corridor.locate(centres, origin=images.origin)
    near = (station >= span.first * bin_length - reach) & (station <= span.stop * bin_length + reach)
    return tuple(image for image, chosen in zip(images, near, strict=True) if chosen)
