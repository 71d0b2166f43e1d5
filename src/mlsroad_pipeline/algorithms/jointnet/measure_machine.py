"""Support vector machine on the measures of objects, a vote beside the networks."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray
from sklearn.model_selection import StratifiedKFold

from mlsroad_pipeline.algorithms.jointnet.inputs import Points, augment, encode
from mlsroad_pipeline.algorithms.jointnet.parameters import JointNetParameters
from mlsroad_pipeline.algorithms.models.kernel_machine import Choice, KernelMachine
from mlsroad_pipeline.algorithms.models.kernel_machine_training import fit_machine, standardise

COST, GAMMA = 10.0, 0.01
"""C, and gamma of the Gaussian kernel for measures of standard deviation 1."""

N_FOLDS = 4
"""Folds whose held-out objects calibrate the probabilities."""

MOST_SAMPLES = 8000
"""Largest number of objects and copies; a machine of more takes minutes."""


def train_machine(points: Points, target: NDArray[np.int64], parameters: JointNetParameters) -> KernelMachine | None:
    """Train the machine.

    Parameters
    ----------
    points : Points
        The training objects.
    target : ndarray of int64, shape (objects,)
        Their classes, from 0.
    parameters : JointNetParameters
        Inputs, augmentation, share and number of copies.

    Returns
    -------
    KernelMachine or None
        The machine; None without measures or share, or if every class has a single object.
    """
    p, n = parameters.training, len(target)
    n_folds = min(N_FOLDS, int(np.bincount(target).max()))
    if not parameters.inputs.measures or not p.machine_share or n_folds < 2:
        return None
    rng = np.random.default_rng(p.seed)
    copies = min(p.machine_copies, max(MOST_SAMPLES // n - 1, 0))
    sets = [points, *(augment(points, p.augmentation, rng) for _ in range(copies))]
    features = np.concatenate([encode(one, parameters.inputs)[1] for one in sets]).astype(np.float32)
    labels = np.tile(target, len(sets))
    shift, scale = standardise(features)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of classes with fewer objects than folds
        divided = list(StratifiedKFold(n_folds, shuffle=True, random_state=p.seed).split(features[:n], target))
    folds = [(np.concatenate([rows + k * n for k in range(len(sets))]), held) for rows, held in divided]
    scaled, choice = (features - shift) / scale, Choice(COST, GAMMA, float("nan"))
    return fit_machine(features, labels, choice, held_out=scaled, held_out_labels=labels, folds=folds)
