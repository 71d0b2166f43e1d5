"""Worker functions of the study of Tomic et al. 2019: simulate surveys, label them by both methods, fuse."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.cameras.cityscapes import (
    encode_label_image,
    image_classes,
    point_probabilities,
)
from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters, StageParameters
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.pool.log_linear import PoolParameters
from mlsroad_pipeline.algorithms.stages import build_supervoxels, describe_supervoxels, find_ground
from mlsroad_pipeline.papers.shared.studies.streets import cut_street, survey_path, timed
from mlsroad_pipeline.papers.tomic2019.detrended_forest.labeller import (
    nearest_supervoxels,
    prepare,
    supervoxel_probabilities,
)
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import ForestParameters, training_rows
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import fit as fit_forest
from mlsroad_pipeline.papers.tomic2019.image_labels import labeller as image_labeller
from mlsroad_pipeline.papers.tomic2019.image_labels.labeller import label_through_images
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet_weights import from_arrays
from mlsroad_pipeline.papers.tomic2019.image_labels.segmentation import segment_image
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import ImageLabelsParameters
from mlsroad_pipeline.papers.tomic2019.image_labels.visibility import visibility_method
from mlsroad_pipeline.papers.tomic2019.study.scores import TestSet, fuse_test_sets
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters
from mlsroad_pipeline.simulation.runtime.survey import Survey, simulate_survey

COLUMNS = ("rgb", "intensity", "label")
"""Point attributes that the study keeps."""

Arrays = Mapping[str, NDArray]
Part = Literal["train", "test", "test1", "test2"]


@dataclass(frozen=True)
class Division:
    """Division of a survey along the road: a training half, test set 1 and test set 2, a quarter each."""

    length: float  # Length of the survey, metres
    # Road between the parts that belongs to none, metres. A larger gap keeps objects from lying in two parts.
    gap: float = 10.0

    def __post_init__(self) -> None:
        if not 0 <= self.gap < self.length / 4:
            raise ParameterError(
                f"tomic2019_study.gap must be at least 0 and below a quarter of the survey's {self.length:g} m, "
                f"got {self.gap!r}"
            )

    def rows(self, station: NDArray[np.floating], part: Part) -> NDArray[np.int64]:
        """Return the points of a part."""
        half, quarter, margin = self.length / 2, 0.75 * self.length, self.gap / 2
        low, high = {
            "train": (-np.inf, half - margin),
            "test": (half + margin, np.inf),
            "test1": (half + margin, quarter - margin),
            "test2": (quarter + margin, np.inf),
        }[part]
        rows = np.flatnonzero((station >= low) & (station <= high))
        if not len(rows):
            raise DataError(f"no point of the survey lies in the part {part!r} of its road")
        return rows


@dataclass(frozen=True)
class ForestVariant:
    """Parameters of a feature-based method."""

    forest: ForestParameters  # forest
    stages: StageParameters  # ground filter, supervoxels and features
    columns: Sequence[str]  # point attributes that it uses
    names: Sequence[str] | None = None  # names of its features, without detrended ones; None means all

    def chosen_features(self, names: Sequence[str]) -> NDArray[np.int64]:
        """Return the columns of the features that are used."""
        if self.names is None:
            return np.arange(len(names))
        return np.flatnonzero([name.removesuffix("_detrended") in self.names for name in names])


def make_survey(*, simulation: SimulationParameters, ground: GroundParameters) -> dict[str, Any]:
    """Simulate a survey with images."""
    survey = simulate_survey(simulation, n_threads=1)
    source = f"street of seed {simulation.seed}"
    cloud, station = cut_street(survey, ground=ground, columns=COLUMNS, source=source)
    columns = {**cloud.columns, "station": station.astype(np.float32)}
    return {"points": replace(cloud, columns=columns), "images": pack_images(survey)}


def make_photographs(*, simulation: SimulationParameters) -> dict[str, Any]:
    """Simulate a survey and keep only its images."""
    return {"images": pack_images(simulate_survey(simulation, n_threads=1))}


def pack_images(survey: Survey) -> dict[str, NDArray]:
    """Return the images of a survey as arrays."""
    images = survey.images
    packed = {
        name: np.stack([getattr(image, name) for image in images])
        for name in ("rgb", "label", "K", "distortion", "R", "t")
    }
    places = np.stack([-image.R.T @ image.t for image in images])
    station, _ = survey_path(survey).locate(places, origin=survey.origin)
    return {**packed, "camera": np.array([image.camera for image in images]), "station": station}


def train_network(
    photographs: Mapping[str, Arrays], *, parameters: ImageLabelsParameters, scheme: ClassScheme
) -> dict[str, Any]:
    """Train the network on images of other streets."""
    samples = [
        (rgb, encode_label_image(label, scheme))
        for images in photographs.values()
        for rgb, label in zip(images["rgb"], images["label"], strict=True)
    ]
    (bundle, losses), seconds = timed(
        image_labeller.fit, samples, parameters=parameters, scheme=scheme, cameras=[], trained_on={}
    )
    facts = {"seconds": seconds, "images": len(samples), "loss": float(np.mean(losses[-50:]))}
    return {"weights": bundle.arrays, "facts": {name: np.array(value) for name, value in facts.items()}}


def train_and_label(
    points: PointCloud, training: PointCloud, *, variant: ForestVariant, division: Division, scheme: ClassScheme
) -> dict[str, Any]:
    """Train a forest on the training half of one survey and label the test half of another or the same."""

    def known(cloud: PointCloud, part: Part) -> PointCloud:
        kept = {name: column for name, column in cloud.columns.items() if name in variant.columns}
        return replace(cloud, columns=kept).select(division.rows(cloud["station"], part))

    (bundle, facts), trained = timed(_trained, known(training, "train"), variant, scheme)
    probabilities, labelled = timed(_point_probabilities, known(points, "test"), bundle)
    return {
        "labels": {"probabilities": probabilities.astype(np.float16)},
        "facts": {name: np.array(value) for name, value in {**facts, "seconds": trained + labelled}.items()},
    }


def _trained(cloud: PointCloud, variant: ForestVariant, scheme: ClassScheme) -> tuple[ModelBundle, dict[str, float]]:
    """Return a forest trained on the features of a variant, and its facts."""
    stages = variant.stages
    ground = find_ground(cloud, stages.ground)
    supervoxels = build_supervoxels(cloud, stages.supervoxels)
    features = describe_supervoxels(cloud, ground, supervoxels, stages.features)
    rows = training_rows(cloud, supervoxels, features, scheme=scheme)
    chosen = variant.chosen_features([str(name) for name in rows["names"]])
    rows = {**rows, "values": rows["values"][:, chosen], "names": rows["names"][chosen]}
    bundle, forest = fit_forest(
        [rows], parameters=variant.forest, stages=stages, scheme=scheme, trained_on={}, fallbacks=False
    )
    facts = {
        "supervoxels": len(rows["labels"]),
        "features": len(chosen),
        "out_of_bag": float(1.0 - forest.oob_error[-1]),
    }
    return bundle, facts


def _point_probabilities(cloud: PointCloud, bundle: ModelBundle) -> NDArray[np.float32]:
    _, supervoxels, features = prepare(cloud, bundle)
    table = supervoxel_probabilities(cloud, supervoxels, features, bundle)
    return table[nearest_supervoxels(cloud.xyz, features["centroids"])]


def label_by_images(
    points: PointCloud,
    images: Arrays,
    network: Arrays,
    *,
    parameters: ImageLabelsParameters,
    division: Division,
    scheme: ClassScheme,
) -> dict[str, Any]:
    """Segment the images of the test half of a survey and label its points through them."""
    model = from_arrays(network, n_classes=len(image_classes(scheme)), backbone=parameters.network.backbone)
    test = division.rows(points["station"], "test")
    low, high = points["station"][test].min(), points["station"][test].max()
    taken = np.flatnonzero((images["station"] >= low - parameters.reach) & (images["station"] <= high))
    around = np.flatnonzero(points["station"] >= low - parameters.reach)
    names = image_classes(scheme)
    matrix = np.zeros((len(names), len(names) + 1), dtype=np.int64)
    shown: dict[int, NDArray] = {}

    def segmented() -> Iterator[tuple[str, Camera, NDArray[np.float32]]]:
        for row in taken.tolist():
            scores = segment_image(
                model, images["rgb"][row], magnification=parameters.magnifications, window=parameters.window,
                overlap=parameters.overlap, flip=parameters.flip,
            )  # fmt: skip
            if images["station"][row] >= low:
                truth = encode_label_image(images["label"][row], scheme)
                matrix[:] += confusion_matrix(truth.ravel(), scores.argmax(axis=2).ravel(), len(names))
                shown[row] = scores.argmax(axis=2).astype(np.int16)
            flat = point_probabilities(scores.reshape(-1, len(names)), names, scheme)
            yield str(images["camera"][row]), _camera(images, row), flat.reshape(*scores.shape[:2], len(scheme))

    groups = sorted(set(images["camera"].tolist()))
    labels = label_through_images(
        points.xyz[around], segmented(), groups=groups, n_classes=len(scheme),
        visibility=visibility_method(parameters.visibility), max_distance=parameters.reach,
    )  # fmt: skip
    place = np.searchsorted(around, test)
    best = pictured(images, sorted(shown))
    return {
        "labels": {
            "probabilities": labels.probabilities[:, place].astype(np.float16),
            "n_images": labels.n_images[:, place],
            "cameras": np.array(groups),
        },
        "pixels": {"matrix": matrix, "segmented": shown[best], "image": np.array(best)},
    }


def _camera(images: Arrays, row: int) -> Camera:
    height, width = images["rgb"].shape[1:3]
    K, distortion, R, t = (images[name][row] for name in ("K", "distortion", "R", "t"))
    return Camera(K, distortion, R, t, width, height)


def pictured(images: Arrays, rows: Sequence[int], camera: str = "front_left") -> int:
    """Return the image for a figure: the first image of a camera with the most classes."""
    own = [row for row in rows if images["camera"][row] == camera] or list(rows)
    return max(own, key=lambda row: len(np.unique(images["label"][row])))


def fuse_survey(
    points: PointCloud,
    features: Arrays,
    images: Arrays,
    *,
    division: Division,
    scheme: ClassScheme,
    pool: PoolParameters,
) -> dict[str, Any]:
    """Fuse the labels of both methods for the test half of a survey."""
    half = division.rows(points["station"], "test")
    truth = scheme.encode(points["label"], source=points.source)

    def part(name: Part) -> TestSet:
        rows = division.rows(points["station"], name)
        at = np.searchsorted(half, rows)
        tables = (features["probabilities"][at], images["probabilities"][:, at])
        return TestSet(truth[rows], *(table.astype(np.float32) for table in tables))

    fused = fuse_test_sets(part("test1"), part("test2"), pool=pool)
    return {"answers": fused.labels, "results": {**fused.scores.to_arrays(), "cameras": images["cameras"]}}
