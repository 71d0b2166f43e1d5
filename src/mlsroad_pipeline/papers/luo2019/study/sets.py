"""Simulated sets of objects with the classes, imbalance and split of HDRObject9 and SMDObject6 (Luo et al. 2019)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.metrics.instances import find_overlaps
from mlsroad_pipeline.algorithms.segmentation.stage import (
    SegmentationParameters,
    Segments,
    reference_objects,
    segment_scene,
)
from mlsroad_pipeline.papers.luo2019.study import paper as luo2019_paper
from mlsroad_pipeline.papers.luo2019.study.set_parameters import BY_HAND, CutParameters, ObjectSetParameters
from mlsroad_pipeline.papers.shared.recognition.cutting import RecognitionParameters, cut_objects
from mlsroad_pipeline.papers.shared.recognition.object_set import ObjectArrays, ObjectSet
from mlsroad_pipeline.papers.shared.studies.streets import make_street
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters


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
        split: {
            scheme.classes.index(c): max(round(parameters.share * share * n), 1)
            for c, n in luo2019_paper.OBJECTS[name].items()
        }
        for split, share in luo2019_paper.SPLITS.items()
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
                    "paper": luo2019_paper.OBJECTS[name][named],
                    "wanted": number,
                    "found": int(one["found"][label]),
                    "objects": int(mine.sum()),
                    "median_points": float(np.median(sizes[mine])) if mine.any() else np.nan,
                }
            )
    return pd.DataFrame(rows)
