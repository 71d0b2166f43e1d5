"""Simulated sets of objects with the classes, imbalance and split of HDRObject9 and SMDObject6 (Luo et al. 2019)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.core.validation import check_positive, parse_groups
from mlsroad_pipeline.algorithms.metrics.instances import find_overlaps
from mlsroad_pipeline.algorithms.segmentation.stage import (
    METHODS,
    SegmentationParameters,
    Segments,
    reference_objects,
    segment_scene,
)
from mlsroad_pipeline.papers.shared.recognition.cutting import RecognitionParameters, cut_objects
from mlsroad_pipeline.papers.shared.recognition.object_set import ObjectArrays, ObjectSet
from mlsroad_pipeline.papers.shared.studies.parameters import from_fields, scale_values
from mlsroad_pipeline.papers.shared.studies.streets import make_street
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters

OBJECTS: dict[str, dict[str, int]] = {
    "hdr9": {
        "bus station": 1143, "light pole": 4175, "road sign": 1281, "station sign": 2062, "traffic light": 1728,
        "traffic sign": 4687, "trashcan": 1456, "palm": 4200, "cycas": 1920,
    },
    "smd6": {
        "car": 1265, "light pole": 2500, "pedestrian": 740, "road sign": 855, "traffic sign": 2930, "tree": 1203,
    },
}  # fmt: skip
"""Objects of each class of HDRObject9 and SMDObject6 (section 4.1), by the names of the class schemes."""

SPLITS = {"train": 0.7, "validation": 0.1, "test": 0.2}
"""Shares of the splits."""

BY_HAND = "by_hand"
"""Name for objects that are the simulator's instances instead of segments."""


@dataclass(frozen=True)
class ObjectSetParameters:
    """Parameters of one simulated set of objects."""

    # Objects as a share of the paper's; 1 is the same number. Every class has the same share, so that the class
    # imbalance is the paper's as far as the streets have enough objects.
    share: float
    survey: Mapping[str, Any]  # ``preset`` and changes of `SimulationParameters`, without the seed
    first_seed: int  # Seed of the first street; the seeds are consecutive
    streets: int  # Number of streets, at least 3: every split has at least one

    def __post_init__(self) -> None:
        if not 0 < self.share <= 1:
            raise ParameterError(f"simulated_objects: share must be above 0 and at most 1, got {self.share!r}")
        if self.streets < len(SPLITS) or self.first_seed < 0:
            raise ParameterError(
                f"simulated_objects: streets must be at least {len(SPLITS)} and first_seed at least 0, "
                f"got {self.streets!r} and {self.first_seed!r}"
            )
        if "seed" in self.survey:
            raise ParameterError(
                "simulated_objects: survey must not have a seed; the seeds of the streets follow from first_seed"
            )

    def seeds_of_splits(self) -> dict[str, list[int]]:
        """Return the seeds of the streets of each split."""
        counts = {name: max(round(share * self.streets), 1) for name, share in SPLITS.items()}
        counts["train"] = self.streets - counts["validation"] - counts["test"]
        bounds = np.cumsum([self.first_seed, *counts.values()])
        return {name: list(range(bounds[i], bounds[i + 1])) for i, name in enumerate(counts)}


@dataclass(frozen=True)
class CutParameters:
    """Selection of the segments that become objects of a set."""

    min_points: int  # Fewest points of an object; smaller segments are excluded
    purity: float  # Smallest share of a segment's points in instances of its class; mixed segments are excluded
    completeness: float  # Smallest share of an instance's points in its segment; smaller fragments are excluded
    max_points: int  # Most points of an object; larger ones are sampled randomly
    # Name of the segmentation, see `SegmentationParameters`; its parameters are those of the stage. "by_hand" takes the
    # simulator's instances instead, as the paper's objects were separated by hand.
    segmentation: str
    reach: float  # Largest distance of points from the track, metres

    def __post_init__(self) -> None:
        RecognitionParameters(min_points=self.min_points, purity=self.purity)
        if self.max_points < self.min_points:
            raise ParameterError(f"simulated_objects.cut.max_points {self.max_points!r} is below min_points")
        if not 0 <= self.completeness <= 1:
            raise ParameterError(f"simulated_objects.cut.completeness must be in [0, 1], got {self.completeness!r}")
        known = (*METHODS, BY_HAND)
        if self.segmentation not in known:
            raise ParameterError(
                f"simulated_objects.cut.segmentation must be one of {', '.join(known)}, got {self.segmentation!r}"
            )
        check_positive(self.reach, "simulated_objects.cut.reach")


@dataclass(frozen=True)
class SimulatedObjectsParameters:
    """Parameters of the simulated sets."""

    scale: str  # Name of the scale that is made
    # Name of each scale to its sets, ``hdr9`` or ``smd6``, each with the fields of `ObjectSetParameters`
    scales: Mapping[str, Mapping[str, Any]]
    cut: CutParameters  # Selection of the segments that become objects
    seed: int  # Seed of the sampling of objects

    def __post_init__(self) -> None:
        parse_groups(self, cut=CutParameters)
        self.chosen_sets()

    def chosen_sets(self) -> dict[str, ObjectSetParameters]:
        """Return the parameters of the sets of the scale."""
        sets = {}
        for name, values in scale_values("simulated_objects", self.scale, self.scales).items():
            where = f"simulated_objects.scales.{self.scale}.{name}"
            if name not in OBJECTS:
                raise ParameterError(f"{where}: the paper has no such set (sets: {', '.join(OBJECTS)})")
            sets[name] = from_fields(ObjectSetParameters, where, values)
        return sets


class SplitKey(NamedTuple):
    """Split of a set of objects; as text, its key in the store."""

    name: str  # name of the set
    split: str

    def __str__(self) -> str:
        """Return the stored key."""
        return f"{self.name}.{self.split}"


class StreetObjects(ObjectArrays):
    """Objects of streets, with the seed of the street of each."""

    street: NDArray[np.int64]


class SplitObjects(StreetObjects):
    """Objects of a split, with the number of objects of each class on its streets."""

    found: NDArray[np.int64]


def cut_street(
    *,
    simulation: SimulationParameters,
    ground: GroundParameters,
    segmentation: SegmentationParameters,
    scheme: ClassScheme,
    wanted: Sequence[str],
    parameters: CutParameters,
) -> StreetObjects:
    """Simulate a street, segment it, and assign its objects the true classes of their points."""
    columns = ("intensity", "gps_time", "scanner", "label", "instance")
    street = make_street(simulation=simulation, ground=ground, columns=columns, reach=parameters.reach)
    whole = street.with_columns(core=np.ones(len(street), dtype=np.bool_))
    instances, classes = reference_objects(whole, scheme)
    if parameters.segmentation == BY_HAND:
        segments = Segments(objects=instances - np.int32(1))
    else:
        method = replace(segmentation, method=parameters.segmentation)
        segments = segment_scene(whole, {"ground": whole["ground"]}, method)
    recognition = RecognitionParameters(min_points=parameters.min_points)
    cut = cut_objects(whole.without_columns(["label"]), segments, scheme=scheme, parameters=recognition)
    label = name_segments(
        instances,
        classes,
        segments["objects"],
        purity=parameters.purity,
        completeness=parameters.completeness,
    )[cut["object"]]
    chosen = np.isin(label, [scheme.classes.index(name) for name in wanted])
    named = ObjectSet(cut["xyz"], cut["indptr"], label, cut.get("intensity")).take(chosen)
    kept = thin(named, parameters.max_points, simulation.seed)
    return {**kept.to_arrays(), "street": np.full(len(kept), simulation.seed, dtype=np.int64)}


def name_segments(
    instances: NDArray[np.integer],
    classes: NDArray[np.int16],
    segments: NDArray[np.integer],
    *,
    purity: float,
    completeness: float,
) -> NDArray[np.int16]:
    """Assign each segment the class of the instance that most of its points belong to.

    Signs on a gantry have a class but no instance of their own; they belong to the gantry.
    """
    label = np.full(int(segments.max(initial=-1)) + 1, IGNORE, dtype=np.int16)
    pairs = find_overlaps(instances, segments)
    if not len(pairs.shared):
        return label
    order = np.lexsort((-pairs.shared, pairs.segment))
    own, first = np.unique(pairs.segment[order], return_index=True)
    first = order[first]
    of_class = classes[pairs.instances[pairs.instance]]
    named = np.full(len(pairs.segments), IGNORE, dtype=np.int16)
    named[own] = of_class[first]
    alike = np.bincount(pairs.segment, pairs.shared * (of_class == named[pairs.segment]), len(pairs.segments))
    whole = pairs.shared[first] >= completeness * pairs.instance_sizes[pairs.instance[first]]
    good = whole & (alike[own] >= purity * pairs.segment_sizes[own])
    label[pairs.segments[own[good]]] = named[own[good]]
    return label


def thin(objects: ObjectSet, max_points: int, seed: int) -> ObjectSet:
    """Sample points of large objects."""
    rng = np.random.default_rng(seed)
    counts = np.diff(objects.indptr)
    rows = [
        first + (np.sort(rng.choice(n, max_points, replace=False)) if n > max_points else np.arange(n))
        for first, n in zip(objects.indptr[:-1], counts, strict=True)
    ]
    chosen = np.concatenate(rows) if rows else np.zeros(0, dtype=np.int64)
    indptr = np.append(0, np.cumsum(np.minimum(counts, max_points))).astype(np.int64)
    intensity = None if objects.intensity is None else objects.intensity[chosen]
    return ObjectSet(objects.xyz[chosen], indptr, objects.label, intensity)


def draw_split(streets: Mapping[str, StreetObjects], *, limits: Mapping[int, int], seed: int) -> SplitObjects:
    """Join the objects of a split's streets and sample up to a number of objects per class."""
    joined = ObjectSet.join([ObjectSet.from_arrays(streets[key]) for key in sorted(streets)])
    street = np.concatenate([streets[key]["street"] for key in sorted(streets)])
    rng = np.random.default_rng(seed)
    drawn = [rng.permutation(np.flatnonzero(joined.label == label))[:most] for label, most in limits.items()]
    rows = np.sort(np.concatenate(drawn))
    found = np.bincount(joined.label[joined.label != IGNORE], minlength=max(limits) + 1)
    return {**joined.take(rows).to_arrays(), "street": street[rows], "found": found}


def wanted_objects(name: str, parameters: ObjectSetParameters, scheme: ClassScheme) -> dict[str, dict[int, int]]:
    """Return the wanted number of objects of each class in every split."""
    return {
        split: {scheme.classes.index(c): max(round(parameters.share * share * n), 1) for c, n in OBJECTS[name].items()}
        for split, share in SPLITS.items()
    }


def composition_table(
    sets: Mapping[SplitKey, SplitObjects],
    wanted: Mapping[SplitKey, Mapping[int, int]],
    schemes: Mapping[str, ClassScheme],
) -> pd.DataFrame:
    """Return the wanted, available and sampled objects of each class and split."""
    rows = []
    for (name, split), one in sets.items():
        sizes = np.diff(one["indptr"])
        for label, number in wanted[SplitKey(name, split)].items():
            mine, named = one["label"] == label, schemes[name].classes[label]
            rows.append(
                {
                    "set": name,
                    "split": split,
                    "class": named,
                    "streets": len(np.unique(one["street"][mine])),
                    "paper": OBJECTS[name][named],
                    "wanted": number,
                    "found": int(one["found"][label]),
                    "objects": int(mine.sum()),
                    "median_points": float(np.median(sizes[mine])) if mine.any() else np.nan,
                }
            )
    return pd.DataFrame(rows)
