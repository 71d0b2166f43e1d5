"""Words, queries and thresholds learned from training scenes (Yu et al. 2016, III and V)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.detection.detector import GEOMETRY, WITH_INTENSITY, DetectionStages
from mlsroad_pipeline.algorithms.detection.regions import RegionParameters
from mlsroad_pipeline.algorithms.detection.scoring import DetectionParameters
from mlsroad_pipeline.algorithms.detection.thresholds import training_weights
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.visual_words.bags import count_words
from mlsroad_pipeline.algorithms.visual_words.descriptions import GroupParameters, groups_of, profiles_of
from mlsroad_pipeline.algorithms.visual_words.detector import VisualWordsDetector
from mlsroad_pipeline.algorithms.visual_words.groups import join_groups
from mlsroad_pipeline.algorithms.visual_words.labeller import SLUG
from mlsroad_pipeline.algorithms.visual_words.queries import DetectorParameters
from mlsroad_pipeline.algorithms.visual_words.sizes import within_any_sizes
from mlsroad_pipeline.algorithms.visual_words.vocabulary import Vocabulary, VocabularyParameters, build_vocabulary


@dataclass(frozen=True)
class VisualWordsParameters:
    """All parameters of the method.

    Parameters
    ----------
    regions : RegionParameters or mapping
        Supervoxels and neighbourhoods of the feature regions.
    k : int, default 2
        Neighbours in a contextual group (yu2016: 2).
    vocabulary : VocabularyParameters or mapping
        How groups become words.
    detector : DetectorParameters or mapping
        How queries are chosen.
    without_intensity : bool, default True
        Whether a second vocabulary and detector are made that never saw intensities, for surveys without them. Without
        it training takes half the time.
    """

    regions: RegionParameters = field(default_factory=RegionParameters)
    k: int = 2
    vocabulary: VocabularyParameters = field(default_factory=VocabularyParameters)
    detector: DetectorParameters = field(default_factory=DetectorParameters)
    without_intensity: bool = True

    def __post_init__(self) -> None:
        kinds = {"regions": RegionParameters, "vocabulary": VocabularyParameters, "detector": DetectorParameters}
        for name, kind in kinds.items():
            if isinstance(getattr(self, name), Mapping):
                object.__setattr__(self, name, kind(**getattr(self, name)))

    @property
    def groups(self) -> GroupParameters:
        """How the objects of a scene are described."""
        return GroupParameters(self.regions, self.k)


def train_detector(
    groups: Mapping[str, Mapping[str, NDArray]],
    labels: Mapping[str, Mapping[str, NDArray]],
    *,
    parameters: VisualWordsParameters,
    stages: DetectionStages,
    detection: DetectionParameters,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
    n_threads: int = 1,
) -> ModelBundle:
    """Learn words, queries and thresholds.

    Parameters
    ----------
    groups : mapping of str to mapping
        What `describe_objects` gave for each training scene.
    labels : mapping of str to mapping
        What `object_classes` gave for each of them.
    parameters : VisualWordsParameters
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
        The model: a vocabulary and a detector with intensity, where all scenes have it, and without, where wanted or
        some scene has none.

    Raises
    ------
    DataError
        If there are no training scenes, they have no objects, or a wanted class has none.
    """
    keys = sorted(labels)
    if not keys:
        raise DataError("no training scenes: the split 'train' is empty")
    intensity = all(bool(groups[key]["intensity"]) for key in keys)
    variants = [WITH_INTENSITY] if intensity else []
    if parameters.without_intensity or not intensity:
        variants.append(GEOMETRY)
    arrays: dict[str, NDArray] = {}
    facts: dict[str, Any] = {}
    with ThreadPoolExecutor(min(n_threads, len(variants))) as pool:
        jobs = [
            pool.submit(train_variant, [groups[key] for key in keys], [labels[key] for key in keys],
                        intensity=variant == WITH_INTENSITY, parameters=parameters, detection=detection,
                        n_threads=n_threads)
            for variant in variants
        ]  # fmt: skip
    for variant, job in zip(variants, jobs, strict=True):
        vocabulary, detector = job.result()
        arrays |= {f"{variant}.{name}": part for name, part in _arrays(vocabulary, detector).items()}
        facts[variant] = {
            "words": len(vocabulary),
            "queries": {name: len(found.looks) for name, found in detector.queries_.items()},
            "f_scores": detector.f_scores_,
            "thresholds": {
                name: found.threshold for name, found in detector.queries_.items() if np.isfinite(found.threshold)
            },
        }
    metadata = {
        "classes": list(scheme.classes),
        "wanted": detection.labels_in(scheme).tolist(),
        "scheme": asdict(scheme),
        "parameters": {**asdict(stages), "groups": asdict(parameters.groups), SLUG: asdict(parameters)},
        "attributes": ["intensity"] if intensity else [],
        "variants": variants,
        "learned": facts,
        "trained_on": dict(trained_on),
    }
    return ModelBundle(SLUG, arrays, metadata)


def train_variant(
    groups: Sequence[Mapping[str, NDArray]],
    labels: Sequence[Mapping[str, NDArray]],
    *,
    intensity: bool,
    parameters: VisualWordsParameters,
    detection: DetectionParameters,
    n_threads: int = 1,
) -> tuple[Vocabulary, VisualWordsDetector]:
    """Learn from all training scenes, with intensities or without; an object counts in the scene that owns it.

    Parameters
    ----------
    groups, labels : sequence of mapping
        What `describe_objects` and `object_classes` gave for each scene; a ``weight`` beside the latter is known to
        `training_weights`.
    intensity : bool
        Whether intensities count.
    parameters : VisualWordsParameters
        Parameters.
    detection : DetectionParameters
        The wanted classes.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    vocabulary : Vocabulary
        The words.
    detector : VisualWordsDetector
        The detector; scenes of its `held_out_` are places in `labels`.
    """
    own = np.concatenate([found["own"] for found in labels])
    label = np.concatenate([found["label"] for found in labels])
    sizes = np.concatenate([found["sizes"] for found in groups])
    n_objects = [len(found["own"]) for found in labels]  # a scene may have none
    scene = np.repeat(np.arange(len(labels)), n_objects)
    rows = np.flatnonzero(own & _compared(sizes, np.where(own, label, IGNORE), detection, parameters.detector))
    number = np.full(len(own), -1, np.int64)
    number[rows] = np.arange(len(rows))
    of_scene = np.split(number, np.cumsum(n_objects)[:-1])
    of_group = [part[found["objects"]] for part, found in zip(of_scene, groups, strict=True)]
    parts = [
        groups_of(found, intensity=intensity).select(np.flatnonzero(part >= 0))
        for part, found in zip(of_group, groups, strict=True)
    ]
    objects = np.concatenate([part[part >= 0] for part in of_group])
    scenes = np.repeat(np.arange(len(groups)), [len(part) for part in parts])
    vocabulary, words = build_vocabulary(
        join_groups(parts), scenes, parameters=parameters.vocabulary, n_threads=n_threads
    )
    counts = count_words(words, objects, n_objects=len(rows), stopped=vocabulary.stopped)
    profiles = np.concatenate([profiles_of(found, intensity=intensity) for found in groups])
    detector = VisualWordsDetector(detection.classes, parameters=parameters.detector)
    truth = np.where(label[rows] < 0, IGNORE, label[rows])
    known = {"sizes": sizes[rows], "profiles": profiles[rows], "scenes": scene[rows]}
    weights = np.ones(len(own))
    weights[own] = training_weights(labels, detection.factors)
    return vocabulary, detector.fit(counts, truth, **known, weights=weights[rows])


def _compared(
    sizes: NDArray[np.float32], label: NDArray, detection: DetectionParameters, parameters: DetectorParameters
) -> NDArray[np.bool_]:
    """Tell which objects are learned from: those of a size that a class may have, or all where no other is."""
    examples = [sizes[label == k] for k in range(len(detection.classes))]
    possible = within_any_sizes(sizes, examples, parameters.size_margin)
    others = label == IGNORE
    return possible if (possible & others).any() else np.ones(len(sizes), np.bool_)


def _arrays(vocabulary: Vocabulary, detector: VisualWordsDetector) -> dict[str, NDArray]:
    words = vocabulary.words
    return {
        "words.descriptors": words.descriptors,
        "words.orientations": words.orientations,
        "words.scales": words.scales,
        "words.inverse": vocabulary.inverse,
        "words.stopped": vocabulary.stopped,
        "words.floor": np.array(vocabulary.floor),
        **detector.to_arrays(),
    }
