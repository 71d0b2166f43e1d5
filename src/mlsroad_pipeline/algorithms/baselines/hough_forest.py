"""Hough forest on supervoxel neighbourhoods, a rival of Yu et al. 2016 (V-E): parts vote for the centre of an object.

After Wang et al. 2015 (JSTARS 8(4)) and Gall and Lempitsky 2009; `docs/methods/hough_forest.md` says how they are read.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines._hough_trees import grow_tree, vote
from mlsroad_pipeline.algorithms.baselines.object_parts import describe_parts, descriptors_of, heights_of
from mlsroad_pipeline.algorithms.cell_grid import run_in_chunks
from mlsroad_pipeline.algorithms.classes import ClassScheme
from mlsroad_pipeline.algorithms.detection import DetectionParameters, best_threshold
from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.algorithms.object_detectors import (
    WITH_INTENSITY,
    Description,
    DetectionStages,
    choose_variant,
    detections_of,
    label_detected_objects,
    object_bounds,
    sample_objects,
    select_objects,
    train_object_detector,
    variant_arrays,
)
from mlsroad_pipeline.algorithms.object_regions import RegionParameters
from mlsroad_pipeline.algorithms.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.validation import check_positive

SLUG = "hough_forest"
ENTRY_POINT = "mlsroad_pipeline.algorithms.baselines.hough_forest:label_cloud"

_FOREST = (
    "roots", "feature", "threshold", "left", "leaf_roots", "shares", "vote_starts", "votes",
)  # fmt: skip


def _coarse_regions() -> RegionParameters:
    return RegionParameters(voxel_size=0.1, seed_resolution=0.3, normal_radius=0.25, fpfh_radius=0.5)


@dataclass(frozen=True)
class HoughForestParameters:
    """All parameters of the method.

    Parameters
    ----------
    regions : RegionParameters or mapping
        Supervoxels and their neighbourhoods, the parts that vote. Smaller parts vote more precisely and cost time.
    n_trees : int, default 24
        Trees. More smooth the votes and cost time.
    max_depth : int, default 14
        Greatest depth of a tree.
    min_parts : int, default 4
        Fewest training parts in a leaf.
    n_tests : int, default 40
        Random splits tried at a node; the best is taken. More give purer leaves and trees that are more alike.
    n_votes : int, default 8
        Most offsets that a leaf keeps for a class, spread evenly over those of its parts.
    cell, height_cell : float, default 0.2, 0.5
        Cells of the vote space, horizontally and vertically, metres. Finer separates centres, and scatters votes.
    exponents : sequence of float, default (0.0, 0.5, 1.0)
        Peaks are divided by the number of voting parts to one of these powers, the one that is best on the training
        objects: 0 counts votes, 1 takes their share.
    max_per_class, max_others : int, default 400, 1200
        The most training objects of a class, and of all others, that trees are grown on.
    max_parts : int, default 60
        The most parts of an object that are learned from.
    seed : int, default 2016
        Seed of samples and splits.

    Raises
    ------
    ParameterError
        If a number is outside its domain.
    """

    regions: RegionParameters = field(default_factory=_coarse_regions)
    n_trees: int = 24
    max_depth: int = 14
    min_parts: int = 4
    n_tests: int = 40
    n_votes: int = 8
    cell: float = 0.2
    height_cell: float = 0.5
    exponents: Sequence[float] = (0.0, 0.5, 1.0)
    max_per_class: int = 400
    max_others: int = 1200
    max_parts: int = 60
    seed: int = 2016

    def __post_init__(self) -> None:
        if isinstance(self.regions, Mapping):
            object.__setattr__(self, "regions", RegionParameters(**self.regions))
        for name in ("n_trees", "max_depth", "min_parts", "n_tests", "n_votes", "max_per_class", "max_parts"):
            if getattr(self, name) < 1:
                raise ParameterError(f"{SLUG}.{name} must be at least 1, got {getattr(self, name)!r}")
        if self.max_others < 0:
            raise ParameterError(f"{SLUG}.max_others must not be negative, got {self.max_others!r}")
        for name in ("cell", "height_cell"):
            check_positive(getattr(self, name), f"{SLUG}.{name}")
        if not self.exponents:
            raise ParameterError(f"{SLUG}.exponents must name at least one power")


@dataclass(frozen=True)
class HoughForest:
    """A trained forest.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        ``roots`` (t + 1,) first node of each tree; ``feature``, ``threshold`` and ``left`` child of each node, in a
        leaf -1, 0 and its number; ``leaf_roots`` (t + 1,) first leaf of each tree; ``shares`` (leaves, c) of the
        classes; ``vote_starts`` (leaves * c + 1,) where the ``votes`` (v, 2) of a leaf and class begin: radius and
        rise, metres; ``cells`` (2,) of the vote space.
    exponents : ndarray of float64, shape (c,)
        Power of the number of parts that a peak is divided by.
    thresholds : ndarray of float64, shape (c,)
        Score from which an object is detected.
    intensity : bool
        Whether the trees know of intensities.
    """

    arrays: Mapping[str, NDArray]
    exponents: NDArray[np.float64]
    thresholds: NDArray[np.float64]
    intensity: bool

    def peaks(
        self, parts: Description, unseen: NDArray[np.bool_] | None = None, *, n_threads: int = 1
    ) -> NDArray[np.float64]:
        """Return the highest peak of each object's votes for each class.

        Parameters
        ----------
        parts : mapping
            What `describe_parts` gave.
        unseen : ndarray of bool, shape (t, n), optional
            Trees that vote for each object; all by default.
        n_threads : int, default 1
            Threads; the result does not depend on it.

        Returns
        -------
        ndarray of float64, shape (n, c)
            Peaks; 0 for objects without parts.
        """
        bounds = object_bounds(parts)
        n_trees = len(self.arrays["roots"]) - 1
        out = np.zeros((len(bounds) - 1, self.arrays["shares"].shape[1]))
        asked = np.ones((n_trees, len(out)), dtype=np.bool_) if unseen is None else unseen
        features = part_features(parts, intensity=self.intensity)
        cell, height_cell = self.arrays["cells"]
        forest = [self.arrays[name] for name in _FOREST]
        centres = np.ascontiguousarray(parts["centres"], dtype=np.float64)

        def work(start: int, stop: int) -> None:
            vote(features, centres, bounds, asked, *forest, float(cell), float(height_cell), out, start, stop)

        run_in_chunks(work, len(out), n_threads=n_threads)
        return out

    def score(self, parts: Description) -> NDArray[np.float32]:
        """Score each object for each class.

        Parameters
        ----------
        parts : mapping
            What `describe_parts` gave.

        Returns
        -------
        ndarray of float32, shape (n, c)
            Peaks over the number of parts to the power of the class.
        """
        n_parts = np.maximum(np.diff(object_bounds(parts)), 1)[:, None]
        return (self.peaks(parts) / n_parts**self.exponents).astype(np.float32)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return what was learned as plain arrays."""
        return {**self.arrays, "exponents": self.exponents, "thresholds": self.thresholds}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], *, intensity: bool) -> Self:
        """Rebuild a forest from what `to_arrays` gave.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            The arrays.
        intensity : bool
            Whether the trees know of intensities.

        Returns
        -------
        HoughForest
            The forest.

        Raises
        ------
        DataError
            If an array is missing.
        """
        missing = [name for name in (*_FOREST, "cells", "exponents", "thresholds") if name not in arrays]
        if missing:
            raise DataError(f"the arrays of a Hough forest lack {', '.join(missing)}")
        own = {name: np.ascontiguousarray(arrays[name]) for name in (*_FOREST, "cells")}
        return cls(own, np.asarray(arrays["exponents"]), np.asarray(arrays["thresholds"]), intensity)


def part_features(parts: Description, *, intensity: bool) -> NDArray[np.float32]:
    """Return what the trees test: descriptors, height above the object's foot and steepness of the first axis.

    Parameters
    ----------
    parts : mapping
        What `describe_parts` gave.
    intensity : bool
        Whether intensities count.

    Returns
    -------
    ndarray of float32, shape (g, 22)
        Features.
    """
    steepness = np.abs(parts["orientations"][:, 2])
    return np.column_stack([descriptors_of(parts, intensity=intensity), heights_of(parts), steepness]).astype(
        np.float32
    )


def offsets_to_centre(parts: Description) -> NDArray[np.float64]:
    """Return how each part lies to the centre of its object, whatever way the object is turned.

    Parameters
    ----------
    parts : mapping
        What `describe_parts` gave.

    Returns
    -------
    ndarray of float64, shape (g, 2)
        Horizontal distance to the middle of the object's bounding box, and rise from the part to it, metres.
    """
    n = int(parts["n_objects"])
    low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    np.minimum.at(low, parts["objects"], parts["centres"])
    np.maximum.at(high, parts["objects"], parts["centres"])
    away = (0.5 * (low + high))[parts["objects"]] - parts["centres"]
    return np.column_stack([np.hypot(away[:, 0], away[:, 1]), away[:, 2]])


def fit_hough_forest(
    parts: Description,
    labels: NDArray[np.int16],
    intensity: bool,
    *,
    parameters: HoughForestParameters,
    n_classes: int,
    n_threads: int = 1,
) -> tuple[HoughForest, dict[str, Any]]:
    """Grow a forest, and choose exponents and thresholds by the votes of trees that have not seen the object.

    Parameters
    ----------
    parts : mapping
        Parts of the training objects.
    labels : ndarray of int16, shape (n,)
        Class of each object, -1 for others.
    intensity : bool
        Whether intensities count.
    parameters : HoughForestParameters
        Parameters.
    n_classes : int
        Wanted classes.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    forest : HoughForest
        The forest.
    facts : dict
        Leaves, and the F-score of each class on the training objects.
    """
    p = parameters
    rng = np.random.default_rng(p.seed)
    drawn = sample_objects(labels, max_per_class=p.max_per_class, max_others=p.max_others, seed=p.seed)
    sample = select_objects(parts, drawn)
    kinds = np.where(labels[drawn] < 0, n_classes, labels[drawn]).astype(np.int16)
    # A tree sees objects drawn with replacement, as a whole: parts of one are too alike to be apart.
    seen = np.zeros((p.n_trees, len(drawn)), dtype=np.bool_)
    columns = (part_features(sample, intensity=intensity), kinds[sample["objects"]], offsets_to_centre(sample))
    place = rng.permutation(len(sample["objects"]))
    trees = []
    for t in range(p.n_trees):
        for kind in np.unique(kinds):
            mine = np.flatnonzero(kinds == kind)
            seen[t, rng.choice(mine, len(mine))] = True
        rows = _rows_of(sample, seen[t], place, p.max_parts)
        trees.append(_tree(columns, rows, n_classes, p, rng))
    forest = HoughForest(_joined(trees, p), np.zeros(n_classes), np.zeros(n_classes), intensity)
    # Thresholds are chosen on all objects, drawn or not: among the drawn ones others are rarer than in a street.
    unseen = np.ones((p.n_trees, len(labels)), dtype=np.bool_)
    unseen[:, drawn] = ~seen
    peaks = forest.peaks(parts, unseen, n_threads=n_threads)
    return _with_thresholds(forest, peaks, np.maximum(np.diff(object_bounds(parts)), 1), labels, p)


def _rows_of(sample: Description, seen: NDArray[np.bool_], place: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return up to `most` parts of each object that a tree sees, the first of a fixed random order."""
    order = np.lexsort((place, sample["objects"]))
    rank = np.arange(len(order)) - object_bounds(sample)[sample["objects"][order]]
    return np.sort(order[(rank < most) & seen[sample["objects"][order]]])


def _tree(
    columns: tuple[NDArray, NDArray, NDArray],
    rows: NDArray[np.int64],
    n: int,
    p: HoughForestParameters,
    rng: np.random.Generator,
) -> dict[str, NDArray]:
    features, labels, offsets = columns
    counts = np.bincount(labels[rows], minlength=n + 1)
    weights = (1.0 / np.maximum(counts, 1))[labels] * len(rows)  # every class weighs the same
    grown = grow_tree(features, labels, offsets, weights, rows, n + 1, p.max_depth, p.min_parts, p.n_tests, rng)
    feature, threshold, left, starts, by_leaf = grown
    shares = np.zeros((len(starts) - 1, n + 1))
    leaf = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    np.add.at(shares, (leaf, labels[by_leaf]), weights[by_leaf])
    shares /= shares.sum(axis=1, keepdims=True)
    keep = labels[by_leaf] < n
    leaf, by_leaf = leaf[keep], by_leaf[keep]
    order = np.lexsort((offsets[by_leaf, 1], offsets[by_leaf, 0], labels[by_leaf], leaf))
    cell = leaf[order] * n + labels[by_leaf[order]]
    first = np.searchsorted(cell, np.arange(len(shares) * n + 1))
    size = np.diff(first)[cell]
    # Every size / n_votes-th one, so that few votes stand for all.
    rank = np.arange(len(cell)) - first[cell]
    kept = (size <= p.n_votes) | ((rank + 1) * p.n_votes // size > rank * p.n_votes // size)
    starts_kept = np.concatenate([[0], np.cumsum(np.bincount(cell[kept], minlength=len(shares) * n))])
    return {
        "feature": feature, "threshold": threshold, "left": left, "shares": shares[:, :n].astype(np.float32),
        "votes": offsets[by_leaf[order[kept]]].astype(np.float32), "vote_starts": starts_kept,
    }  # fmt: skip


def _joined(trees: list[dict[str, NDArray]], p: HoughForestParameters) -> dict[str, NDArray]:
    joined = {name: np.concatenate([t[name] for t in trees]) for name in ("feature", "threshold", "left", "shares")}
    joined["votes"] = np.concatenate([t["votes"] for t in trees])
    joined["roots"] = np.cumsum([0, *(len(t["feature"]) for t in trees)])
    joined["leaf_roots"] = np.cumsum([0, *(len(t["shares"]) for t in trees)])
    sizes = np.concatenate([np.diff(t["vote_starts"]) for t in trees])
    joined["vote_starts"] = np.concatenate([[0], np.cumsum(sizes)])
    joined["cells"] = np.array([p.cell, p.height_cell])
    return joined


def _with_thresholds(
    forest: HoughForest, peaks: NDArray, n_parts: NDArray, labels: NDArray, p: HoughForestParameters
) -> tuple[HoughForest, dict[str, Any]]:
    exponents, thresholds, reached = [], [], []
    for k in range(len(forest.thresholds)):
        trials = [(*best_threshold((peaks[:, k] / n_parts**e).astype(np.float32), labels == k), e) for e in p.exponents]
        f_score, threshold, exponent = trials[int(np.argmax([trial[0] for trial in trials]))]
        reached.append(f_score)
        thresholds.append(threshold)
        exponents.append(exponent)
    done = HoughForest(forest.arrays, np.array(exponents), np.array(thresholds), forest.intensity)
    return done, {"leaves": len(forest.arrays["shares"]), "f_scores": reached, "exponents": exponents}


def train_hough_forest(
    parts: Mapping[str, Description],
    labels: Mapping[str, Mapping[str, NDArray]],
    *,
    parameters: HoughForestParameters,
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
        What `describe_parts` gave for each training scene.
    labels : mapping of str to mapping
        What `object_classes` gave for each of them.
    parameters : HoughForestParameters
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

    def fit(joined: Description, truth: NDArray[np.int16], intensity: bool) -> tuple[HoughForest, dict[str, Any]]:
        return fit_hough_forest(joined, truth, intensity, parameters=parameters, n_classes=n, n_threads=n_threads)

    return train_object_detector(
        parts, labels, fit, slug=SLUG, entry_point=ENTRY_POINT, parameters=parameters,
        uses_intensity=True, stages=stages, detection=detection, scheme=scheme, trained_on=trained_on,
    )  # fmt: skip


def detect_scene(parts: Description, bundle: ModelBundle) -> dict[str, NDArray]:
    """Detect the objects of a scene.

    Parameters
    ----------
    parts : mapping
        What `describe_parts` gave.
    bundle : ModelBundle
        A model of this method.

    Returns
    -------
    dict of str to ndarray
        What `detections_of` gives.
    """
    variant = choose_variant(parts, bundle)
    forest = HoughForest.from_arrays(variant_arrays(bundle, variant), intensity=variant == WITH_INTENSITY)
    return detections_of(forest, parts)


def label_cloud(cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Give the points of detected objects their class and score; see `label_detected_objects`.

    Parameters
    ----------
    cloud : PointCloud
        Points; intensity is used where the cloud and the model have it.
    bundle : ModelBundle
        A model of this method.

    Returns
    -------
    labels : ndarray of int16, shape (n,)
        Labels of the model's scheme, -1 outside detected objects.
    confidence : ndarray of float32, shape (n,)
        Score of the object; 0 outside.
    """
    regions = HoughForestParameters(**bundle.metadata["parameters"][SLUG]).regions
    return label_detected_objects(
        cloud, bundle, lambda objects: detect_scene(describe_parts(cloud, objects, parameters=regions), bundle)
    )
