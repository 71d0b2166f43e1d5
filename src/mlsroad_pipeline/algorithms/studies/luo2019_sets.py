"""Simulated sets of objects that mirror HDRObject9 and SMDObject6: classes, imbalance, split (Luo et al. 2019)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.exceptions import ParameterError
from mlsroad_pipeline.algorithms.metrics.instances import find_overlaps
from mlsroad_pipeline.algorithms.object_segmentation import (
    METHODS,
    SegmentationParameters,
    reference_objects,
    segment_scene,
)
from mlsroad_pipeline.algorithms.recognition import ObjectSet
from mlsroad_pipeline.algorithms.recognition_objects import RecognitionParameters, cut_objects
from mlsroad_pipeline.algorithms.scene_stages import GroundParameters
from mlsroad_pipeline.algorithms.simulation.presets import SimulationParameters
from mlsroad_pipeline.algorithms.studies import luo2019_paper
from mlsroad_pipeline.algorithms.studies.streets import make_street
from mlsroad_pipeline.algorithms.validation import check_positive


@dataclass(frozen=True)
class ObjectSetParameters:
    """One simulated set of objects.

    Parameters
    ----------
    share : float
        Objects as a share of the paper's; 1 is as many. Every class has the same share, so that the imbalance is the
        paper's, as far as there are enough objects in the streets.
    survey : mapping
        ``preset`` and changes of `SimulationParameters`, without the seed.
    first_seed : int
        Seed of the first street; the others follow.
    streets : int
        Streets, at least 3: every split has at least one.

    Raises
    ------
    ParameterError
        If a number is out of range or the survey names a seed.
    """

    share: float
    survey: Mapping[str, Any]
    first_seed: int
    streets: int

    def __post_init__(self) -> None:
        if not 0 < self.share <= 1:
            raise ParameterError(f"simulated_objects: share must be above 0 and at most 1, got {self.share!r}")
        if self.streets < len(luo2019_paper.SPLITS) or self.first_seed < 0:
            raise ParameterError(
                f"simulated_objects: streets must be at least {len(luo2019_paper.SPLITS)} and first_seed at least 0, "
                f"got {self.streets!r} and {self.first_seed!r}"
            )
        if "seed" in self.survey:
            raise ParameterError("simulated_objects: the seeds of the streets follow from first_seed")

    def seeds_of_splits(self) -> dict[str, list[int]]:
        """Share the streets out.

        Returns
        -------
        dict of str to list of int
            Split to the seeds of its streets, 70, 10 and 20 per cent of them, at least one each. Streets are as
            different from their neighbours in this order as from any other.
        """
        counts = {name: max(round(share * self.streets), 1) for name, share in luo2019_paper.SPLITS.items()}
        counts["train"] = self.streets - counts["validation"] - counts["test"]
        bounds = np.cumsum([self.first_seed, *counts.values()])
        return {name: list(range(bounds[i], bounds[i + 1])) for i, name in enumerate(counts)}


@dataclass(frozen=True)
class CutParameters:
    """Which segments are objects of a set.

    Parameters
    ----------
    min_points : int
        Smaller ones are left out.
    purity : float
        Share of a segment's points that must be of instances of its class; mixed ones are left out.
    completeness : float
        Share of an instance's points that a segment must hold; smaller pieces are left out.
    max_points : int
        Of larger objects as many points are drawn.
    segmentation : str
        Name of the segmentation, see `SegmentationParameters`; its parameters are those of the stage.
    reach : float
        Points farther from the track than this are left out, metres.

    Raises
    ------
    ParameterError
        If a value is out of range.
    """

    min_points: int
    purity: float
    completeness: float
    max_points: int
    segmentation: str
    reach: float

    def __post_init__(self) -> None:
        RecognitionParameters(min_points=self.min_points, purity=self.purity)
        if self.max_points < self.min_points:
            raise ParameterError(f"simulated_objects.cut.max_points {self.max_points!r} is below min_points")
        if not 0 <= self.completeness <= 1:
            raise ParameterError(f"simulated_objects.cut.completeness must be in [0, 1], got {self.completeness!r}")
        if self.segmentation not in METHODS:
            raise ParameterError(
                f"simulated_objects.cut.segmentation must be one of {', '.join(METHODS)}, got {self.segmentation!r}"
            )
        check_positive(self.reach, "simulated_objects.cut.reach")


@dataclass(frozen=True)
class SimulatedObjectsParameters:
    """The simulated sets.

    Parameters
    ----------
    scale : str
        Which of `scales` is made.
    scales : mapping
        Name to set, one of ``hdr9`` and ``smd6``, to the fields of `ObjectSetParameters`.
    cut : CutParameters or mapping
        Which segments are objects.
    seed : int
        Seed of the draws.

    Raises
    ------
    ParameterError
        If there is no such scale, or it is wrong.
    """

    scale: str
    scales: Mapping[str, Mapping[str, Any]]
    cut: CutParameters
    seed: int

    def __post_init__(self) -> None:
        if isinstance(self.cut, Mapping):
            object.__setattr__(self, "cut", CutParameters(**self.cut))
        if self.scale not in self.scales:
            raise ParameterError(
                f"simulated_objects.scale {self.scale!r} is unknown (scales: {', '.join(self.scales)})"
            )
        self.chosen_sets()

    def chosen_sets(self) -> dict[str, ObjectSetParameters]:
        """Return the sets that are made.

        Returns
        -------
        dict of str to ObjectSetParameters
            Name of the set to its parameters.

        Raises
        ------
        ParameterError
            If a set or a field is unknown, or a field is missing.
        """
        known = sorted(entry.name for entry in fields(ObjectSetParameters))
        found = {}
        for name, given in self.scales[self.scale].items():
            where = f"simulated_objects.scales.{self.scale}.{name}"
            if name not in luo2019_paper.OBJECTS:
                raise ParameterError(f"{where}: the paper has no such set ({', '.join(luo2019_paper.OBJECTS)})")
            if sorted(given) != known:
                raise ParameterError(f"{where} must have {known}, got {sorted(given)}")
            found[name] = ObjectSetParameters(**given)
        return found


def cut_street(
    *,
    simulation: SimulationParameters,
    ground: GroundParameters,
    segmentation: SegmentationParameters,
    scheme: ClassScheme,
    wanted: Sequence[str],
    parameters: CutParameters,
) -> dict[str, NDArray]:
    """Simulate a street, segment it, and name its objects by the truth of their points.

    Parameters
    ----------
    simulation : SimulationParameters
        The survey.
    ground : GroundParameters
        The ground filter.
    segmentation : SegmentationParameters
        The segmentation.
    scheme : ClassScheme
        The classes.
    wanted : sequence of str
        Classes that are kept.
    parameters : CutParameters
        Which objects.

    Returns
    -------
    dict of str to ndarray
        The arrays of an `ObjectSet`, and ``street`` int64: the seed, for each object.
    """
    columns = ("intensity", "gps_time", "scanner", "label", "instance")
    street = make_street(simulation=simulation, ground=ground, columns=columns, reach=parameters.reach)
    whole = street.with_columns(core=np.ones(len(street), dtype=np.bool_))
    method = replace(segmentation, method=parameters.segmentation)
    segments = segment_scene(whole, {"ground": whole["ground"]}, method)
    recognition = RecognitionParameters(min_points=parameters.min_points)
    cut = cut_objects(whole.without_columns(["label"]), segments, scheme=scheme, parameters=recognition)
    label = name_segments(
        *reference_objects(whole, scheme),
        segments["objects"],
        purity=parameters.purity,
        completeness=parameters.completeness,
    )[cut["object"]]
    chosen = np.isin(label, [scheme.classes.index(name) for name in wanted])
    named = ObjectSet.from_arrays({**cut, "label": label}).take(chosen)
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
    """Name segments by the instance that most of their points belong to.

    A gantry is a gantry with the signs that hang on it, which have a class of their own but not an instance.

    Parameters
    ----------
    instances : ndarray of int, shape (n,)
        Instance of each point, 0 for none.
    classes : ndarray of int16, shape (instances + 1,)
        Class of each instance.
    segments : ndarray of int, shape (n,)
        Segment of each point, -1 for none.
    purity : float
        Share of a segment's points that must be of instances of its class.
    completeness : float
        Share of its instance's points that it must hold.

    Returns
    -------
    ndarray of int16
        Class of each segment; -1 for what is mixed, a piece, or of no instance.
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
    """Draw points of large objects.

    Parameters
    ----------
    objects : ObjectSet
        The objects.
    max_points : int
        Most points of an object.
    seed : int
        Seed of the draw.

    Returns
    -------
    ObjectSet
        The objects with at most so many points, in their order.
    """
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


def draw_split(
    streets: Mapping[str, Mapping[str, NDArray]], *, limits: Mapping[int, int], seed: int
) -> dict[str, NDArray]:
    """Join the objects of a split's streets and draw as many of each class as the set shall have.

    Parameters
    ----------
    streets : mapping of str to mapping
        Street to what `cut_street` gave.
    limits : mapping of int to int
        Class to the most objects of it.
    seed : int
        Seed of the draw.

    Returns
    -------
    dict of str to ndarray
        The arrays of an `ObjectSet`, ``street`` of each object, and ``found`` int64 (classes): objects of each class
        before the draw.
    """
    joined = ObjectSet.join([ObjectSet.from_arrays(streets[key]) for key in sorted(streets)])
    street = np.concatenate([streets[key]["street"] for key in sorted(streets)])
    rng = np.random.default_rng(seed)
    drawn = [rng.permutation(np.flatnonzero(joined.label == label))[:most] for label, most in limits.items()]
    rows = np.sort(np.concatenate(drawn))
    found = np.bincount(joined.label[joined.label != IGNORE], minlength=max(limits) + 1)
    return {**joined.take(rows).to_arrays(), "street": street[rows], "found": found}


def wanted_objects(name: str, parameters: ObjectSetParameters, scheme: ClassScheme) -> dict[str, dict[int, int]]:
    """Return how many objects of each class every split shall have.

    Parameters
    ----------
    name : str
        The set.
    parameters : ObjectSetParameters
        Its share of the paper's objects.
    scheme : ClassScheme
        Its classes.

    Returns
    -------
    dict of str to dict
        Split to class to number, at least 1.
    """
    return {
        split: {
            scheme.classes.index(c): max(round(parameters.share * share * n), 1)
            for c, n in luo2019_paper.OBJECTS[name].items()
        }
        for split, share in luo2019_paper.SPLITS.items()
    }


def composition_table(
    sets: Mapping[str, Mapping[str, NDArray]],
    wanted: Mapping[str, Mapping[int, int]],
    schemes: Mapping[str, ClassScheme],
) -> pd.DataFrame:
    """Tell what the sets are made of.

    Parameters
    ----------
    sets : mapping of str to mapping
        ``<set>.<split>`` to what `draw_split` gave.
    wanted : mapping of str to mapping
        The same to class to the number that was wanted.
    schemes : mapping of str to ClassScheme
        Set to its classes.

    Returns
    -------
    DataFrame
        Columns `set`, `split`, `class`, `streets`, `paper` (objects of the class in the paper's set as a whole),
        `wanted`, `found` in the streets, `objects` that were taken, `median_points`.
    """
    rows = []
    for key, found in sets.items():
        name, _, split = key.partition(".")
        sizes = np.diff(found["indptr"])
        for label, number in wanted[key].items():
            mine, named = found["label"] == label, schemes[name].classes[label]
            rows.append(
                {
                    "set": name,
                    "split": split,
                    "class": named,
                    "streets": len(np.unique(found["street"][mine])),
                    "paper": luo2019_paper.OBJECTS[name][named],
                    "wanted": number,
                    "found": int(found["found"][label]),
                    "objects": int(mine.sum()),
                    "median_points": float(np.median(sizes[mine])) if mine.any() else np.nan,
                }
            )
    return pd.DataFrame(rows)
