"""Hough forest on supervoxel neighbourhoods, a baseline of Yu et al. 2016 (V-E): parts vote for an object's centre.

After Wang et al. 2015 (JSTARS 8(4)) and Gall and Lempitsky 2009; assumptions:
`docs/methods/detection_baselines.md`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.parameter_groups import parse_groups
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_arrays, check_at_least, check_positive, check_tested
from mlsroad_pipeline.algorithms.geometry.cell_grid import run_in_chunks
from mlsroad_pipeline.papers.shared.detection.detector import detect_by_description, label_described_objects
from mlsroad_pipeline.papers.shared.detection.parts import describe_parts, descriptors_of, heights_of
from mlsroad_pipeline.papers.shared.detection.regions import RegionParameters
from mlsroad_pipeline.papers.shared.detection.types import Description, Segments, object_bounds
from mlsroad_pipeline.papers.yu2016.hough_forest._trees import vote

SLUG = "hough_forest"

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
    min_parts: int = 4  # Fewest training parts in a leaf
    # Random splits evaluated at a node, of which the best is used. More give purer leaves and more correlated trees.
    n_tests: int = 40
    n_votes: int = 8  # Largest number of offsets that a leaf stores for a class, thinned evenly
    # Horizontal size of the cells of the vote space, metres. Smaller separates centres, and scatters votes.
    cell: float = 0.2
    height_cell: float = 0.5  # Their vertical size, metres
    # Candidate exponents of the number of voting parts that peaks are divided by; the best on the training objects is
    # used. 0 gives the sum of votes, 1 their mean.
    exponents: Sequence[float] = (0.0, 0.5, 1.0)
    max_per_class: int = 400  # Largest number of training objects of a class for the trees
    max_others: int = 1200  # Largest number of training objects of no wanted class
    max_parts: int = 60  # Largest number of training parts of an object
    seed: int = 2016  # Seed of samples and splits

    def __post_init__(self) -> None:
        parse_groups(self, regions=RegionParameters)
        for name in ("n_trees", "max_depth", "min_parts", "n_tests", "n_votes", "max_per_class", "max_parts"):
            check_at_least(getattr(self, name), 1, f"{SLUG}.{name}")
        if self.max_others < 0:
            raise ParameterError(f"{SLUG}.max_others must not be negative, got {self.max_others!r}")
        for name in ("cell", "height_cell"):
            check_positive(getattr(self, name), f"{SLUG}.{name}")
        if not self.exponents:
            raise ParameterError(f"{SLUG}.exponents must name at least one power")


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


def _describe(scene: PointCloud, objects: Segments, stored: Mapping[str, Any]) -> Description:
    return describe_parts(scene, objects, parameters=HoughForestParameters(**stored[SLUG]).regions)


detect_scene = partial(detect_by_description, detector=HoughForest)
"""Detects the objects of a scene, described by `describe_parts`, with a model of this method."""

label_cloud = partial(label_described_objects, describe=_describe, detect=detect_scene)
"""Labels a cloud; intensity is used where the cloud and the model have it."""
