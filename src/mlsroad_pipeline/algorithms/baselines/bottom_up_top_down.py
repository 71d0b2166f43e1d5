"""Bottom-up and top-down descriptors, a rival of Yu et al. 2016 (V-E): spin images propose, Gaussian images verify.

After Patterson et al. 2008 (ECCV); `docs/methods/bottom_up_top_down.md` says how it is read.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines._surface_kernels import nearest_images, overlap_surfaces
from mlsroad_pipeline.algorithms.baselines.object_parts import relative_centres
from mlsroad_pipeline.algorithms.baselines.oriented_points import OrientedPointParameters, describe_surfaces
from mlsroad_pipeline.algorithms.cell_grid import run_in_chunks
from mlsroad_pipeline.algorithms.classes import ClassScheme
from mlsroad_pipeline.algorithms.detection import DetectionParameters, best_threshold
from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.features.gaussian_image import align_gaussian_images, compute_gaussian_images
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.algorithms.object_detectors import (
    GEOMETRY,
    Description,
    DetectionStages,
    choose_queries,
    detections_of,
    label_detected_objects,
    object_bounds,
    sample_objects,
    select_objects,
    train_object_detector,
    variant_arrays,
)
from mlsroad_pipeline.algorithms.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.validation import check_positive

SLUG = "bottom_up_top_down"
ENTRY_POINT = "mlsroad_pipeline.algorithms.baselines.bottom_up_top_down:label_cloud"

_ARRAYS = (
    "images", "image_kinds", "centres", "normals", "objects", "kinds", "least_shares", "exponents", "thresholds",
    "geometry",
)  # fmt: skip


@dataclass(frozen=True)
class BottomUpTopDownParameters:
    """All parameters of the method.

    Parameters
    ----------
    surfaces : OrientedPointParameters or mapping
        Oriented points and their spin images.
    max_images : int, default 500
        The most spin images of a class in the database, and three times as many of all others.
    reach : float, default 0.5
        Distance from which points of two aligned surfaces do not overlap, metres.
    n_steps : int, default 2
        Corrections of the alignment by the mean step to the nearest points.
    n_azimuths, n_bands : int, default 36, 5
        Cells of the Gaussian images.
    least_shares : sequence of float, default (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
        Shares of a class among the nearest spin images from which an object is a hypothesis; the best on the training
        objects is taken.
    exponents : sequence of float, default (0.0, 0.5, 1.0)
        Powers of that share that the overlap is multiplied with, likewise: 0 is the paper's, where spin images only
        propose.
    max_models : int, default 12
        The most models of a class that hypotheses are aligned with.
    candidates : int, default 24
        Training objects of a class that may become models: drawn at random.
    max_per_class, max_others : int, default 150, 600
        The most training objects of a class, and of all others, that database and models are chosen on.
    seed : int, default 2016
        Seed of the samples.

    Raises
    ------
    ParameterError
        If a number is outside its domain.
    """

    surfaces: OrientedPointParameters = field(default_factory=OrientedPointParameters)
    max_images: int = 500
    reach: float = 0.5
    n_steps: int = 2
    n_azimuths: int = 36
    n_bands: int = 5
    least_shares: Sequence[float] = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    exponents: Sequence[float] = (0.0, 0.5, 1.0)
    max_models: int = 12
    candidates: int = 24
    max_per_class: int = 150
    max_others: int = 600
    seed: int = 2016

    def __post_init__(self) -> None:
        if isinstance(self.surfaces, Mapping):
            object.__setattr__(self, "surfaces", OrientedPointParameters(**self.surfaces))
        for name in ("max_images", "n_bands", "max_models", "candidates", "max_per_class"):
            if getattr(self, name) < 1:
                raise ParameterError(f"{SLUG}.{name} must be at least 1, got {getattr(self, name)!r}")
        for name in ("n_steps", "max_others"):
            if getattr(self, name) < 0:
                raise ParameterError(f"{SLUG}.{name} must not be negative, got {getattr(self, name)!r}")
        check_positive(self.reach, f"{SLUG}.reach")
        if not self.least_shares or not self.exponents:
            raise ParameterError(f"{SLUG}.least_shares and {SLUG}.exponents must name at least one value")


@dataclass(frozen=True)
class BottomUpTopDown:
    """A database of spin images, and models of the classes.

    Parameters
    ----------
    images : ndarray of float32, shape (d, 153)
        The database.
    image_kinds : ndarray of int16, shape (d,)
        Class of each image, -1 for others.
    models : mapping
        Description of the models, without their spin images.
    kinds : ndarray of int16, shape (p,)
        Class of each model.
    least_shares, exponents, thresholds : ndarray of float64, shape (c,)
        See `BottomUpTopDownParameters`; score from which an object is detected.
    geometry : ndarray of float64, shape (4,)
        Reach, corrections, azimuths and bands.
    """

    images: NDArray[np.float32]
    image_kinds: NDArray[np.int16]
    models: Description
    kinds: NDArray[np.int16]
    least_shares: NDArray[np.float64]
    exponents: NDArray[np.float64]
    thresholds: NDArray[np.float64]
    geometry: NDArray[np.float64]

    def score(self, parts: Description) -> NDArray[np.float32]:
        """Propose by spin images, verify by overlap.

        Parameters
        ----------
        parts : mapping
            What `describe_surfaces` gave.

        Returns
        -------
        ndarray of float32, shape (n, c)
            Overlap with the best model of each class, times a power of the share; 0 for what is no hypothesis.
        """
        owner = np.full(len(self.images), -1, np.int32)
        shares = class_shares(parts, self.images, self.image_kinds, owner, n_classes=len(self.thresholds))
        hypothesis = (shares >= self.least_shares) & (shares > 0)
        found = overlaps(parts, self.models, self.geometry, wanted=hypothesis[:, self.kinds])
        best = [found[:, self.kinds == k].max(axis=1, initial=0.0) for k in range(len(self.thresholds))]
        return (np.column_stack(best) * hypothesis * shares**self.exponents).astype(np.float32)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return what was learned as plain arrays."""
        own = {name: self.models[name] for name in ("centres", "normals", "objects")}
        names = [name for name in _ARRAYS if name not in own]
        return {**own, **{name: np.asarray(getattr(self, name)) for name in names}}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild a detector from what `to_arrays` gave.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            The arrays.

        Returns
        -------
        BottomUpTopDown
            The detector.

        Raises
        ------
        DataError
            If an array is missing.
        """
        missing = [name for name in _ARRAYS if name not in arrays]
        if missing:
            raise DataError(f"the arrays of a bottom-up and top-down detector lack {', '.join(missing)}")
        own = {name: np.asarray(arrays[name]) for name in ("centres", "normals", "objects")}
        own |= {"n_objects": np.array(len(arrays["kinds"])), "intensity": np.array(False)}
        rest = {name: np.asarray(arrays[name]) for name in _ARRAYS if name not in own}
        return cls(models=own, **rest)


def class_shares(
    parts: Description,
    images: NDArray[np.float32],
    kinds: NDArray[np.int16],
    owner: NDArray[np.int32],
    *,
    n_classes: int,
    n_threads: int = 1,
) -> NDArray[np.float64]:
    """Return which share of the spin images of each object has its nearest neighbour in each class.

    Parameters
    ----------
    parts : mapping
        What `describe_surfaces` gave.
    images : ndarray of float32, shape (d, b)
        The database.
    kinds : ndarray of int16, shape (d,)
        Class of its images, -1 for others.
    owner : ndarray of int32, shape (d,)
        Object of `parts` that each is of, which is not compared with itself; -1 for none.
    n_classes : int
        Number of classes.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    ndarray of float64, shape (n, n_classes)
        Shares.

    Raises
    ------
    DataError
        If the images have another size than those of the database.
    """
    own = np.ascontiguousarray(parts["images"], dtype=np.float32)
    if own.shape[1] != images.shape[1]:
        raise DataError(f"spin images of {own.shape[1]} bins, the database has {images.shape[1]}")
    nearest = np.empty(len(own), np.int32)

    def work(start: int, stop: int) -> None:
        nearest_images(own, parts["objects"], images, owner, nearest, start, stop)

    run_in_chunks(work, len(own), n_threads=n_threads)
    found = np.where(nearest >= 0, kinds[nearest], -1)
    n = int(parts["n_objects"])
    out = np.zeros((n, n_classes))
    for k in range(n_classes):
        out[:, k] = np.bincount(parts["objects"][found == k], minlength=n)
    return out / np.maximum(np.diff(object_bounds(parts)), 1)[:, None]


def overlaps(
    parts: Description,
    models: Description,
    geometry: NDArray[np.float64],
    *,
    wanted: NDArray[np.bool_],
    n_threads: int = 1,
) -> NDArray[np.float64]:
    """Align models with objects by their Gaussian images, and measure how the surfaces overlap.

    Parameters
    ----------
    parts, models : mapping
        Descriptions of the objects and of the models.
    geometry : ndarray of float64, shape (4,)
        See `BottomUpTopDown`.
    wanted : ndarray of bool, shape (n, p)
        Pairs that are compared.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    ndarray of float64, shape (n, p)
        The smaller of the shares of model and object that the other covers, points counting less the farther they
        are; 0 for pairs that are not compared.
    """
    reach, n_steps, n_azimuths, n_bands = geometry.tolist()
    bounds, model_bounds = object_bounds(parts), object_bounds(models)
    ours, theirs = (
        compute_gaussian_images(found["normals"], at, n_azimuths=int(n_azimuths), n_bands=int(n_bands))
        for found, at in ((parts, bounds), (models, model_bounds))
    )
    turns = align_gaussian_images(ours, theirs)[0] * (2.0 * np.pi / n_azimuths)
    points, model_points = relative_centres(parts), relative_centres(models)
    out = np.zeros(wanted.shape)

    def work(start: int, stop: int) -> None:
        overlap_surfaces(
            model_points, model_bounds, points, bounds, turns, wanted, reach, int(n_steps), out, start, stop
        )

    run_in_chunks(work, len(out), n_threads=n_threads)
    return out


def fit_bottom_up_top_down(
    parts: Description,
    labels: NDArray[np.int16],
    *,
    parameters: BottomUpTopDownParameters,
    n_classes: int,
    n_threads: int = 1,
) -> tuple[BottomUpTopDown, dict[str, Any]]:
    """Choose database, models and thresholds on training objects, of which none is compared with itself.

    Parameters
    ----------
    parts : mapping
        Surfaces of the training objects.
    labels : ndarray of int16, shape (n,)
        Class of each object, -1 for others.
    parameters : BottomUpTopDownParameters
        Parameters.
    n_classes : int
        Wanted classes.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    detector : BottomUpTopDown
        The detector.
    facts : dict
        Images, models, what was chosen, and the F-score of each class on the training objects.
    """
    p = parameters
    drawn = sample_objects(labels, max_per_class=p.max_per_class, max_others=p.max_others, seed=p.seed)
    sample, truth = select_objects(parts, drawn), labels[drawn]
    rows = sample_objects(
        truth[sample["objects"]], max_per_class=p.max_images, max_others=3 * p.max_images, seed=p.seed
    )
    owner = np.ascontiguousarray(sample["objects"][rows])
    images, image_kinds = np.ascontiguousarray(sample["images"][rows]), truth[owner].astype(np.int16)
    # Thresholds are chosen on all objects, drawn or not: among the drawn ones others are rarer than in a street.
    known = drawn[owner].astype(np.int32)
    every_share = class_shares(parts, images, image_kinds, known, n_classes=n_classes, n_threads=n_threads)
    shares = every_share[drawn]
    geometry = np.array([p.reach, p.n_steps, p.n_azimuths, p.n_bands], dtype=np.float64)
    rng = np.random.default_rng(p.seed)
    models: list[NDArray[np.int64]] = []
    chosen: list[tuple[float, float, float, float]] = []
    for k in range(n_classes):
        mine = np.flatnonzero((truth == k) & (np.diff(object_bounds(sample)) > 0))
        if len(mine) > p.candidates:
            mine = np.sort(rng.choice(mine, p.candidates, replace=False))
        every = np.ones((len(truth), len(mine)), dtype=np.bool_)
        found = overlaps(sample, select_objects(sample, mine), geometry, wanted=every, n_threads=n_threads)
        queries, gate = _choose_models(found, shares[:, k], mine, truth == k, p)
        models.append(np.sort(mine[queries]))
        wanted = (every_share[:, k] >= gate[0]) & (every_share[:, k] > 0)
        asked = np.repeat(wanted[:, None], len(queries), axis=1)
        found = overlaps(parts, select_objects(sample, models[k]), geometry, wanted=asked, n_threads=n_threads)
        found[drawn[models[k]], np.arange(len(queries))] = 0.0
        scores = found.max(axis=1) * np.where(wanted, every_share[:, k] ** gate[1], 0.0)
        chosen.append((*best_threshold(scores, labels == k), *gate))
    every_model = np.concatenate(models)
    order = np.argsort(every_model)
    kinds = np.repeat(np.arange(n_classes), [len(found) for found in models])[order].astype(np.int16)
    described = select_objects({name: sample[name] for name in sample if name != "images"}, every_model[order])
    reached, thresholds, least, exponents = (np.array(values) for values in zip(*chosen, strict=True))
    detector = BottomUpTopDown(images, image_kinds, described, kinds, least, exponents, thresholds, geometry)
    return detector, {
        "images": len(images), "models": [len(found) for found in models], "least_shares": least.tolist(),
        "exponents": exponents.tolist(), "f_scores": reached.tolist(),
    }  # fmt: skip


def _choose_models(
    found: NDArray, share: NDArray, mine: NDArray[np.int64], truth: NDArray[np.bool_], p: BottomUpTopDownParameters
) -> tuple[list[int], tuple[float, float]]:
    """Return the models of a class, and the least share and the exponent that are best with them."""
    best: tuple[list[int], tuple[float, float]] = ([], (0.0, 0.0))
    reached = -1.0
    for exponent in p.exponents:
        for least in p.least_shares:
            gate = np.where((share >= least) & (share > 0), share**exponent, 0.0)
            alike = (found * gate[:, None]).T
            queries, _, f_score = choose_queries(alike, mine, truth, max_queries=p.max_models)
            if f_score > reached:
                reached, best = f_score, (queries, (least, exponent))
    return best


def train_bottom_up_top_down(
    parts: Mapping[str, Description],
    labels: Mapping[str, Mapping[str, NDArray]],
    *,
    parameters: BottomUpTopDownParameters,
    stages: DetectionStages,
    detection: DetectionParameters,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
    n_threads: int = 1,
) -> ModelBundle:
    """Train a model on the objects that the training scenes own.

    Parameters
    ----------
    parts : mapping of str to mapping
        What `describe_surfaces` gave for each training scene.
    labels : mapping of str to mapping
        What `object_classes` gave for each of them.
    parameters : BottomUpTopDownParameters
        Parameters of the method.
    stages : DetectionStages
        How the scenes were prepared.
    detection : DetectionParameters
        The wanted classes.
    scheme : ClassScheme
        The classes.
    trained_on : mapping
        What the metadata say of the training data; JSON values.
    n_threads : int, default 1
        Threads; the model does not depend on it.

    Returns
    -------
    ModelBundle
        The model.

    Raises
    ------
    DataError
        If there are no training scenes, or a wanted class has no object.
    """
    n = len(detection.classes)

    def fit(joined: Description, truth: NDArray[np.int16], _: bool) -> tuple[BottomUpTopDown, dict[str, Any]]:
        return fit_bottom_up_top_down(joined, truth, parameters=parameters, n_classes=n, n_threads=n_threads)

    return train_object_detector(
        parts, labels, fit, slug=SLUG, entry_point=ENTRY_POINT, parameters=parameters,
        uses_intensity=False, stages=stages, detection=detection, scheme=scheme, trained_on=trained_on,
    )  # fmt: skip


def detect_scene(parts: Description, bundle: ModelBundle) -> dict[str, NDArray]:
    """Detect the objects of a scene.

    Parameters
    ----------
    parts : mapping
        What `describe_surfaces` gave.
    bundle : ModelBundle
        A model of this method.

    Returns
    -------
    dict of str to ndarray
        What `detections_of` gives.
    """
    return detections_of(BottomUpTopDown.from_arrays(variant_arrays(bundle, GEOMETRY)), parts)


def label_cloud(cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Give the points of detected objects their class and score; see `label_detected_objects`.

    Parameters
    ----------
    cloud : PointCloud
        Points; neither intensity nor colour is used.
    bundle : ModelBundle
        A model of this method.

    Returns
    -------
    labels : ndarray of int16, shape (n,)
        Labels of the model's scheme, -1 outside detected objects.
    confidence : ndarray of float32, shape (n,)
        Score of the object; 0 outside.
    """
    surfaces = BottomUpTopDownParameters(**bundle.metadata["parameters"][SLUG]).surfaces
    return label_detected_objects(
        cloud, bundle, lambda objects: detect_scene(describe_surfaces(cloud, objects, parameters=surfaces), bundle)
    )
