"""Learning from corrections: voxels of the corrected points, and a model that continues on them."""

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.inventory.objects.candidate_table import candidate_rules
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import continue_classifier
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule
from mlsroad_pipeline.algorithms.models.boosted_trees.answer_boosting import Answer, Scored
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.formats.las.header import read_header
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.model_store.object_classifiers import classifier_of, read_candidate_replay, with_classifier
from mlsroad_pipeline.review.corrections.answers import (
    NamedClasses,
    answers_of_file,
    object_classes,
    unmatched_strokes,
)
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
from mlsroad_pipeline.review.corrections.learners import Learner, learner_of
from mlsroad_pipeline.review.corrections.object_answers import (
    DecidedObject,
    RatedCandidates,
    TileGrid,
    TileObjects,
    decided_objects,
    joined_answers,
)
from mlsroad_pipeline.review.corrections.states import States
from mlsroad_pipeline.review.corrections.store import has_corrections, open_corrections

logger = logging.getLogger(__name__)

_SURVEY = 60_000  # voxels without an answer that are kept, of all files


class Voxels(NamedTuple):
    """Voxels of the corrected tiles of a file: those of each answer, by what it is about, and all others."""

    answers: dict[tuple[str, int], Answer]
    survey: Sequence[Scored]


class Learned(NamedTuple):
    """Training data from the corrections of an output."""

    answers: list[Answer]  # Voxels of each answer, with the classes that it allows
    survey: list[Scored]  # Voxels of the corrected tiles without an answer, a part per file
    objects: list[RatedCandidates]  # Candidate objects that answers are about


class _Decisions(NamedTuple):
    """Decisions about an output, in the terms of its model."""

    states: States
    of_objects: Mapping[int, NDArray[np.bool_]]
    decided: Mapping[int, DecidedObject]
    named: NamedClasses
    rules: Mapping[str, ObjectRule]


def check_learnable(output: LabelledOutput) -> None:
    """Raise ParameterError for an output whose method labels points through images."""
    if needs_images(output.method):
        raise ParameterError(
            f"{output.path} was labelled by {output.method}, which labels through images and cannot learn from "
            "corrections: label it with another model, such as the default one"
        )


def corrected_parts(
    output: LabelledOutput, bundle: ModelBundle, learner: Learner, *, progress: Callable[[str], None] | None = None
) -> Learned:
    """Return the voxels and candidate objects that the corrections of an output are about, and a sample of the others.

    Raises DataError if there is no correction, or a class is unknown to the model.
    """
    if not has_corrections(output.path):
        raise DataError(f"{output.path} has no corrections: correct it first (mlsroad open {output.path})")
    decisions = _decisions_about(output, bundle)
    clouds, states = output.clouds(), decisions.states
    strange = unmatched_strokes(states.painted, {name: read_header(path).n_points for name, path in clouds.items()})
    if strange:
        logger.warning("%d strokes are about files with other points and are left out", len(strange))
    answers: dict[tuple[str, int], list[Answer]] = {}
    survey: list[Scored] = []
    objects: list[RatedCandidates] = []
    for name, path in clouds.items():
        if progress is not None:
            progress(name)
        cloud = get_format(path).read(path, output.read_options())
        found, rated = _of_file(name, cloud, decisions, bundle, learner)
        for about, answer in found.answers.items():
            answers.setdefault(about, []).append(answer)
        survey += found.survey
        objects += rated
    if not answers and not objects:
        raise DataError(
            f"{output.path} has no corrected points to learn from: accept or correct objects, or paint points"
        )
    return Learned([_joined_answer(parts) for parts in answers.values()], survey, objects)


def _joined_answer(parts: Sequence[Answer]) -> Answer:
    """Return one answer of its voxels in several files or tiles."""
    whole = joined([Scored(part.values, part.scores) for part in parts if part.scores is not None])
    return Answer(whole.values, parts[0].classes, whole.scores)


def joined(parts: Sequence[Scored]) -> Scored:
    """Return the voxels of several parts."""
    return Scored(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _decisions_about(output: LabelledOutput, bundle: ModelBundle) -> _Decisions:
    scheme = bundle_scheme(bundle)
    named = NamedClasses(scheme, output.schemes)
    rules = candidate_rules(scheme, output.record["settings"]["label"].get("inventory") or {})
    with open_corrections(output.path, write=False) as store:
        states, table = store.states(), store.objects().table
    if states.unmatched:
        logger.warning("%d corrections match no object any more and are left out", len(states.unmatched))
    classes, kinds = (dict(zip(table["object_id"], table[name], strict=True)) for name in ("class", "kind"))
    decided = decided_objects(states.of_objects, kinds, named, rules)
    return _Decisions(states, object_classes(states, classes, named), decided, named, rules)


def _of_file(
    name: str, cloud: PointCloud, decisions: _Decisions, bundle: ModelBundle, learner: Learner
) -> tuple[Voxels, list[RatedCandidates]]:
    """Return the voxels of a file, and the candidates of its tiles with the answers about them."""
    numbers = cloud.get("object_id")
    object_id = np.zeros(len(cloud), np.int64) if numbers is None else numbers.astype(np.int64)
    given = answers_of_file(name, object_id, decisions.states, decisions.of_objects, decisions.named)
    grid = TileGrid(cloud)
    objects = TileObjects(grid, object_id, decisions.decided, decisions.states.added)
    parts: list[list[Scored]] = [[] for _ in given.classes]
    survey: list[Scored] = []
    rated: list[RatedCandidates] = []
    cells = np.concatenate([grid.cell[given.answer >= 0], objects.cells])
    for tile in grid.described(cells, ground=learner.ground, voxel_size=learner.voxel_size):
        features, owner = tile.voxels.values, tile.voxels.owner.astype(np.int64)
        scores = learner.scores(tile)
        answer = np.where(tile.core, given.answer[tile.rows], -1)
        of_voxel, inside = _majority(owner, answer, tile.core, len(features), len(given.classes))
        for k in np.unique(of_voxel[of_voxel >= 0]).tolist():
            parts[k].append(Scored(features[of_voxel == k], scores[of_voxel == k]))
        others = (of_voxel < 0) & inside
        survey.append(Scored(features[others], scores[others]))
        rated += objects.rated(tile, bundle, decisions.rules)
    known = zip(given.about, parts, given.classes, strict=True)
    answers = {
        about: Answer(whole.values, classes, whole.scores)
        for about, whole, classes in ((about, joined(own), classes) for about, own, classes in known if own)
    }
    return Voxels(answers, _sample(survey)), rated


def _sample(parts: Sequence[Scored]) -> list[Scored]:
    """Return at most `_SURVEY` voxels of the tiles of a file; none for a file without a tile."""
    if not parts:
        return []
    whole = joined(parts)
    drawn = np.random.default_rng(2026).permutation(len(whole.values))[:_SURVEY]
    return [Scored(whole.values[drawn], whole.scores[drawn])]


def _majority(
    owner: NDArray[np.int64], answer: NDArray[np.int64], core: NDArray[np.bool_], n_voxels: int, n_answers: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the answer that most answered points of each voxel have, -1 without any; and whether it is inside."""
    best, most = np.full(n_voxels, -1, np.int64), np.zeros(n_voxels, np.int64)
    answered = (answer >= 0) & (owner >= 0)
    pairs, counts = np.unique(owner[answered] * max(n_answers, 1) + answer[answered], return_counts=True)
    order = np.argsort(counts, kind="stable")
    voxels, numbers = pairs[order] // max(n_answers, 1), pairs[order] % max(n_answers, 1)
    best[voxels], most[voxels] = numbers, counts[order]
    inside = np.zeros(n_voxels, np.bool_)
    inside[owner[core & (owner >= 0)]] = True
    return best, inside


def read_corrections(
    bundle: ModelBundle, outputs: Sequence[LabelledOutput], *, progress: Callable[[str], None] | None = None
) -> Learned:
    """Return what the corrections of outputs teach a model.

    Raises ParameterError for methods that cannot learn, and DataError without corrections.
    """
    for output in outputs:
        check_learnable(output)
    learner = learner_of(bundle)
    parts = [corrected_parts(output, bundle, learner, progress=progress) for output in outputs]
    return Learned(*([one for part in columns for one in part] for columns in zip(*parts, strict=True)))


def train_on(
    bundle: ModelBundle,
    data: Learned,
    *,
    parent: Mapping[str, Any],
    surveys: Sequence[str],
) -> tuple[ModelBundle, int]:
    """Return the model that has learned from what was read, and the number of answers."""
    from_outputs = {"parent": dict(parent), "surveys": list(surveys)}
    entry: dict[str, Any] = {"answers": 0, **from_outputs}
    model = bundle
    if data.answers:  # added objects alone have no points to learn labels from
        model = learner_of(bundle).learned(data.answers, joined(data.survey), learned_from=from_outputs)
        entry = dict(model.metadata["learned"][-1])
    model = with_classifier(
        model, continue_classifier(classifier_of(bundle), joined_answers(data.objects), read_candidate_replay())
    )
    own = {name: value for name, value in model.metadata.items() if name not in ("shipped", "registered", "stored")}
    entry["added_objects"] = sum(found.n_added for found in data.objects)
    learned = [*bundle.metadata.get("learned", ()), entry]
    trained = {**dict(own.get("trained_on", {})), "corrections": sum(_n_answers(one) for one in learned)}
    return ModelBundle(model.slug, model.arrays, {**own, "learned": learned, "trained_on": trained}), _n_answers(entry)


def _n_answers(entry: Mapping[str, Any]) -> int:
    """Return the number of answers of one learning; models of earlier versions name no added objects."""
    return int(entry["answers"]) + int(entry.get("added_objects", 0))
