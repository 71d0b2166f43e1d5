"""Training of boosted trees. LightGBM is imported on training."""

import hashlib
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.features.voxel_table import intensity_columns, voxel_feature_names
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import SLUG, BoostedTreesParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.sampling import TrainingVoxels, join_voxels
from mlsroad_pipeline.algorithms.models.bundle import Checkpoints, ModelBundle
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees

_LEAST_SHARE = 1e-15
"""Share of a class without training voxels; LightGBM's value."""
_LEAST_HESSIAN = 1e-6

logger = logging.getLogger(__name__)

Objective = Callable[[NDArray[np.float64], Any], tuple[NDArray[np.float32], NDArray[np.float32]]]


def fit(
    scenes: Sequence[TrainingVoxels],
    *,
    parameters: BoostedTreesParameters,
    ground: GroundParameters,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
    weights: Sequence[float] | None = None,
    sources: Sequence[str] | None = None,
    groups: Sequence[int] | None = None,
    n_threads: int = 1,
    checkpoints: Checkpoints | None = None,
) -> ModelBundle:
    """Train boosted trees."""
    values, allowed, weight = join_voxels(
        scenes, scheme=scheme, prior=parameters.prior, weights=weights, sources=sources
    )
    columns = intensity_columns()
    with_intensity = not np.isnan(values[:, columns]).all()
    hidden = np.random.default_rng(parameters.seed).random(len(values)) < parameters.intensity_dropout
    values[np.ix_(hidden, columns)] = np.nan
    trees = train_trees(values, allowed, weight, parameters=parameters, n_threads=n_threads, checkpoints=checkpoints)
    metadata = {
        "classes": list(scheme.classes),
        "scheme": asdict(scheme),
        "parameters": {SLUG: asdict(parameters), "ground": asdict(ground)},
        "feature_names": voxel_feature_names(),
        "attributes": ["intensity"] if with_intensity else [],
        "trained_on": {**trained_on, "voxels": len(values)},
    }
    scale = {"temperature": np.array(1.0), "offsets": np.zeros(len(scheme))}
    if groups is not None:
        scale["groups"] = np.asarray(groups, np.int64)
    return ModelBundle(SLUG, {**trees.to_arrays(), **scale}, metadata)


def train_trees(
    values: NDArray[np.float32],
    allowed: NDArray[np.bool_],
    weight: NDArray[np.float64],
    *,
    parameters: BoostedTreesParameters,
    n_threads: int = 1,
    checkpoints: Checkpoints | None = None,
) -> BoostedTrees:
    """Boost trees on rows that allow one or several classes.

    The loss of a row is the negative logarithm of the summed probability of its classes. The rounds are trained in
    parts of `checkpoint_rounds`, each from the scores of the parts before; a resumed training gives the same bytes.
    """
    import lightgbm  # noqa: PLC0415  # labelling needs none

    settings = _settings(parameters, allowed.shape[1], n_threads)
    data = lightgbm.Dataset(values, np.zeros(len(values)), params=settings, free_raw_data=False)
    initial = _log_shares(allowed, weight)
    scores = np.tile(initial, (len(values), 1))
    settings["objective"] = partial_label_objective(allowed, weight)
    state = _saved_state(checkpoints, _fingerprint(values, allowed, weight, parameters))
    parts: list[BoostedTrees] = []
    for number, first in enumerate(range(0, parameters.rounds, parameters.checkpoint_rounds)):
        if number == len(state["parts"]):
            n_rounds = min(parameters.checkpoint_rounds, parameters.rounds - first)
            seeds = {name: parameters.seed + number for name in ("feature_fraction_seed", "extra_seed")}
            data.set_init_score(scores)
            booster = lightgbm.train({**settings, **seeds}, data, n_rounds)
            state["parts"].append(booster.model_to_string())
            if checkpoints is not None and first + n_rounds < parameters.rounds:
                checkpoints.save(SLUG, state)
        none = np.zeros_like(initial)
        parts.append(BoostedTrees.from_lightgbm(state["parts"][number], initial=initial if number == 0 else none))
        scores = (0 if number == 0 else scores) + parts[-1].scores(values, n_threads=n_threads)
    if checkpoints is not None:
        checkpoints.remove(SLUG)
    return BoostedTrees.joined(parts)


def _settings(parameters: BoostedTreesParameters, n_classes: int, n_threads: int) -> dict[str, Any]:
    return {
        "num_class": n_classes,
        "num_leaves": parameters.leaves,
        "learning_rate": parameters.learning_rate,
        "min_child_samples": parameters.min_child_samples,
        "feature_fraction": parameters.feature_fraction,
        "extra_trees": parameters.extra_trees,
        "lambda_l2": parameters.lambda_l2,
        "max_bin": parameters.max_bin,
        "data_random_seed": parameters.seed,
        "deterministic": True,
        "force_row_wise": True,
        "num_threads": n_threads,
        "verbosity": -1,
    }


def _log_shares(allowed: NDArray[np.bool_], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the logarithms of the shares of the classes; a row with several classes counts for each in part."""
    parts: NDArray[np.float64] = (weight / allowed.sum(axis=1)) @ allowed
    shares: NDArray[np.float64] = np.log(np.maximum(parts / weight.sum(), _LEAST_SHARE))
    return shares


def partial_label_objective(allowed: NDArray[np.bool_], weight: NDArray[np.float64]) -> Objective:
    """Return the objective of labels that allow one or several classes."""

    def objective(scores: NDArray[np.float64], data: Any) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        gradient, hessian = np.empty(allowed.shape, np.float32), np.empty(allowed.shape, np.float32)
        _differentiate(np.ascontiguousarray(scores), allowed, weight, gradient, hessian)
        return gradient, hessian

    return objective


@njit(cache=True, nogil=True)
def _differentiate(scores: NDArray, allowed: NDArray, weight: NDArray, gradient: NDArray, hessian: NDArray) -> None:
    n_classes = scores.shape[1]
    p, factor = np.empty(n_classes), n_classes / (n_classes - 1.0)
    for i in range(len(scores)):
        highest = scores[i].max()
        total = inside = 0.0
        for c in range(n_classes):
            p[c] = np.exp(scores[i, c] - highest)
            total += p[c]
            if allowed[i, c]:
                inside += p[c]
        inside = max(inside, 1e-300)
        for c in range(n_classes):
            target = p[c] / inside if allowed[i, c] else 0.0
            q = p[c] / total
            gradient[i, c] = (q - target) * weight[i]
            hessian[i, c] = max(q * (1.0 - q), _LEAST_HESSIAN) * factor * weight[i]


def _fingerprint(values: NDArray, allowed: NDArray, weight: NDArray, parameters: BoostedTreesParameters) -> str:
    digest = hashlib.sha256(repr(asdict(parameters)).encode())
    for array in (values, allowed, weight):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _saved_state(checkpoints: Checkpoints | None, fingerprint: str) -> dict[str, Any]:
    """Return the state of an interrupted training on the same rows, or a new one."""
    state = None if checkpoints is None else checkpoints.load(SLUG)
    if state is None or state["fingerprint"] != fingerprint:
        return {"fingerprint": fingerprint, "parts": []}
    logger.info("The training resumes after %d checkpoints.", len(state["parts"]))
    return state
