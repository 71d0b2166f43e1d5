"""The shipped object classifier, that of a model that has learned, and samples of training data to replay."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable
from mlsroad_pipeline.algorithms.features.voxel_table import voxel_feature_names
from mlsroad_pipeline.algorithms.inventory.objects.measured_rows import FEATURES
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import STEM, LabelledCandidates, ObjectClassifier
from mlsroad_pipeline.algorithms.inventory.objects.plates import PLATE, PLATE_FEATURES
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.algorithms.inventory.objects.stem_features import STEM_FEATURES
from mlsroad_pipeline.algorithms.models.boosted_trees.answer_boosting import Replay
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


@contextmanager
def _package_arrays(path: Path) -> Iterator[Mapping[str, NDArray]]:
    """Open a file of the package; a damaged one, or one with other arrays, is a `ReadError`."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            yield arrays
    except (*DAMAGE, *MANGLED, *WRONG) as error:
        raise ReadError(f"{path} cannot be read ({printable(error)}): install the package again") from error


@cache
def shipped_classifier() -> ObjectClassifier:
    """Return the object classifier of the package."""
    with _package_arrays(FOLDER / CLASSIFIER) as arrays:
        return ObjectClassifier.from_arrays(dict(arrays))


def classifier_of(bundle: ModelBundle) -> ObjectClassifier:
    """Return the object classifier of a model that has learned from corrections, else that of the package."""
    if PREFIX not in bundle.prepared:
        own = arrays_under(bundle.arrays, PREFIX)
        classifier = ObjectClassifier.from_arrays(own) if own else shipped_classifier()
        for part, names in ((STEM, STEM_FEATURES), (PLATE, PLATE_FEATURES), *((kind, FEATURES) for kind in KINDS)):
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
    with _package_arrays(path) as arrays:
        return {
            kind: LabelledCandidates(arrays[f"{kind}/values"].astype(np.float32), arrays[f"{kind}/true"])
            for kind in KINDS
        }


VOXELS = Path(__file__).with_name("shipped_replay") / "general.npz"
"""Voxels of simulated streets, drawn in proportion to their training weights by the pipeline `general_model`."""


def replay_arrays(
    values: NDArray[np.floating], allowed: NDArray[np.bool_], classes: Sequence[str]
) -> dict[str, NDArray]:
    """Return the arrays of the file of a sample; features are rounded to 16 bits."""
    names = np.array(voxel_feature_names())
    return {"values": values.astype(np.float16), "allowed": allowed, "classes": np.array(classes), "features": names}


def read_replay(bundle: ModelBundle, path: Path = VOXELS) -> Replay:
    """Read the sample for a model."""
    with _package_arrays(path) as stored:
        arrays = {name: stored[name] for name in ("values", "allowed", "classes", "features")}
    if arrays["classes"].tolist() != list(bundle.metadata["classes"]):
        raise ParameterError(
            f"model {bundle.slug!r} has other classes than the shipped models: there are no training voxels for it"
        )
    if arrays["features"].tolist() != bundle.metadata["feature_names"]:
        raise ParameterError(f"model {bundle.slug!r} has other features than this version: train it again")
    return Replay(arrays["values"].astype(np.float32), arrays["allowed"])
