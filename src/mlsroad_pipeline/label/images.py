"""Images of a survey to label: discovery, checks, selection for a scene, labels of a scene with them."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.cameras.legend import Legend
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.core.labels import ImagePredictions, PointLabels
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.labelling import label_cloud, member
from mlsroad_pipeline.algorithms.models.methods import METHODS, needs_images
from mlsroad_pipeline.algorithms.scenes.binning import BinnedCloud
from mlsroad_pipeline.algorithms.scenes.corridor import Corridor
from mlsroad_pipeline.algorithms.scenes.joining import SceneSpan, join_pieces
from mlsroad_pipeline.label.scene import LabelledScene, LabelSettings, label_new_scene
from mlsroad_pipeline.surveys.images import PosedImage, SurveyImages, read_picture
from mlsroad_pipeline.surveys.masks import MaskLegend, masks_of_passes, read_mask
from mlsroad_pipeline.surveys.plan import PlannedFile, SurveyPlan, trajectory_beside

logger = logging.getLogger(__name__)

IMAGE_LABELS, FUSION = "image_labels", "fusion"


@dataclass(frozen=True)
class LabelImages:
    """Images of a survey by pass; empty for methods without images."""

    passes: Mapping[str, SurveyImages]  # Key of a pass to its images; passes without images are left out
    reach: float = 0.0  # Largest distance along the road between a scene and the cameras of its images, metres

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras, sorted."""
        return tuple(sorted({group for images in self.passes.values() for group in images.groups}))


def images_to_label(plan: SurveyPlan, bundle: ModelBundle, name: str | None, masks: str | None = None) -> LabelImages:
    """Return the images of a survey that a model uses, or the masks in their place, and check their files."""
    if not needs_images(bundle.slug):
        return LabelImages({})
    with_images, without = {}, []
    for pass_key, files in plan.passes().items():
        images = images_beside(files, name)
        if len(images):
            with_images[pass_key] = images
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
        return LabelImages(masks_of_passes(with_images, masks), reach)
    for images in with_images.values():
        for image in images:
            image.check()
    return result


def effect_without_images(bundle: ModelBundle) -> str:
    """Return what the points of a pass without images get, as a clause."""
    return f"its points have {'no class' if bundle.slug == IMAGE_LABELS else 'the labels of the features alone'}"


def images_of_survey(plan: SurveyPlan, name: str | None) -> dict[str, SurveyImages]:
    """Return the images of each pass that has some; log a warning for the others."""
    found = {pass_key: images_beside(files, name) for pass_key, files in plan.passes().items()}
    without = [_place_of(files) for pass_key, files in plan.passes().items() if not len(found[pass_key])]
    if without:
        logger.warning("No images (%s) beside the points of %s: no photos of objects", name, ", ".join(without))
    return {pass_key: images for pass_key, images in found.items() if len(images)}


def _place_of(files: Sequence[PlannedFile]) -> str:
    """Return the folder of the points of a pass for messages: its name below the root, or the path of the root."""
    source = files[0].source
    return str(Path(source.path).parent) if source.folder == "." else source.folder


def images_beside(files: Sequence[PlannedFile], name: str | None) -> SurveyImages:
    """Return the images of a pass from the file `name` beside its points, or from a path."""
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


FEATURES = "detrended_forest"
"""Member of a fusion model that labels by features of the points."""

MAX_OCCLUDERS = 2_000_000
"""Largest number of points around a scene that are tested for occlusion; more points are thinned by a whole step."""


class CameraView(NamedTuple):
    """An image that may show a scene."""

    name: str
    group: str
    camera: Camera


class SceneViews(NamedTuple):
    """Images that may show a scene, and what their use needs."""

    views: tuple[CameraView, ...]
    cameras: tuple[str, ...]
    """Names of all cameras of the pass."""
    origin: NDArray[np.float64]
    """World coordinates that the camera poses are relative to, metres."""
    reach: int
    """Bins beyond the scene whose points may occlude it."""


class ImageLabeller:
    """Labeller of a model that uses images, for `label_cloud`."""

    def __init__(
        self,
        views: Sequence[tuple[str, Camera, Callable[[], NDArray]]],
        around: NDArray[np.floating],
        cameras: Sequence[str],
    ) -> None:
        self._views, self._around, self._cameras = views, around, cameras
        self.seen: NDArray[np.bool_] | None = None

    def __call__(self, cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.integer], NDArray[np.floating]]:
        """Return label and confidence of each point."""
        if bundle.slug != FUSION:
            by_images = self._label(cloud, bundle, self._cameras)
            return by_images["label"], by_images["confidence"]
        label, confidence = label_cloud(member(bundle, FEATURES), cloud)
        if self._cameras:
            by_images = self._label(cloud, member(bundle, IMAGE_LABELS), bundle.metadata["cameras"])
            by_features: PointLabels = {
                "label": label.astype(np.int16),
                "confidence": confidence.astype(np.float32),
            }
            fused = METHODS[FUSION].load("use")(by_features, by_images, bundle)
            label, confidence = fused["label"], fused["confidence"]
        return label, confidence

    def _label(self, cloud: PointCloud, bundle: ModelBundle, cameras: Sequence[str]) -> ImagePredictions:
        label_points = METHODS[IMAGE_LABELS].function(".labeller:label_points")
        by_images: ImagePredictions = label_points(cloud, [self._around], self._views, bundle, cameras=cameras)
        self.seen = by_images["seen"]
        return by_images


def _reader(model: ModelBundle) -> Callable[[str, Camera, str], NDArray]:
    """Return the function that reads a picture, or for a model of masks the class probabilities of its pixels."""
    network = member(model, IMAGE_LABELS)
    stored = network.metadata.get("segmentation", {})
    if stored.get("source") != "masks":
        return read_picture
    known = MaskLegend(Legend.from_json(stored["classes"]), bundle_scheme(network))
    return lambda path, camera, _: read_mask(path, camera, known)


def points_around(
    pieces: Sequence[Mapping[str, NDArray]], span: SceneSpan, reach: int, origin: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the points up to `reach` bins before and behind a scene that are not in its buffers."""
    before, behind = (span.first - reach, span.buffer_first), (span.buffer_stop, span.stop + reach)
    parts = [BinnedCloud.from_arrays(piece).between(*side) for piece in pieces for side in (before, behind)]
    step = -(-sum(map(len, parts)) // MAX_OCCLUDERS) or 1
    thinned = [part.cloud.xyz[::step] + (part.cloud.origin - origin) for part in parts if len(part)]
    return np.concatenate([np.zeros((0, 3)), *thinned]).astype(np.float32)


def label_pieces_with_images(
    pieces: Sequence[Mapping[str, NDArray]],
    around: Sequence[Mapping[str, NDArray]],
    pictures: Sequence[str],
    model: ModelBundle,
    *,
    images: SceneViews,
    span: SceneSpan,
    settings: LabelSettings,
    name: str,
    source: str,
) -> LabelledScene:
    """Join the pieces of a scene and label it with a model that uses images."""
    scene = join_pieces(pieces, span, settings.outliers, source)
    shift = scene.origin - images.origin
    read = _reader(model)
    views = [
        (view.group, view.camera.shifted(shift), partial(read, path, view.camera, view.name))
        for path, view in zip(pictures, images.views, strict=True)
    ]
    labeller = ImageLabeller(views, points_around(around, span, images.reach, scene.origin), images.cameras)
    labelled = label_new_scene(scene, model, settings, name=name, labeller=labeller)
    if labeller.seen is not None:
        labelled["counts"]["seen"] = np.array([(labeller.seen & scene["core"]).sum()])
    return labelled
