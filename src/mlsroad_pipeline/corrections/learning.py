"""Learning from corrections: voxels of the corrected points, and a model that continues on them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines.boosted_trees.continuation import (
    Answer,
    ContinuationParameters,
    continue_training,
)
from mlsroad_pipeline.algorithms.baselines.boosted_trees.labeller import describe_scene, parameters_of
from mlsroad_pipeline.algorithms.baselines.boosted_trees.parameters import SLUG
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.stages import GroundParameters, ground_of, inliers
from mlsroad_pipeline.corrections.answers import (
    FileAnswers,
    NamedClasses,
    answers_of_file,
    object_classes,
    unmatched_strokes,
)
from mlsroad_pipeline.corrections.labelled_output import LabelledOutput
from mlsroad_pipeline.corrections.states import States
from mlsroad_pipeline.corrections.store import has_corrections, open_corrections
from mlsroad_pipeline.datasets.models.replay import read_replay
from mlsroad_pipeline.formats.las.header import read_header
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.registry import get_format

logger = logging.getLogger(__name__)

TILE, MARGIN = 30.0, 15.0
"""Edge of the tiles whose voxels are learned from, and width of the surroundings that are read with them, metres."""
_SURVEY = 60_000  # voxels without an answer that are kept, of all files
_NOISE = 7


class Voxels(NamedTuple):
    """Voxels of the corrected tiles: those of each answer with the classes that it allows, and all others."""

    answers: list[Answer]
    survey: NDArray[np.float32]


def check_learnable(output: LabelledOutput) -> None:
    """Raise ParameterError for an output whose method cannot continue from corrections."""
    if output.method != SLUG:
        raise ParameterError(
            f"{output.path} was labelled by {output.method}, which cannot learn from corrections: label it with the "
            f"model general, or add labelled files to survey.splits.train and run kedro run --pipelines={output.method}"
        )


def corrected_voxels(
    output: LabelledOutput, bundle: ModelBundle, *, progress: Callable[[str], None] | None = None
) -> Voxels:
    """Return the voxels of the corrected points of an output, and a sample of those around them.

    Raises DataError if there is no correction, or a class is unknown to the model.
    """
    if not has_corrections(output.path):
        raise DataError(f"{output.path} has no corrections: correct it first (mlsroad open {output.path})")
    named = NamedClasses(bundle_scheme(bundle), output.schemes)
    with open_corrections(output.path) as store:
        states, table = store.states(), store.objects().table
    if states.unmatched:
        logger.warning("%d corrections match no object any more and are left out", len(states.unmatched))
    clouds = output.clouds()
    strange = unmatched_strokes(states.painted, {name: read_header(path).n_points for name, path in clouds.items()})
    if strange:
        logger.warning("%d strokes are about files with other points and are left out", len(strange))
    of_objects = object_classes(states, dict(zip(table["object_id"], table["class"], strict=True)), named)
    answers: list[Answer] = []
    survey = []
    for name, path in clouds.items():
        if progress is not None:
            progress(name)
        found = _of_file(name, path, states, of_objects, named, bundle, output.read_options())
        answers += found.answers
        survey.append(found.survey)
    if not answers:
        raise DataError(
            f"{output.path} has no corrected points to learn from: accept or correct objects, or paint points"
        )
    return Voxels(answers, np.concatenate(survey))


def _of_file(
    name: str,
    path: Path,
    states: States,
    of_objects: Mapping[int, NDArray[np.bool_]],
    named: NamedClasses,
    bundle: ModelBundle,
    options: ReadOptions,
) -> Voxels:
    cloud = get_format(path).read(path, options)
    numbers = cloud.get("object_id")
    object_id = np.zeros(len(cloud), np.int64) if numbers is None else numbers.astype(np.int64)
    given = answers_of_file(name, object_id, states, of_objects, named)
    values: list[list[NDArray[np.float32]]] = [[] for _ in given.classes]
    survey = [np.zeros((0, len(bundle.metadata["feature_names"])), np.float32)]
    for tile, core in _tiles(cloud, given):
        features, owner = _tile_voxels(cloud.select(tile), bundle)
        answer = np.where(core, given.answer[tile], -1)
        of_voxel, inside = _majority(owner, answer, core, len(features), len(given.classes))
        for k in np.unique(of_voxel[of_voxel >= 0]).tolist():
            values[k].append(features[of_voxel == k])
        survey.append(features[(of_voxel < 0) & inside])
    others = np.concatenate(survey)
    drawn = np.random.default_rng(2026).permutation(len(others))[:_SURVEY]
    pairs = zip(values, given.classes, strict=True)
    return Voxels([Answer(np.concatenate(own), classes) for own, classes in pairs if own], others[drawn])


def _tiles(cloud: PointCloud, given: FileAnswers) -> Iterator[tuple[NDArray[np.int64], NDArray[np.bool_]]]:
    """Yield the points of each tile with an answer, with their surroundings, and which of them lie in the tile."""
    xy = cloud.xyz[:, :2]
    usable = np.ones(len(cloud), np.bool_) if "classification" not in cloud else cloud["classification"] != _NOISE
    cell = np.floor((xy - xy.min(axis=0)) / TILE).astype(np.int64) if len(xy) else np.zeros((0, 2), np.int64)
    for place in np.unique(cell[given.answer >= 0], axis=0):
        low = xy.min(axis=0) + place * TILE
        rows = np.flatnonzero(usable & (xy >= low - MARGIN).all(axis=1) & (xy < low + TILE + MARGIN).all(axis=1))
        yield rows, (cell[rows] == place).all(axis=1)


def _tile_voxels(tile: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return the features of the voxels of a tile, and the voxel of each point (-1 for outliers)."""
    plain = tile.without_columns(set(tile.columns) - {"intensity"})
    owner = np.full(len(plain), -1, np.int64)
    keep = inliers(plain)
    if not keep.any():
        return np.zeros((0, len(bundle.metadata["feature_names"])), np.float32), owner
    ground = ground_of(plain, GroundParameters(**bundle.metadata["parameters"]["ground"]))
    found = describe_scene(plain, ground, voxel_size=parameters_of(bundle).voxel_size)
    owner[keep] = found.owner
    return found.values, owner


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
    replay = read_replay(bundle)
    parts = [corrected_voxels(output, bundle, progress=progress) for output in outputs]
    answers = [answer for part in parts for answer in part.answers]
    survey = np.concatenate([part.survey for part in parts])
    from_outputs = {"parent": dict(parent), "surveys": [output.path.name for output in outputs]}
    model = continue_training(bundle, answers, survey, replay, parameters=parameters, learned_from=from_outputs)
    own = {name: value for name, value in model.metadata.items() if name not in ("shipped", "registered", "stored")}
    trained = {**dict(own.get("trained_on", {})), "corrections": sum(entry["answers"] for entry in own["learned"])}
    return ModelBundle(model.slug, model.arrays, {**own, "trained_on": trained}), len(answers)
