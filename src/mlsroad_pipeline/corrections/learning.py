"""Learning from corrections: voxels of the corrected points, and a model that continues on them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines.boosted_trees.continuation import (
    Answer,
    ContinuationParameters,
    continue_training,
)
from mlsroad_pipeline.algorithms.baselines.boosted_trees.parameters import SLUG
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.fusion.pool import SLUG as POOL
from mlsroad_pipeline.algorithms.fusion.pool import TREES, members_of, with_trees
from mlsroad_pipeline.algorithms.inventory.candidate_labels import candidate_rules
from mlsroad_pipeline.algorithms.inventory.rules import ObjectRule
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.judge_continuation import continue_judge
from mlsroad_pipeline.corrections.answers import (
    NamedClasses,
    answers_of_file,
    object_classes,
    unmatched_strokes,
)
from mlsroad_pipeline.corrections.labelled_output import LabelledOutput
from mlsroad_pipeline.corrections.object_answers import (
    DecidedObject,
    RatedCandidates,
    TileObjects,
    decided_objects,
    joined_answers,
)
from mlsroad_pipeline.corrections.states import States
from mlsroad_pipeline.corrections.store import has_corrections, open_corrections
from mlsroad_pipeline.corrections.tiles import TileGrid
from mlsroad_pipeline.datasets.models.object_judges import judge_of, read_judge_replay, with_judge
from mlsroad_pipeline.datasets.models.replay import read_replay
from mlsroad_pipeline.formats.las.header import read_header
from mlsroad_pipeline.formats.registry import get_format

logger = logging.getLogger(__name__)

_SURVEY = 60_000  # voxels without an answer that are kept, of all files


class Voxels(NamedTuple):
    """Voxels of the corrected tiles of a file: those of each answer, by what it is about, and all others."""

    answers: dict[tuple[str, int], Answer]
    survey: NDArray[np.float32]


class Learned(NamedTuple):
    """Training data from the corrections of an output.

    Attributes
    ----------
    answers : list of Answer
        Voxels of each answer, with the classes that it allows.
    survey : ndarray of float32, shape (v, f)
        Voxels of the corrected tiles without an answer.
    objects : list of RatedCandidates
        Candidate objects that answers are about.
    """

    answers: list[Answer]
    survey: NDArray[np.float32]
    objects: list[RatedCandidates]


class _Decisions(NamedTuple):
    """Decisions about an output, in the terms of its model."""

    states: States
    of_objects: Mapping[int, NDArray[np.bool_]]
    decided: Mapping[int, DecidedObject]
    named: NamedClasses
    rules: Mapping[str, ObjectRule]


def check_learnable(output: LabelledOutput) -> None:
    """Raise ParameterError for an output whose method cannot continue from corrections."""
    if output.method not in (SLUG, POOL):
        raise ParameterError(
            f"{output.path} was labelled by {output.method}, which cannot learn from corrections: label it with the "
            f"model general, or add labelled files to survey.splits.train and run kedro run --pipelines={output.method}"
        )


def trees_of(bundle: ModelBundle) -> ModelBundle:
    """Return the boosted trees of a model that can learn: the model itself, or a member of a pool."""
    return members_of(bundle)[TREES] if bundle.slug == POOL else bundle


def corrected_parts(
    output: LabelledOutput, bundle: ModelBundle, *, progress: Callable[[str], None] | None = None
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
    survey, objects = [], []
    for name, path in clouds.items():
        if progress is not None:
            progress(name)
        cloud = get_format(path).read(path, output.read_options())
        found, rated = _of_file(name, cloud, decisions, bundle)
        for about, answer in found.answers.items():
            answers.setdefault(about, []).append(answer)
        survey.append(found.survey)
        objects += rated
    if not answers and not objects:
        raise DataError(
            f"{output.path} has no corrected points to learn from: accept or correct objects, or paint points"
        )
    joined = [Answer(np.concatenate([part.values for part in parts]), parts[0].classes) for parts in answers.values()]
    return Learned(joined, np.concatenate(survey), objects)


def _decisions_about(output: LabelledOutput, bundle: ModelBundle) -> _Decisions:
    scheme = bundle_scheme(bundle)
    named = NamedClasses(scheme, output.schemes)
    rules = candidate_rules(scheme, output.record["settings"]["label"].get("inventory") or {})
    with open_corrections(output.path) as store:
        states, table = store.states(), store.objects().table
    if states.unmatched:
        logger.warning("%d corrections match no object any more and are left out", len(states.unmatched))
    classes, kinds = (dict(zip(table["object_id"], table[name], strict=True)) for name in ("class", "kind"))
    decided = decided_objects(states.of_objects, kinds, named, rules)
    return _Decisions(states, object_classes(states, classes, named), decided, named, rules)


def _of_file(
    name: str, cloud: PointCloud, decisions: _Decisions, bundle: ModelBundle
) -> tuple[Voxels, list[RatedCandidates]]:
    """Return the voxels of a file, and the candidates of its tiles with the answers about them."""
    numbers = cloud.get("object_id")
    object_id = np.zeros(len(cloud), np.int64) if numbers is None else numbers.astype(np.int64)
    given = answers_of_file(name, object_id, decisions.states, decisions.of_objects, decisions.named)
    grid = TileGrid(cloud)
    objects = TileObjects(grid, object_id, decisions.decided, decisions.states.added)
    values: list[list[NDArray[np.float32]]] = [[] for _ in given.classes]
    trees = trees_of(bundle)
    survey, rated = [np.zeros((0, len(trees.metadata["feature_names"])), np.float32)], []
    cells = np.concatenate([grid.cell[given.answer >= 0], objects.cells])
    for tile in grid.described(cells, trees):
        features, owner = tile.voxels.values, tile.voxels.owner.astype(np.int64)
        answer = np.where(tile.core, given.answer[tile.rows], -1)
        of_voxel, inside = _majority(owner, answer, tile.core, len(features), len(given.classes))
        for k in np.unique(of_voxel[of_voxel >= 0]).tolist():
            values[k].append(features[of_voxel == k])
        survey.append(features[(of_voxel < 0) & inside])
        rated += objects.rated(tile, bundle, decisions.rules)
    others = np.concatenate(survey)
    drawn = np.random.default_rng(2026).permutation(len(others))[:_SURVEY]
    known = zip(given.about, values, given.classes, strict=True)
    answers = {about: Answer(np.concatenate(own), classes) for about, own, classes in known if own}
    return Voxels(answers, others[drawn]), rated


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


def learn_from(
    bundle: ModelBundle,
    outputs: Sequence[LabelledOutput],
    *,
    parent: Mapping[str, Any],
    parameters: ContinuationParameters | None = None,
    progress: Callable[[str], None] | None = None,
) -> tuple[ModelBundle, int]:
    """Return the model that has learned from the corrections of outputs, and the number of answers.

    Raises ParameterError for methods that cannot, and DataError without corrections.
    """
    for output in outputs:
        check_learnable(output)
    trees = trees_of(bundle)
    replay = read_replay(trees)
    parts = [corrected_parts(output, bundle, progress=progress) for output in outputs]
    answers = [answer for part in parts for answer in part.answers]
    survey = np.concatenate([part.survey for part in parts])
    from_outputs = {"parent": dict(parent), "surveys": [output.path.name for output in outputs]}
    entry: dict[str, Any] = {"answers": 0, **from_outputs}
    if answers:  # added objects alone have no points to learn labels from
        trees = continue_training(trees, answers, survey, replay, parameters=parameters, learned_from=from_outputs)
        entry = dict(trees.metadata["learned"][-1])
    model = trees
    if bundle.slug == POOL:
        model = with_trees(bundle, trees)
    rated = [found for part in parts for found in part.objects]
    model = with_judge(model, continue_judge(judge_of(bundle), joined_answers(rated), read_judge_replay()))
    own = {name: value for name, value in model.metadata.items() if name not in ("shipped", "registered", "stored")}
    entry["added_objects"] = sum(found.n_added for found in rated)
    learned = [*bundle.metadata.get("learned", ()), entry]
    trained = {**dict(own.get("trained_on", {})), "corrections": sum(_n_answers(one) for one in learned)}
    return ModelBundle(model.slug, model.arrays, {**own, "learned": learned, "trained_on": trained}), _n_answers(entry)


def _n_answers(entry: Mapping[str, Any]) -> int:
    """Return the number of answers of one learning; models of earlier versions name no added objects."""
    return int(entry["answers"]) + int(entry.get("added_objects", 0))
