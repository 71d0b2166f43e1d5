"""Calibration of trained boosted trees on scenes that they were not trained on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mlsroad_pipeline.algorithms.baselines.boosted_trees.sampling import TrainingVoxels, join_voxels
from mlsroad_pipeline.algorithms.models.boosted_trees import BoostedTrees
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.temperature import fit_temperature


def calibrate(bundle: ModelBundle, scenes: Sequence[TrainingVoxels], *, n_threads: int = 1) -> ModelBundle:
    """Return a model with the temperature that fits scenes which it was not trained on.

    Parameters
    ----------
    bundle : ModelBundle
        A model of `training.fit`.
    scenes : sequence of TrainingVoxels
        Voxels of held-out scenes, drawn as those of the training; they count with their shares in the scenes.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    ModelBundle
        The model with another `temperature`, and `offsets` of 0.

    Raises
    ------
    DataError
        If the scenes have no labelled voxel.
    """
    values, allowed, weight = join_voxels(scenes, scheme=bundle_scheme(bundle), prior={})
    scores = BoostedTrees.from_arrays(bundle.arrays).scores(values, n_threads=n_threads)
    temperature = fit_temperature(scores, allowed, weights=weight)
    fitted = {"temperature": np.array(temperature), "offsets": np.zeros(scores.shape[1])}
    return replace(bundle, arrays={**bundle.arrays, **fitted})
