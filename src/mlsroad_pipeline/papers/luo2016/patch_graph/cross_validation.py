"""Labels of held-out training scenes, for the choice of the refinement parameters."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import PatchGraphClassifier, PatchGraphParameters
from mlsroad_pipeline.papers.luo2016.patch_graph.refinement import ValidationScene
from mlsroad_pipeline.papers.luo2016.patch_graph.training_scenes import cut_scenes
from mlsroad_pipeline.papers.luo2016.patch_graph.transfer import class_probabilities, match_patches
from mlsroad_pipeline.papers.shared.patches.table import Patches

logger = logging.getLogger(__name__)


def label_held_out(
    transfer: PatchGraphClassifier,
    patches: Patches,
    edges: NDArray[np.int32],
    *,
    parameters: PatchGraphParameters,
    max_patches: int,
    surveys: NDArray[np.int32] | None = None,
    n_folds: int = 3,
    n_threads: int = 1,
) -> list[ValidationScene]:
    """Label training scenes by matches in other training scenes.

    With two or more surveys, whole surveys are held out: the surveys of a fold are labelled by a graph of the other
    folds.
    """
    whole = cut_scenes(patches, parameters.scene_length)
    pieces = np.unique(whole.scene)
    n_taken = min(len(pieces), max(1, round(len(pieces) * max_patches / len(whole))))
    drawn = pieces[np.unique(np.linspace(0, len(pieces) - 1, n_taken).round()).astype(np.int64)]
    fold = None if surveys is None else _folds(patches, whole.scene, surveys, n_folds, parameters.n_matches)
    labelled: dict[int, ValidationScene] = {}
    if fold is None:
        for place in drawn.tolist():
            scene, inside = _piece(whole, edges, place)
            apart = np.full(len(scene), np.searchsorted(pieces, place))
            matched = match_patches(
                scene, transfer.graph, weights=transfer.weights, search=transfer.search, own_scene=apart,
                n_threads=n_threads,
            )  # fmt: skip
            votes = class_probabilities(transfer.graph.labels[matched.matches], transfer.n_classes)
            labelled[place] = ValidationScene(votes, scene.rgb, inside, scene.label, scene.positions)
        return list(labelled.values())
    for number, rows in _held_out(fold):
        others = PatchGraphClassifier.fit(
            patches.take(~rows), _edges_of(edges, ~rows), transfer.n_classes, parameters=parameters, n_threads=n_threads
        )
        logger.info("fold %d: %d of %d patches held out", number, rows.sum(), len(patches))
        for place in np.intersect1d(whole.scene[rows], drawn).tolist():
            scene, inside = _piece(whole, edges, place)
            votes = others.predict_proba(scene, inside)
            labelled[place] = ValidationScene(votes, scene.rgb, inside, scene.label, scene.positions)
    return [labelled[place] for place in sorted(labelled)]


def _folds(
    patches: Patches, pieces: NDArray[np.int32], surveys: NDArray[np.int32], n_folds: int, n_matches: int
) -> NDArray[np.int64] | None:
    """Return the fold of each patch; None if whole surveys cannot be held out."""
    survey = np.unique(surveys[patches.scene], return_inverse=True)[1].astype(np.int64)
    n_surveys = int(survey.max()) + 1
    if n_folds == 0 or n_surveys == 1:
        return None
    fold = survey % n_folds
    for number in np.unique(fold):
        left = len(np.unique(pieces[fold != number]))
        if left < n_matches + 1:
            logger.warning(
                "patch_graph_mrf: without the surveys of a fold %d training scenes are left, and %d matches need %d: "
                "scenes are held out in place of surveys", left, n_matches, n_matches + 1,
            )  # fmt: skip
            return None
    return fold


def _held_out(fold: NDArray[np.int64]) -> Iterator[tuple[int, NDArray[np.bool_]]]:
    for number in np.unique(fold).tolist():
        yield number, fold == number


def _edges_of(edges: NDArray[np.int32], rows: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the edges between the given patches, as indices into these."""
    place = np.where(rows, np.cumsum(rows) - 1, -1).astype(np.int32)[edges]
    return place[(place >= 0).all(axis=1)]


def _piece(patches: Patches, edges: NDArray[np.int32], scene: int) -> tuple[Patches, NDArray[np.int32]]:
    rows = patches.scene == scene
    return patches.take(rows), _edges_of(edges, rows)
