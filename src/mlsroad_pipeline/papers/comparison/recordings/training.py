"""Training of a method on prepared scenes; the model is stored as arrays."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.execution.task import StoredResult
from mlsroad_pipeline.papers.comparison.recordings.preparation import Prepared, Setup, preparation_of


def train_model(
    prepared: Sequence[StoredResult],
    *,
    method: str,
    uses: Mapping[str, tuple[str, str, float]],
    parameters: Mapping[str, Any],
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
) -> dict[str, dict[str, NDArray]]:
    """Train a method; the result has the arrays, the metadata as JSON, and the time of training without preparation."""
    scenes = [Prepared(handle.load(), *uses[handle.key]) for handle in prepared]
    start, used = time.perf_counter(), time.process_time()
    bundle = preparation_of(method).fit(scenes, Setup(method, parameters, scheme, trained_on))
    seconds = {"seconds": time.perf_counter() - start, "cpu_seconds": time.process_time() - used}
    return {**model_arrays(bundle), "times": {name: np.array(value) for name, value in seconds.items()}}


def model_arrays(bundle: ModelBundle) -> dict[str, dict[str, NDArray]]:
    """Return a model as arrays; `stored_model` is the inverse."""
    metadata = {"slug": np.array(bundle.slug), "json": np.array(json.dumps(dict(bundle.metadata)))}
    return {"arrays": dict(bundle.arrays), "metadata": metadata}


def stored_model(model: Mapping[str, Mapping[str, NDArray]]) -> ModelBundle:
    """Return the model of arrays of `model_arrays`."""
    metadata = json.loads(str(model["metadata"]["json"]))
    return ModelBundle(str(model["metadata"]["slug"]), model["arrays"], metadata)
