"""Sample of the training voxels of the shipped model, for training that goes on from it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.features.voxel_table import voxel_feature_names
from mlsroad_pipeline.algorithms.models.boosted_trees.answer_boosting import Replay
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.formats.npz import DAMAGE, MANGLED

FILE = Path(__file__).with_name("shipped_replay") / "general.npz"
"""Voxels of simulated streets, drawn in proportion to their training weights by the pipeline `general_model`."""


def replay_arrays(
    values: NDArray[np.floating], allowed: NDArray[np.bool_], classes: Sequence[str]
) -> dict[str, NDArray]:
    """Return the arrays of the file of a sample; features are rounded to 16 bits."""
    names = np.array(voxel_feature_names())
    return {"values": values.astype(np.float16), "allowed": allowed, "classes": np.array(classes), "features": names}


def read_replay(bundle: ModelBundle, path: Path = FILE) -> Replay:
    """Read the sample for a model."""
    try:
        with path.open("rb") as stream, np.load(stream) as stored:
            arrays = {name: stored[name] for name in ("values", "allowed", "classes", "features")}
    except (*DAMAGE, *MANGLED) as error:
        raise ReadError(f"{path} is missing or damaged: install mlsroad_pipeline again") from error
    if arrays["classes"].tolist() != list(bundle.metadata["classes"]):
        raise ParameterError(
            f"model {bundle.slug!r} has other classes than the shipped models: there are no training voxels for it"
        )
    if arrays["features"].tolist() != bundle.metadata["feature_names"]:
        raise ParameterError(f"model {bundle.slug!r} has other features than this version: train it again")
    return Replay(arrays["values"].astype(np.float32), arrays["allowed"])
