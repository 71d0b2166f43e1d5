"""Weight of predictions in a pool with a model, fitted on the points of a survey that have a class."""

import logging
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.given_labels.labeller import FLOOR, pool_with_given
from mlsroad_pipeline.algorithms.scenes.binning import BinnedCloud
from mlsroad_pipeline.algorithms.scenes.joining import join_pieces
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.label.given_classes import ANY_GROUND
from mlsroad_pipeline.label.scene import LabelSettings, labels_of_model
from mlsroad_pipeline.surveys.class_map_files import read_class_map
from mlsroad_pipeline.surveys.given_classes import KEPT, GivenParameters

logger = logging.getLogger(__name__)

WEIGHTS = tuple(round(0.05 * k, 2) for k in range(1, 20))
"""Weights that are compared."""
MOST_SCENES = 6
"""Number of scenes, those with the most labelled points, that the weight is fitted on."""
FEWEST = 100
"""Fewest labelled points."""


def fitted_weight(
    tasks: Mapping[str, SceneTask], bundle: ModelBundle, given: GivenParameters, codings: Mapping[str, Any]
) -> float:
    """Return the weight with the least log loss, in which all classes count equally.

    `tasks` label the scenes. Points count whose class in their file (class map `given.classes`) is one of the model.
    """
    scheme = bundle_scheme(bundle)
    legend = read_class_map(given.classes, scheme, option="label.given.classes", codings=codings)
    label = legend.labels(scheme)
    label[[name == ANY_GROUND for name in legend.classes]] = -1
    class_of = dict(zip(legend.numbers, label.tolist(), strict=True))
    counts = {
        key: sum(int((_classes(_numbers(piece), class_of) >= 0).sum()) for piece in _pieces(task))
        for key, task in tasks.items()
    }
    chosen = [key for key in sorted(counts, key=lambda key: (-counts[key], key))[:MOST_SCENES] if counts[key]]
    losses, n_points = np.zeros((len(WEIGHTS), len(scheme))), np.zeros(len(scheme), dtype=np.int64)
    for key in chosen:
        parameters = tasks[key].parameters
        settings: LabelSettings = parameters["settings"]
        scene = join_pieces(_pieces(tasks[key]), parameters["span"], settings.outliers, parameters["source"])
        for row, true in enumerate(_losses(scene, bundle, settings, class_of, scheme)):
            losses[row] += true
        own = _classes(scene[KEPT], class_of)[scene["core"]]
        n_points += np.bincount(own[own >= 0], minlength=len(scheme))
    if n_points.sum() < FEWEST:
        raise DataError(
            f"label.given.weight=fit: {n_points.sum()} points of the survey have a class of {given.classes} (at least "
            f"{FEWEST} are needed): give a number, or a survey that is partly classified (label.given.classes)"
        )
    known = n_points > 0
    weight = WEIGHTS[int((losses[:, known] / n_points[known]).mean(axis=1).argmin())]
    logger.warning("Weight of the predictions: %g, fitted on %s points with a class", weight, f"{n_points.sum():,}")
    return weight


def _pieces(task: SceneTask) -> list[Mapping[str, NDArray]]:
    return [piece.load() for piece in task.inputs["pieces"]]


def _numbers(piece: Mapping[str, NDArray]) -> NDArray[np.integer]:
    return BinnedCloud.from_arrays(piece).cloud[KEPT]


def _classes(numbers: NDArray[np.integer], class_of: Mapping[int, int]) -> NDArray[np.int64]:
    values, place = np.unique(numbers, return_inverse=True)
    return np.array([class_of.get(int(value), -1) for value in values], dtype=np.int64)[place]


def _losses(
    scene: PointCloud, bundle: ModelBundle, settings: LabelSettings, class_of: Mapping[int, int], scheme: ClassScheme
) -> Iterator[NDArray[np.float64]]:
    """Yield, for each weight, the summed log loss of the labelled points of the core by class."""
    true = np.where(scene["core"], _classes(scene[KEPT], class_of), -1)
    scene, _, soft, _ = labels_of_model(scene, bundle, settings)
    rows = np.flatnonzero(true >= 0)
    for weight in WEIGHTS:
        pooled = pool_with_given(soft, scene, weight)
        assert pooled.probabilities is not None and pooled.owner is not None  # a pool has them
        own = pooled.owner[rows]
        right = np.where(own < 0, 0.0, pooled.probabilities[own, true[rows]])
        loss = np.bincount(true[rows], -np.log(np.maximum(right, FLOOR)), minlength=len(scheme))
        yield loss.astype(np.float64)
