"""Decision for a class where labels of the training separate groups of classes alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def decide(
    probabilities: NDArray[np.float64], groups: NDArray[np.integer] | None = None
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Return the most probable class of each row, and the probability that it is right.

    Parameters
    ----------
    probabilities : ndarray of float64, shape (n, classes)
        Probabilities.
    groups : ndarray of int, shape (classes,), optional
        Group of each class, such as that of all vegetation, for models that learned from labels which separate the
        groups alone. The most probable group is taken first, then its most probable class.

    Returns
    -------
    labels : ndarray of int16, shape (n,)
        Classes.
    confidence : ndarray of float32, shape (n,)
        Probability of the class; with groups, that of its group.

    Examples
    --------
    >>> import numpy as np
    >>> decide(np.array([[0.4, 0.3, 0.3]]), np.array([0, 1, 1]))
    (array([1], dtype=int16), array([0.6], dtype=float32))
    """
    if groups is None:
        return probabilities.argmax(axis=1).astype(np.int16), probabilities.max(axis=1).astype(np.float32)
    of_group = probabilities @ (groups[:, None] == np.arange(int(groups.max()) + 1)).astype(np.float64)
    best = of_group.argmax(axis=1)
    inside = np.where(groups[None, :] == best[:, None], probabilities, -1.0)
    return inside.argmax(axis=1).astype(np.int16), of_group.max(axis=1).astype(np.float32)
