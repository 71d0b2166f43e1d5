"""Object matching, a baseline of Yu et al. 2016 (V-E): correspondences between prototypes and candidate objects.

After Yu et al. 2015 (GRSL 12(3)); `docs/methods/detection_baselines.md` lists the assumptions.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_arrays, check_at_least, check_positive, parse_groups
from mlsroad_pipeline.algorithms.geometry.neighbors import nearest_neighbors
from mlsroad_pipeline.algorithms.geometry.threads import run_in_chunks
from mlsroad_pipeline.papers.shared.detection.regions import (
    RegionParameters,
    descriptors_of,
    relative_centres,
)
from mlsroad_pipeline.papers.shared.detection.thresholds import best_threshold, choose_queries
from mlsroad_pipeline.papers.shared.detection.training import TrainingObjects, select_objects
from mlsroad_pipeline.papers.shared.detection.types import Description, object_bounds


@njit(cache=True, nogil=True)
def _unlike(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    """Return the mean of the differences in shape, histogram and intensity, each from 0 to 1."""
    shape, histogram = 0.0, 0.0
    for k in range(3):
        shape += abs(one[k] - other[k])
    for k in range(3, 19):
        histogram += abs(one[k] - other[k])
    return (0.5 * shape + 0.5 * histogram + abs(one[19] - other[19])) / 3.0


@njit(cache=True, nogil=True)
def _assign(
    predicted: NDArray[np.float64],
    centres: NDArray[np.float64],
    unlike: NDArray[np.float64],
    i: int,
    taken: NDArray[np.bool_],
    share: float,
    reach: float,
    limit: float,
) -> tuple[int, float]:
    """Return the free part of least cost for a part of the prototype, and the cost; -1 for none below `limit`."""
    best, cost = -1, limit
    inverse = (1.0 - share) / reach
    for j in range(len(centres)):
        if taken[j]:
            continue
        total = share * unlike[i, j]
        if total >= cost:
            continue
        dx, dy, dz = predicted[0] - centres[j, 0], predicted[1] - centres[j, 1], predicted[2] - centres[j, 2]
        total += inverse * min(np.sqrt(dx * dx + dy * dy + dz * dz), reach)
        if total < cost:
            best, cost = j, total
    return best, cost


@njit(cache=True, nogil=True)
def _match(
    prototype: NDArray[np.float64],
    around: NDArray[np.int64],
    weights: NDArray[np.float64],
    centres: NDArray[np.float64],
    unlike: NDArray[np.float64],
    turns: NDArray[np.float64],
    share: float,
    reach: float,
    limit: float,
    n_sweeps: int,
) -> float:
    """Return the soft share of corresponding parts, the largest over all rotations about the vertical."""
    n, m = len(prototype), len(centres)
    place, x_hat = np.empty((n, 3)), np.empty(3)
    match, taken = np.empty(n, np.int64), np.empty(m, np.bool_)
    best = 0.0
    for t in range(len(turns)):
        cosine, sine = np.cos(turns[t]), np.sin(turns[t])
        taken[:] = False
        for i in range(n):
            place[i, 0] = cosine * prototype[i, 0] - sine * prototype[i, 1]
            place[i, 1] = sine * prototype[i, 0] + cosine * prototype[i, 1]
            place[i, 2] = prototype[i, 2]
            match[i] = -1
        for sweep in range(n_sweeps + 1):
            gain, pairs = 0.0, 0
            for i in range(n):
                if match[i] >= 0:
                    taken[match[i]] = False
                if sweep == 0:
                    x_hat[:] = place[i]
                else:
                    x_hat[:] = 0.0
                    for k in range(around.shape[1]):
                        for axis in range(3):
                            x_hat[axis] += weights[i, k] * place[around[i, k], axis]
                j, cost = _assign(x_hat, centres, unlike, i, taken, share, reach, limit)
                match[i] = j
                if j >= 0:
                    taken[j] = True
                    gain += 1.0 - cost / limit
                    pairs += 1
                    place[i] = centres[j]
                else:
                    place[i] = x_hat
            best = max(best, gain / (n + m - pairs))
    return best


@njit(cache=True, nogil=True)
def match_objects(
    prototypes: NDArray[np.float64],
    prototype_descriptors: NDArray[np.float32],
    prototype_bounds: NDArray[np.int64],
    around: NDArray[np.int64],
    weights: NDArray[np.float64],
    centres: NDArray[np.float64],
    descriptors: NDArray[np.float32],
    bounds: NDArray[np.int64],
    turns: NDArray[np.float64],
    share: float,
    reach: float,
    limit: float,
    n_sweeps: int,
    least: float,
    out: NDArray[np.float64],
    start: int,
    stop: int,
) -> None:
    """Write the similarity of objects `start` to `stop` to each prototype; 0 where their sizes differ too much."""
    for o in range(start, stop):
        mine = slice(bounds[o], bounds[o + 1])
        m = bounds[o + 1] - bounds[o]
        for p in range(out.shape[1]):
            first, last = prototype_bounds[p], prototype_bounds[p + 1]
            n = last - first
            if min(n, m) < least * max(n, m) or m == 0:
                continue
            unlike = np.empty((n, m))
            for i in range(n):
                for j in range(m):
                    unlike[i, j] = _unlike(prototype_descriptors[first + i], descriptors[bounds[o] + j])
            out[o, p] = _match(
                prototypes[first:last], around[first:last], weights[first:last], centres[mine], unlike, turns,
                share, reach, limit, n_sweeps,
            )  # fmt: skip


SLUG = "object_matching"

FEATURE_SHARE = 0.5  # weight of the dissimilarity of features; the rest is that of the geometric distance
N_NEIGHBORS = 6  # feature points in an affine combination
N_SWEEPS = 2  # iterations of the correspondences after the first

_ARRAYS = ("descriptors", "centres", "objects", "kinds", "thresholds", "geometry")


def _coarse_regions() -> RegionParameters:
    return RegionParameters(voxel_size=0.1, seed_resolution=0.4, normal_radius=0.25, fpfh_radius=0.5)


@dataclass(frozen=True)
class ObjectMatchingParameters:
    """All parameters of the method."""

    # Supervoxels and their neighbourhoods, the feature points that are matched. The time grows with the square of their
    # number.
    regions: RegionParameters = field(default_factory=_coarse_regions)
    reach: float = 1.0  # Distance at which the geometric cost of a feature point reaches its maximum, metres
    limit: float = 0.4  # Cost of an unmatched feature point; pairs of higher cost are not matched
    n_turns: int = 12  # Number of rotations about the vertical that are evaluated
    least: float = 0.2  # Least ratio of the numbers of parts of candidate and prototype; below it the similarity is 0
    max_prototypes: int = 12  # Largest number of prototypes of a class
    candidates: int = 24  # Number of training objects of a class from which prototypes are selected, drawn at random
    max_per_class: int = 150  # Largest number of training objects of a class for the choice of prototypes
    max_others: int = 1000  # Largest number of training objects of no wanted class
    seed: int = 2016  # Seed of the samples

    def __post_init__(self) -> None:
        parse_groups(self, regions=RegionParameters)
        for name in ("n_turns", "max_prototypes", "candidates", "max_per_class"):
            check_at_least(getattr(self, name), 1, f"{SLUG}.{name}")
        if self.max_others < 0:
            raise ParameterError(f"{SLUG}.max_others must not be negative, got {self.max_others!r}")
        for name in ("reach", "limit"):
            check_positive(getattr(self, name), f"{SLUG}.{name}")
        if not 0 <= self.least <= 1:
            raise ParameterError(f"{SLUG}.least must be between 0 and 1, got {self.least!r}")


@dataclass(frozen=True)
class ObjectMatcher:
    """Trained object matching: prototypes of the classes."""

    prototypes: Description  # Description of the prototypes
    kinds: NDArray[np.int16]  # Class of each
    thresholds: NDArray[np.float64]  # Least similarity at which an object is detected
    geometry: NDArray[np.float64]  # Feature share, reach, limit, neighbours, turns, sweeps and least ratio
    intensity: bool  # Whether intensity is used

    def score(self, parts: Description) -> NDArray[np.float32]:
        """Return the similarity of objects to the prototypes."""
        similarities = object_similarity(parts, self.prototypes, self.geometry, intensity=self.intensity)
        out = np.zeros((len(similarities), len(self.thresholds)), np.float32)
        for k in range(len(self.thresholds)):
            out[:, k] = similarities[:, self.kinds == k].max(axis=1, initial=0.0)
        return out

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the trained state as plain arrays."""
        own = {name: self.prototypes[name] for name in ("descriptors", "centres", "objects")}
        return {**own, "kinds": self.kinds, "thresholds": self.thresholds, "geometry": self.geometry}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], *, intensity: bool) -> Self:
        """Rebuild a matcher from its state."""
        check_arrays(arrays, _ARRAYS, "an object matcher")
        own = {name: np.asarray(arrays[name]) for name in ("descriptors", "centres", "objects")}
        own |= {"n_objects": np.array(len(arrays["kinds"])), "intensity": np.array(intensity)}
        return cls(own, arrays["kinds"], arrays["thresholds"], arrays["geometry"], intensity)

    @classmethod
    def fit(cls, objects: TrainingObjects, parameters: ObjectMatchingParameters) -> tuple[Self, dict[str, Any]]:
        """Choose prototypes and thresholds; no training object is compared with itself."""
        p = parameters
        parts, labels, n_classes, intensity, weights, n_threads = objects
        drawn, sample, truth = examples = objects.sample(p)
        geometry = np.array([FEATURE_SHARE, p.reach, p.limit, N_NEIGHBORS, p.n_turns, N_SWEEPS, p.least])
        rng = np.random.default_rng(p.seed)
        chosen: list[NDArray[np.int64]] = []
        thresholds, reached = [], []
        for k in range(n_classes):
            mine = examples.candidates(k, p.candidates, rng)
            similarities = object_similarity(
                sample, select_objects(sample, mine), geometry, intensity=intensity, n_threads=n_threads
            )
            queries = choose_queries(similarities.T, mine, truth == k, max_queries=p.max_prototypes)[0]
            chosen.append(mine[queries])
            # The threshold is chosen on all objects, see `TrainingObjects.sample`.
            models = select_objects(sample, np.sort(chosen[k]))
            similarities = object_similarity(parts, models, geometry, intensity=intensity, n_threads=n_threads)
            similarities[drawn[np.sort(chosen[k])], np.arange(len(queries))] = 0.0
            f_score, threshold = best_threshold(similarities.max(axis=1, initial=0.0), labels == k, weights)
            thresholds.append(threshold)
            reached.append(f_score)
        every = np.concatenate(chosen)
        order = np.argsort(every)
        kinds = np.repeat(np.arange(n_classes), [len(c) for c in chosen])[order].astype(np.int16)
        matcher = cls(select_objects(sample, every[order]), kinds, np.array(thresholds), geometry, intensity)
        return matcher, {"prototypes": [len(c) for c in chosen], "f_scores": reached}


def affine_combinations(
    centres: NDArray[np.float64], bounds: NDArray[np.int64], n_neighbors: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Express each part as an affine combination of its nearest neighbours in the same object."""
    around = np.empty((len(centres), n_neighbors), np.int64)
    weights = np.zeros((len(centres), n_neighbors))
    for first, last in pairwise(bounds):
        n = int(last - first)
        k = min(n_neighbors, n - 1)
        around[first:last] = np.arange(n)[:, None]
        if k < 1:
            weights[first:last, 0] = 1.0
            continue
        nearest = nearest_neighbors(centres[first:last], k=k + 1)[0].reshape(n, k + 1)
        others = nearest != np.arange(n)[:, None]
        others[others.all(axis=1), -1] = False  # coincident parts: the part itself need not be among its nearest
        near = nearest[others].reshape(n, k)
        away = centres[first:last][near] - centres[first:last, None]
        gram = away @ away.transpose(0, 2, 1)
        gram += (1e-3 * np.trace(gram, axis1=1, axis2=2) + 1e-9)[:, None, None] * np.eye(k)
        solved = np.linalg.solve(gram, np.ones((n, k, 1)))[..., 0]
        around[first:last, :k], weights[first:last, :k] = near, solved / solved.sum(axis=1, keepdims=True)
    return around, weights


def object_similarity(
    parts: Description, prototypes: Description, geometry: NDArray[np.float64], *, intensity: bool, n_threads: int = 1
) -> NDArray[np.float64]:
    """Return the similarity of every object to every prototype."""
    share, reach, limit, n_neighbors, n_turns, n_sweeps, least = geometry.tolist()
    middle, bounds = relative_centres(prototypes), object_bounds(prototypes)
    around, weights = affine_combinations(middle, bounds, int(n_neighbors))
    turns = np.arange(int(n_turns)) * (2.0 * np.pi / int(n_turns))
    theirs, own = descriptors_of(prototypes, intensity=intensity), descriptors_of(parts, intensity=intensity)
    centres, own_bounds = relative_centres(parts), object_bounds(parts)
    out = np.zeros((len(own_bounds) - 1, len(bounds) - 1))

    def work(start: int, stop: int) -> None:
        match_objects(
            middle, theirs, bounds, around, weights, centres, own, own_bounds, turns, share, reach, limit,
            int(n_sweeps), least, out, start, stop,
        )  # fmt: skip

    run_in_chunks(work, len(out), n_threads=n_threads)
    return out
