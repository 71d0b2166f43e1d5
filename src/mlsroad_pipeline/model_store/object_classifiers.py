"""The shipped object classifier, that of a model that has learned, and the candidates to replay."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import STEM, LabelledCandidates, ObjectClassifier
from mlsroad_pipeline.algorithms.inventory.objects.object_features import FEATURES
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.algorithms.inventory.objects.stem_features import STEM_FEATURES
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under
from mlsroad_pipeline.formats.files import WRONG
from mlsroad_pipeline.formats.npz import DAMAGE, MANGLED

FOLDER = Path(__file__).parent / "shipped_object_classifier"
"""Folder of the object classifier in the package."""

CLASSIFIER, CARD, REPLAY = "object_classifier.npz", "card.md", "replay.npz"

PREFIX = "object_judge/"
"""First characters of the names of the arrays of an object classifier in a model that has learned from corrections."""


@cache
def classifier_digest() -> str:
    """Return the SHA256 of the file of the object classifier, which identifies results that depend on it."""
    path = FOLDER / CLASSIFIER
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ReadError(f"{path} cannot be read ({error}): install the package again") from error


@cache
def shipped_classifier() -> ObjectClassifier:
    """Return the object classifier of the package."""
    path = FOLDER / CLASSIFIER
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            return ObjectClassifier.from_arrays(dict(arrays))
    except (*DAMAGE, *MANGLED, *WRONG) as error:
        raise ReadError(f"{path} cannot be read ({printable(error)}): install the package again") from error


def classifier_of(bundle: ModelBundle) -> ObjectClassifier:
    """Return the object classifier of a model that has learned from corrections, else that of the package."""
    if PREFIX not in bundle.prepared:
        own = arrays_under(bundle.arrays, PREFIX)
        classifier = ObjectClassifier.from_arrays(own) if own else shipped_classifier()
        for part, names in ((STEM, STEM_FEATURES), *((kind, FEATURES) for kind in KINDS)):
            classifier.check_features(part, names)
        bundle.prepared[PREFIX] = classifier
    found: ObjectClassifier = bundle.prepared[PREFIX]
    return found


def with_classifier(bundle: ModelBundle, classifier: ObjectClassifier) -> ModelBundle:
    """Return a model with an object classifier of its own."""
    own = {f"{PREFIX}{name}": values for name, values in classifier.to_arrays().items()}
    return ModelBundle(bundle.slug, {**bundle.arrays, **own}, bundle.metadata)


def candidate_replay_arrays(candidates: Mapping[str, LabelledCandidates]) -> dict[str, NDArray]:
    """Return the arrays of the file of candidates to replay; features are rounded to 16 bits."""
    arrays: dict[str, NDArray] = {
        f"{kind}/values": found.values.astype(np.float16) for kind, found in candidates.items()
    }
    return arrays | {f"{kind}/true": found.true for kind, found in candidates.items()}


def read_candidate_replay(path: Path = FOLDER / REPLAY) -> dict[str, LabelledCandidates]:
    """Read a sample of the candidates that the object classifier was trained on."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            return {
                kind: LabelledCandidates(arrays[f"{kind}/values"].astype(np.float32), arrays[f"{kind}/true"])
                for kind in KINDS
            }
    except (*DAMAGE, *MANGLED, *WRONG) as error:
        raise ReadError(f"{path} cannot be read ({printable(error)}): install the package again") from error
