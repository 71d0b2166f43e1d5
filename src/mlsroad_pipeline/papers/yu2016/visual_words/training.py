"""Vocabulary with a detector, and its training (Yu et al. 2016, sections III to V)."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.validation import parse_groups
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under
from mlsroad_pipeline.papers.shared.detection.detector import GEOMETRY, WITH_INTENSITY
from mlsroad_pipeline.papers.shared.detection.regions import RegionParameters
from mlsroad_pipeline.papers.shared.detection.scoring import DetectionParameters, ObjectClasses
from mlsroad_pipeline.papers.shared.detection.training import (
    DetectorTraining,
    bundle_variants,
    training_keys,
    training_weights,
)
from mlsroad_pipeline.papers.shared.detection.types import Description
from mlsroad_pipeline.papers.yu2016.visual_words.appearance import count_words, within_any_sizes
from mlsroad_pipeline.papers.yu2016.visual_words.detector import VisualWordsDetector
from mlsroad_pipeline.papers.yu2016.visual_words.groups import (
    ContextualGroups,
    GroupParameters,
    groups_of,
    join_groups,
    profiles_of,
)
from mlsroad_pipeline.papers.yu2016.visual_words.queries import DetectorParameters
from mlsroad_pipeline.papers.yu2016.visual_words.vocabulary import Vocabulary, VocabularyParameters, build_vocabulary


def bag_objects(
    arrays: Description, vocabulary: Vocabulary, *, intensity: bool, wanted: NDArray[np.bool_] | None = None
) -> csr_array:
    """Count the words of the objects of a scene."""
    owner, groups = arrays["objects"], groups_of(arrays, intensity=intensity)
    if wanted is not None:
        rows = np.flatnonzero(wanted[owner])
        owner, groups = owner[rows], groups.select(rows)
    words = vocabulary.quantise(groups)
    return count_words(words, owner, n_objects=int(arrays["n_objects"]), stopped=vocabulary.stopped)


@dataclass(frozen=True)
class VisualWords:
    """Trained vocabulary and detector; see `trained_detector`."""

    vocabulary: Vocabulary
    detector: VisualWordsDetector
    intensity: bool  # Whether intensity is used

    @property
    def thresholds(self) -> NDArray[np.float64]:
        """Lowest score of each class at which an object is detected."""
        return self.detector.thresholds

    def score(self, parts: Description) -> NDArray[np.float64]:
        """Return the scores of objects described by `describe_objects`."""
        possible = self.detector.possible(parts["sizes"])
        counts = bag_objects(parts, self.vocabulary, intensity=self.intensity, wanted=possible)
        return self.detector.score(counts, parts["sizes"], profiles_of(parts, intensity=self.intensity))

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the trained state as plain arrays."""
        words, own = self.vocabulary.words, self.vocabulary
        learned: dict[str, NDArray] = {
            "descriptors": words.descriptors, "orientations": words.orientations, "scales": words.scales,
            "inverse": own.inverse, "stopped": own.stopped, "floor": np.array(own.floor),
        }  # fmt: skip
        return {**{f"words.{name}": values for name, values in learned.items()}, **self.detector.to_arrays()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], *, intensity: bool) -> Self:
        """Rebuild a vocabulary and its detector."""
        own = arrays_under(arrays, "words.")
        words = ContextualGroups(own["descriptors"], own["orientations"], own["scales"])
        vocabulary = Vocabulary(words, own["inverse"], own["stopped"], float(own["floor"]))
        return cls(vocabulary, VisualWordsDetector.from_arrays(arrays), intensity)


@dataclass(frozen=True)
class VisualWordsParameters:
    """All parameters of the method."""

    # Supervoxels and neighbourhoods of the feature regions
    regions: RegionParameters = field(default_factory=RegionParameters)
    k: int = 2  # Neighbours in a contextual group (yu2016: 2)
    vocabulary: VocabularyParameters = field(default_factory=VocabularyParameters)  # Clustering of groups into words
    detector: DetectorParameters = field(default_factory=DetectorParameters)  # Choice of queries
    # Whether a second vocabulary and detector are trained without intensity, for surveys that have none. False halves
    # the training time.
    without_intensity: bool = True

    def __post_init__(self) -> None:
        parse_groups(self, regions=RegionParameters, vocabulary=VocabularyParameters, detector=DetectorParameters)

    @property
    def groups(self) -> GroupParameters:
        """Parameters of the description of objects."""
        return GroupParameters(self.regions, self.k)


def train_detector(
    groups: Mapping[str, Description], labels: Mapping[str, ObjectClasses], training: DetectorTraining
) -> ModelBundle:
    """Train vocabulary, queries and thresholds."""
    keys, parameters = training_keys(labels), training.parameters
    intensity = all(bool(groups[key]["intensity"]) for key in keys)
    variants = [WITH_INTENSITY] if intensity else []
    if parameters.without_intensity or not intensity:
        variants.append(GEOMETRY)
    scenes = [groups[key] for key in keys], [labels[key] for key in keys]
    with ThreadPoolExecutor(min(training.n_threads, len(variants))) as pool:
        jobs = [pool.submit(train_variant, *scenes, training, variant == WITH_INTENSITY) for variant in variants]
    fitted = {variant: _fitted(job.result()) for variant, job in zip(variants, jobs, strict=True)}
    return bundle_variants(fitted, training, groups=asdict(parameters.groups))


class WordObjects(NamedTuple):
    """Training objects in words of a vocabulary."""

    counts: csr_array  # Words of the objects
    labels: NDArray[np.integer]  # Class of each, an index in the wanted classes; -1 for all others
    sizes: NDArray[np.float32]  # Sizes, see `measure_sizes`
    profiles: NDArray[np.float32]  # Profiles, see `measure_profiles`
    scenes: NDArray[np.int64]  # Scene of each, an index
    weights: NDArray[np.float64]  # Weight of each object in threshold selection, see `training_weights`


def train_variant(
    groups: Sequence[Description], labels: Sequence[ObjectClasses], training: DetectorTraining, intensity: bool
) -> VisualWords:
    """Train one variant on the objects that the training scenes own."""
    vocabulary, objects = make_words(groups, labels, training, intensity)
    parameters = training.parameters.detector
    detector = VisualWordsDetector(training.detection.classes, parameters=parameters).fit(**objects._asdict())
    return VisualWords(vocabulary, detector, intensity)


def make_words(
    groups: Sequence[Description], labels: Sequence[ObjectClasses], training: DetectorTraining, intensity: bool
) -> tuple[Vocabulary, WordObjects]:
    """Build the vocabulary of the training scenes, and count its words in the objects that they own.

    Objects whose size no wanted class has are left out.
    """
    parameters, detection = training.parameters, training.detection
    own = np.concatenate([classes["own"] for classes in labels])
    label = np.concatenate([classes["label"] for classes in labels])
    sizes = np.concatenate([described["sizes"] for described in groups])
    n_objects = [len(classes["own"]) for classes in labels]  # a scene may have none
    scene = np.repeat(np.arange(len(labels)), n_objects)
    rows = np.flatnonzero(own & _of_possible_size(sizes, np.where(own, label, IGNORE), detection, parameters.detector))
    number = np.full(len(own), -1, np.int64)
    number[rows] = np.arange(len(rows))
    of_scene = np.split(number, np.cumsum(n_objects)[:-1])
    of_group = [part[described["objects"]] for part, described in zip(of_scene, groups, strict=True)]
    parts = [
        groups_of(described, intensity=intensity).select(np.flatnonzero(part >= 0))
        for part, described in zip(of_group, groups, strict=True)
    ]
    objects = np.concatenate([part[part >= 0] for part in of_group])
    scenes = np.repeat(np.arange(len(groups)), [len(part) for part in parts])
    vocabulary, words = build_vocabulary(
        join_groups(parts), scenes, parameters=parameters.vocabulary, n_threads=training.n_threads
    )
    counts = count_words(words, objects, n_objects=len(rows), stopped=vocabulary.stopped)
    profiles = np.concatenate([profiles_of(described, intensity=intensity) for described in groups])
    truth = np.where(label[rows] < 0, IGNORE, label[rows])
    weights = np.ones(len(own))
    weights[own] = training_weights(labels, detection.factors)
    return vocabulary, WordObjects(counts, truth, sizes[rows], profiles[rows], scene[rows], weights[rows])


def _of_possible_size(
    sizes: NDArray[np.float32], label: NDArray, detection: DetectionParameters, parameters: DetectorParameters
) -> NDArray[np.bool_]:
    """Return which objects have a size that a wanted class has; all where no other object has."""
    examples = [sizes[label == k] for k in range(len(detection.classes))]
    possible = within_any_sizes(sizes, examples, parameters.size_margin)
    others = label == IGNORE
    return possible if (possible & others).any() else np.ones(len(sizes), np.bool_)


def _fitted(trained: VisualWords) -> tuple[dict[str, NDArray], dict[str, Any]]:
    """Return arrays and figures of a trained variant."""
    queries = trained.detector.queries_
    facts = {
        "words": len(trained.vocabulary),
        "queries": {name: len(of_class.appearance) for name, of_class in queries.items()},
        "f_scores": trained.detector.f_scores_,
        "thresholds": {
            name: of_class.threshold for name, of_class in queries.items() if np.isfinite(of_class.threshold)
        },
    }
    return trained.to_arrays(), facts
