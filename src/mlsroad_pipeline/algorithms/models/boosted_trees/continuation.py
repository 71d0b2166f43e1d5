"""Boosting that goes on from trained boosted trees, with the answers of a user on a survey that they labelled.

Trees are added; those of the model stay as they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.models.boosted_trees.answer_boosting import (
    Answer,
    ContinuationParameters,
    Replay,
    Scored,
    boost_on_answers,
)
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees


def continue_training(
    bundle: ModelBundle,
    answers: Sequence[Answer],
    survey: NDArray[np.float32],
    replay: Replay,
    *,
    parameters: ContinuationParameters | None = None,
    learned_from: Mapping[str, Any] | None = None,
    n_threads: int = 1,
) -> ModelBundle:
    """Return a model that has learned from answers."""
    own = parameters or ContinuationParameters()
    trees = BoostedTrees.from_arrays(bundle.arrays)
    temperature = float(bundle.arrays["temperature"])

    def scored(values: NDArray[np.floating]) -> Scored:
        rows = values.astype(np.float32, copy=False)
        if not len(rows):
            return Scored(rows, np.zeros((0, len(bundle.metadata["classes"]))))
        return Scored(rows, trees.scores(rows, n_threads=n_threads) / temperature + bundle.arrays["offsets"])

    known = [answer._replace(scores=scored(answer.values).scores) for answer in answers]
    added = boost_on_answers(
        known,
        scored(survey),
        replay,
        scored(replay.values),
        trees=trees,
        groups=bundle.arrays.get("groups"),
        parameters=own,
        n_threads=n_threads,
    )
    entry = learned_entry(answers, own, learned_from)
    metadata = {**bundle.metadata, "learned": [*bundle.metadata.get("learned", ()), entry]}
    kept = {name: array for name, array in bundle.arrays.items() if name not in trees.to_arrays()}
    scaled = [replace(part, leaf=(part.leaf * (temperature / own.bags)).astype(np.float32)) for part in added]
    return ModelBundle(bundle.slug, {**BoostedTrees.joined([trees, *scaled]).to_arrays(), **kept}, metadata)


def learned_entry(
    answers: Sequence[Answer], parameters: ContinuationParameters, learned_from: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Return the description of a learning for the metadata of a model."""
    used = sum(len(answer.values) > 0 for answer in answers)
    return {"answers": used, "parameters": asdict(parameters), **(learned_from or {})}
