"""Hough forest on supervoxel neighbourhoods, a baseline of Yu et al. 2016 (V-E): parts vote for an object's centre.

After Wang et al. 2015 (JSTARS 8(4)) and Gall and Lempitsky 2009; assumptions:
`docs/methods/detection_baselines.md`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import (
    check_arrays,
    check_at_least,
    check_positive,
    check_tested,
    parse_groups,
)
from mlsroad_pipeline.algorithms.geometry.threads import run_in_chunks
from mlsroad_pipeline.papers.shared.detection.regions import (
    RegionParameters,
    descriptors_of,
    heights_of,
)
from mlsroad_pipeline.papers.shared.detection.thresholds import best_threshold
from mlsroad_pipeline.papers.shared.detection.training import TrainingObjects
from mlsroad_pipeline.papers.shared.detection.types import Description, object_bounds
from mlsroad_pipeline.papers.yu2016.hough_forest._trees import grow_tree, vote

SLUG = "hough_forest"

MIN_PARTS = 4  # fewest training parts in a leaf
N_TESTS = 40  # random splits evaluated at a node; more give purer leaves and more correlated trees
N_VOTES = 8  # largest number of offsets that a leaf stores for a class, thinned evenly
HEIGHT_CELL = 0.5  # metres, vertical size of the cells of the vote space
EXPONENTS = (0.0, 0.5, 1.0)  # of the number of parts that peaks are divided by; 0 gives the sum of votes, 1 their mean
MAX_PARTS = 60  # largest number of training parts of an object

_FOREST = (
    "roots", "feature", "threshold", "left", "leaf_roots", "shares", "vote_starts", "votes",
)  # fmt: skip


def _coarse_regions() -> RegionParameters:
    return RegionParameters(voxel_size=0.1, seed_resolution=0.3, normal_radius=0.25, fpfh_radius=0.5)


@dataclass(frozen=True)
class HoughForestParameters:
    """All parameters of the method."""

    # Supervoxels and their neighbourhoods, the parts that vote. Smaller parts vote more precisely and cost time.
    regions: RegionParameters = field(default_factory=_coarse_regions)
    n_trees: int = 24  # Number of trees. More give smoother votes and cost time.
    max_depth: int = 14  # Greatest depth of a tree
    # Horizontal size of the cells of the vote space, metres. Smaller separates centres, and scatters votes.
    cell: float = 0.2
    max_per_class: int = 400  # Largest number of training objects of a class for the trees
    max_others: int = 1200  # Largest number of training objects of no wanted class
    seed: int = 2016  # Seed of samples and splits

    def __post_init__(self) -> None:
        parse_groups(self, regions=RegionParameters)
        for name in ("n_trees", "max_depth", "max_per_class"):
            check_at_least(getattr(self, name), 1, f"{SLUG}.{name}")
        if self.max_others < 0:
            raise ParameterError(f"{SLUG}.max_others must not be negative, got {self.max_others!r}")
        check_positive(self.cell, f"{SLUG}.cell")


@dataclass(frozen=True)
class HoughForest:
    """Trained Hough forest."""

    # ``roots`` (t + 1,) first node of each tree; ``feature``, ``threshold`` and ``left`` child of each node, in a leaf
    # -1, 0 and its number; ``leaf_roots`` (t + 1,) first leaf of each tree; ``shares`` (leaves, c) of the classes;
    # ``vote_starts`` (leaves * c + 1,) the first of the ``votes`` (v, 2) of a leaf and class: radius and rise, metres;
    # ``cells`` (2,) of the vote space
    arrays: Mapping[str, NDArray]
    exponents: NDArray[np.float64]  # Exponent of the number of parts that a peak is divided by
    thresholds: NDArray[np.float64]  # Lowest score at which an object is detected
    intensity: bool  # Whether the trees use intensity

    def peaks(
        self, parts: Description, unseen: NDArray[np.bool_] | None = None, *, n_threads: int = 1
    ) -> NDArray[np.float64]:
        """Return the highest peak of each object's votes for each class."""
        bounds = object_bounds(parts)
        n_trees = len(self.arrays["roots"]) - 1
        out = np.zeros((len(bounds) - 1, self.arrays["shares"].shape[1]))
        selected = np.ones((n_trees, len(out)), dtype=np.bool_) if unseen is None else unseen
        features = part_features(parts, intensity=self.intensity)
        check_tested(self.arrays["feature"], features.shape[1], "a Hough forest")
        cell, height_cell = self.arrays["cells"]
        forest = [self.arrays[name] for name in _FOREST]
        centres = np.ascontiguousarray(parts["centres"], dtype=np.float64)

        def work(start: int, stop: int) -> None:
            vote(features, centres, bounds, selected, *forest, float(cell), float(height_cell), out, start, stop)

        run_in_chunks(work, len(out), n_threads=n_threads)
        return out

    def score(self, parts: Description) -> NDArray[np.float32]:
        """Return the score of each object for each class."""
        n_parts = np.maximum(np.diff(object_bounds(parts)), 1)[:, None]
        return (self.peaks(parts) / n_parts**self.exponents).astype(np.float32)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the trained state as plain arrays."""
        return {**self.arrays, "exponents": self.exponents, "thresholds": self.thresholds}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], *, intensity: bool) -> Self:
        """Rebuild a forest from its state."""
        check_arrays(arrays, (*_FOREST, "cells", "exponents", "thresholds"), "a Hough forest")
        own = {name: np.ascontiguousarray(arrays[name]) for name in (*_FOREST, "cells")}
        return cls(own, np.asarray(arrays["exponents"]), np.asarray(arrays["thresholds"]), intensity)

    @classmethod
    def fit(cls, objects: TrainingObjects, parameters: HoughForestParameters) -> tuple[Self, dict[str, Any]]:
        """Grow a forest, and choose exponents and thresholds by out-of-bag votes."""
        p = parameters
        parts, labels, n_classes, intensity, weights, n_threads = objects
        rng = np.random.default_rng(p.seed)
        drawn, sample, truth = objects.sample(p)
        kinds = np.where(truth < 0, n_classes, truth).astype(np.int16)
        # Bootstrap samples contain whole objects: parts of one object are too similar to be independent.
        seen = np.zeros((p.n_trees, len(drawn)), dtype=np.bool_)
        columns = (part_features(sample, intensity=intensity), kinds[sample["objects"]], offsets_to_centre(sample))
        place = rng.permutation(len(sample["objects"]))
        trees = []
        for t in range(p.n_trees):
            for kind in np.unique(kinds):
                mine = np.flatnonzero(kinds == kind)
                seen[t, rng.choice(mine, len(mine))] = True
            rows = _rows_of(sample, seen[t], place, MAX_PARTS)
            trees.append(_tree(columns, rows, n_classes, p, rng))
        forest = cls(_joined(trees, p), np.zeros(n_classes), np.zeros(n_classes), intensity)
        # Thresholds are chosen on all objects, see `TrainingObjects.sample`.
        unseen = np.ones((p.n_trees, len(labels)), dtype=np.bool_)
        unseen[:, drawn] = ~seen
        peaks = forest.peaks(parts, unseen, n_threads=n_threads)
        n_parts = np.maximum(np.diff(object_bounds(parts)), 1)
        return forest._with_thresholds(peaks, n_parts, labels, weights)

    def _with_thresholds(
        self, peaks: NDArray, n_parts: NDArray, labels: NDArray, weights: NDArray[np.float64] | None
    ) -> tuple[Self, dict[str, Any]]:
        """Choose exponent and threshold of each class by the F-score."""
        exponents, thresholds, reached = [], [], []
        for k in range(len(self.thresholds)):
            trials = [
                (*best_threshold((peaks[:, k] / n_parts**e).astype(np.float32), labels == k, weights), e)
                for e in EXPONENTS
            ]
            f_score, threshold, exponent = trials[int(np.argmax([trial[0] for trial in trials]))]
            reached.append(f_score)
            thresholds.append(threshold)
            exponents.append(exponent)
        done = replace(self, exponents=np.array(exponents), thresholds=np.array(thresholds))
        return done, {"leaves": len(self.arrays["shares"]), "f_scores": reached, "exponents": exponents}


def part_features(parts: Description, *, intensity: bool) -> NDArray[np.float32]:
    """Return the features of parts: descriptors, height above the object's foot, and steepness of the first axis."""
    steepness = np.abs(parts["orientations"][:, 2])
    return np.column_stack([descriptors_of(parts, intensity=intensity), heights_of(parts), steepness]).astype(
        np.float32
    )


def offsets_to_centre(parts: Description) -> NDArray[np.float64]:
    """Return the offset of the centre of each part's object, invariant to rotations about the vertical."""
    n = int(parts["n_objects"])
    low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    np.minimum.at(low, parts["objects"], parts["centres"])
    np.maximum.at(high, parts["objects"], parts["centres"])
    away = (0.5 * (low + high))[parts["objects"]] - parts["centres"]
    return np.column_stack([np.hypot(away[:, 0], away[:, 1]), away[:, 2]])


def _rows_of(sample: Description, seen: NDArray[np.bool_], place: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return up to `most` parts of each object of a bootstrap sample, the first of a fixed random order."""
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
    """Grow a tree, and store the class shares and votes of its leaves."""
    features, labels, offsets = columns
    counts = np.bincount(labels[rows], minlength=n + 1)
    weights = (1.0 / np.maximum(counts, 1))[labels] * len(rows)  # all classes have equal weight
    grown = grow_tree(features, labels, offsets, weights, rows, n + 1, p.max_depth, MIN_PARTS, N_TESTS, rng)
    feature, threshold, left, starts, by_leaf = grown
    shares = np.zeros((len(starts) - 1, n + 1))
    leaf = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    np.add.at(shares, (leaf, labels[by_leaf]), weights[by_leaf])
    total = shares.sum(axis=1, keepdims=True)
    shares /= np.where(total > 0, total, 1.0)  # a tree without training parts has one empty leaf
    keep = labels[by_leaf] < n
    leaf, by_leaf = leaf[keep], by_leaf[keep]
    order = np.lexsort((offsets[by_leaf, 1], offsets[by_leaf, 0], labels[by_leaf], leaf))
    cell = leaf[order] * n + labels[by_leaf[order]]
    first = np.searchsorted(cell, np.arange(len(shares) * n + 1))
    size = np.diff(first)[cell]
    # Thin the votes of a leaf evenly to `N_VOTES`.
    rank = np.arange(len(cell)) - first[cell]
    kept = (size <= N_VOTES) | ((rank + 1) * N_VOTES // size > rank * N_VOTES // size)
    starts_kept = np.concatenate([[0], np.cumsum(np.bincount(cell[kept], minlength=len(shares) * n))])
    return {
        "feature": feature, "threshold": threshold, "left": left, "shares": shares[:, :n].astype(np.float32),
        "votes": offsets[by_leaf[order[kept]]].astype(np.float32), "vote_starts": starts_kept,
    }  # fmt: skip


def _joined(trees: list[dict[str, NDArray]], p: HoughForestParameters) -> dict[str, NDArray]:
    """Concatenate the arrays of trees."""
    joined = {name: np.concatenate([t[name] for t in trees]) for name in ("feature", "threshold", "left", "shares")}
    joined["votes"] = np.concatenate([t["votes"] for t in trees])
    joined["roots"] = np.cumsum([0, *(len(t["feature"]) for t in trees)])
    joined["leaf_roots"] = np.cumsum([0, *(len(t["shares"]) for t in trees)])
    sizes = np.concatenate([np.diff(t["vote_starts"]) for t in trees])
    joined["vote_starts"] = np.concatenate([[0], np.cumsum(sizes)])
    joined["cells"] = np.array([p.cell, HEIGHT_CELL])
    return joined
