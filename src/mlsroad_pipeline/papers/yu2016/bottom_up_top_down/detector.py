"""Bottom-up and top-down descriptors, a baseline of Yu et al. 2016 (V-E): spin images propose, Gaussian images verify.

After Patterson et al. 2008 (ECCV); `docs/methods/detection_baselines.md` lists the assumptions.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_arrays, check_at_least, check_positive, parse_groups
from mlsroad_pipeline.algorithms.features.gaussian_image import align_gaussian_images, compute_gaussian_images
from mlsroad_pipeline.algorithms.geometry.threads import run_in_chunks
from mlsroad_pipeline.papers.shared.detection.regions import relative_centres
from mlsroad_pipeline.papers.shared.detection.thresholds import best_threshold, choose_queries
from mlsroad_pipeline.papers.shared.detection.training import (
    TrainingObjects,
    sample_objects,
    select_objects,
)
from mlsroad_pipeline.papers.shared.detection.types import Description, object_bounds
from mlsroad_pipeline.papers.yu2016.bottom_up_top_down.oriented_points import (
    OrientedPointParameters,
    nearest_images,
    overlap_surfaces,
)

SLUG = "bottom_up_top_down"

N_AZIMUTHS, N_BANDS = 36, 5  # cells of the Gaussian images in azimuth and in elevation
LEAST_SHARES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
"""Candidate shares of a class among the nearest spin images, from which an object is a hypothesis; training chooses."""
EXPONENTS = (0.0, 0.5, 1.0)  # of that share, by which the overlap is multiplied; 0 is that of the paper
MAX_MODELS = 12  # largest number of models of a class

_ARRAYS = (
    "images", "image_kinds", "centres", "normals", "objects", "kinds", "least_shares", "exponents", "thresholds",
    "geometry",
)  # fmt: skip


@dataclass(frozen=True)
class BottomUpTopDownParameters:
    """All parameters of the method."""

    # Oriented points and their spin images
    surfaces: OrientedPointParameters = field(default_factory=OrientedPointParameters)
    # Largest number of spin images of a class in the database; that of no wanted class is three times this
    max_images: int = 500
    reach: float = 0.5  # Distance beyond which points of two aligned surfaces do not overlap, metres
    n_steps: int = 2  # Corrections of the alignment by the mean offset of the nearest points
    candidates: int = 24  # Number of training objects of a class from which models are selected, drawn at random
    max_per_class: int = 150  # Largest number of training objects of a class for database and models
    max_others: int = 600  # Largest number of training objects of no wanted class
    seed: int = 2016  # Seed of the samples

    def __post_init__(self) -> None:
        parse_groups(self, surfaces=OrientedPointParameters)
        for name in ("max_images", "candidates", "max_per_class"):
            check_at_least(getattr(self, name), 1, f"{SLUG}.{name}")
        for name in ("n_steps", "max_others"):
            if getattr(self, name) < 0:
                raise ParameterError(f"{SLUG}.{name} must not be negative, got {getattr(self, name)!r}")
        check_positive(self.reach, f"{SLUG}.reach")


@dataclass(frozen=True)
class BottomUpTopDown:
    """Trained detector: database of spin images, and models of the classes."""

    images: NDArray[np.float32]  # The database
    image_kinds: NDArray[np.int16]  # Class of each image, -1 for others
    models: Description  # Description of the models, without their spin images
    kinds: NDArray[np.int16]  # Class of each model
    least_shares: NDArray[np.float64]  # See `BottomUpTopDownParameters`; lowest score at which an object is detected
    exponents: NDArray[np.float64]  # See `BottomUpTopDownParameters`; lowest score at which an object is detected
    thresholds: NDArray[np.float64]  # See `BottomUpTopDownParameters`; lowest score at which an object is detected
    geometry: NDArray[np.float64]  # Reach, corrections, azimuths and bands

    def score(self, parts: Description) -> NDArray[np.float32]:
        """Return the scores of objects: hypotheses by spin images, verified by overlap."""
        owner = np.full(len(self.images), -1, np.int32)
        shares = class_shares(parts, self.images, self.image_kinds, owner, n_classes=len(self.thresholds))
        hypothesis = (shares >= self.least_shares) & (shares > 0)
        overlap = overlaps(parts, self.models, self.geometry, wanted=hypothesis[:, self.kinds])
        best = [overlap[:, self.kinds == k].max(axis=1, initial=0.0) for k in range(len(self.thresholds))]
        return (np.column_stack(best) * hypothesis * shares**self.exponents).astype(np.float32)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the trained state as plain arrays."""
        own = {name: self.models[name] for name in ("centres", "normals", "objects")}
        names = [name for name in _ARRAYS if name not in own]
        return {**own, **{name: np.asarray(getattr(self, name)) for name in names}}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], *, intensity: bool = False) -> Self:
        """Rebuild a detector from its state."""
        check_arrays(arrays, _ARRAYS, "a bottom-up and top-down detector")
        own = {name: np.asarray(arrays[name]) for name in ("centres", "normals", "objects")}
        own |= {"n_objects": np.array(len(arrays["kinds"])), "intensity": np.array(False)}
        rest = {name: np.asarray(arrays[name]) for name in _ARRAYS if name not in own}
        return cls(models=own, **rest)

    @classmethod
    def fit(cls, objects: TrainingObjects, parameters: BottomUpTopDownParameters) -> tuple[Self, dict[str, Any]]:
        """Choose database, models and thresholds; no training object is compared with itself."""
        p = parameters
        parts, labels, n_classes, _, weights, n_threads = objects
        drawn, sample, truth = examples = objects.sample(p)
        rows = sample_objects(
            truth[sample["objects"]], max_per_class=p.max_images, max_others=3 * p.max_images, seed=p.seed
        )
        owner = np.ascontiguousarray(sample["objects"][rows])
        images, image_kinds = np.ascontiguousarray(sample["images"][rows]), truth[owner].astype(np.int16)
        # Thresholds are chosen on all objects, see `TrainingObjects.sample`.
        known = drawn[owner].astype(np.int32)
        every_share = class_shares(parts, images, image_kinds, known, n_classes=n_classes, n_threads=n_threads)
        shares = every_share[drawn]
        geometry = np.array([p.reach, p.n_steps, N_AZIMUTHS, N_BANDS], dtype=np.float64)
        rng = np.random.default_rng(p.seed)
        models: list[NDArray[np.int64]] = []
        chosen: list[tuple[float, float, float, float]] = []
        for k in range(n_classes):
            mine = examples.candidates(k, p.candidates, rng)
            every = np.ones((len(truth), len(mine)), dtype=np.bool_)
            overlap = overlaps(sample, select_objects(sample, mine), geometry, wanted=every, n_threads=n_threads)
            queries, gate = _choose_models(overlap, shares[:, k], mine, truth == k)
            models.append(np.sort(mine[queries]))
            wanted = (every_share[:, k] >= gate[0]) & (every_share[:, k] > 0)
            pairs = np.repeat(wanted[:, None], len(queries), axis=1)
            overlap = overlaps(parts, select_objects(sample, models[k]), geometry, wanted=pairs, n_threads=n_threads)
            overlap[drawn[models[k]], np.arange(len(queries))] = 0.0
            scores = overlap.max(axis=1, initial=0.0) * np.where(wanted, every_share[:, k] ** gate[1], 0.0)
            chosen.append((*best_threshold(scores, labels == k, weights), *gate))
        every_model = np.concatenate(models)
        order = np.argsort(every_model)
        kinds = np.repeat(np.arange(n_classes), [len(rows) for rows in models])[order].astype(np.int16)
        described = select_objects({name: sample[name] for name in sample if name != "images"}, every_model[order])
        reached, thresholds, least, exponents = (np.array(values) for values in zip(*chosen, strict=True))
        detector = cls(images, image_kinds, described, kinds, least, exponents, thresholds, geometry)
        return detector, {
            "images": len(images), "models": [len(rows) for rows in models], "least_shares": least.tolist(),
            "exponents": exponents.tolist(), "f_scores": reached.tolist(),
        }  # fmt: skip


def class_shares(
    parts: Description,
    images: NDArray[np.float32],
    kinds: NDArray[np.int16],
    owner: NDArray[np.int32],
    *,
    n_classes: int,
    n_threads: int = 1,
) -> NDArray[np.float64]:
    """Return the share of each object's spin images whose nearest neighbour is of each class."""
    own = np.ascontiguousarray(parts["images"], dtype=np.float32)
    if own.shape[1] != images.shape[1]:
        raise DataError(f"spin images of {own.shape[1]} bins, the database has {images.shape[1]}")
    nearest = np.empty(len(own), np.int32)

    def work(start: int, stop: int) -> None:
        nearest_images(own, parts["objects"], images, owner, nearest, start, stop)

    run_in_chunks(work, len(own), n_threads=n_threads)
    kind = np.where(nearest >= 0, kinds[nearest], -1)
    n = int(parts["n_objects"])
    out = np.zeros((n, n_classes))
    for k in range(n_classes):
        out[:, k] = np.bincount(parts["objects"][kind == k], minlength=n)
    return out / np.maximum(np.diff(object_bounds(parts)), 1)[:, None]


def overlaps(
    parts: Description,
    models: Description,
    geometry: NDArray[np.float64],
    *,
    wanted: NDArray[np.bool_],
    n_threads: int = 1,
) -> NDArray[np.float64]:
    """Align models with objects by their Gaussian images, and measure the overlap of their surfaces."""
    reach, n_steps, n_azimuths, n_bands = geometry.tolist()
    bounds, model_bounds = object_bounds(parts), object_bounds(models)
    ours, theirs = (
        compute_gaussian_images(surfaces["normals"], at, n_azimuths=int(n_azimuths), n_bands=int(n_bands))
        for surfaces, at in ((parts, bounds), (models, model_bounds))
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


def _choose_models(
    overlap: NDArray, share: NDArray, mine: NDArray[np.int64], truth: NDArray[np.bool_]
) -> tuple[list[int], tuple[float, float]]:
    """Return the models, the least share and the exponent of a class that give the best F-score."""
    best: tuple[list[int], tuple[float, float]] = ([], (0.0, 0.0))
    reached = -1.0
    for exponent in EXPONENTS:
        for least in LEAST_SHARES:
            gate = np.where((share >= least) & (share > 0), share**exponent, 0.0)
            similarities = (overlap * gate[:, None]).T
            queries, _, f_score = choose_queries(similarities, mine, truth, max_queries=MAX_MODELS)
            if f_score > reached:
                reached, best = f_score, (queries, (least, exponent))
    return best
