"""From labelled scenes to one confusion matrix per split, at full resolution and over core points only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.algorithms.metrics.scores import labelling_scores


def find_scheme(schemes: Mapping[str, Any], name: str) -> ClassScheme:
    """Build a class scheme of the configuration.

    Parameters
    ----------
    schemes : mapping of str to mapping
        The configured schemes.
    name : str
        The one that is wanted.

    Returns
    -------
    ClassScheme
        The scheme.

    Raises
    ------
    ParameterError
        If there is no such scheme, or it is malformed.
    """
    if name not in schemes:
        raise ParameterError(f"class scheme {name!r} is not configured (schemes: {', '.join(schemes)})")
    return ClassScheme.from_config(name, schemes[name])


def coarse_labels(label: NDArray[np.integer], trained: ClassScheme, scored: ClassScheme) -> NDArray[np.int16]:
    """Turn labels of the scheme that a method was trained on into those of the scheme that it is scored on.

    Parameters
    ----------
    label : ndarray of int, shape (n,)
        Labels of `trained`, -1 for none.
    trained, scored : ClassScheme
        The schemes; the first nests in the second.

    Returns
    -------
    ndarray of int16, shape (n,)
        Labels of `scored`, -1 for none.

    Raises
    ------
    ParameterError
        If the schemes do not nest.
    """
    if trained == scored:
        return label.astype(np.int16)
    table = np.append(trained.coarsen(scored), np.int16(IGNORE))  # -1 finds the last entry
    return table[label]


def count_scene(
    scene: PointCloud, labels: Mapping[str, NDArray], *, trained: ClassScheme, scored: ClassScheme
) -> dict[str, NDArray]:
    """Count the core points of a scene by true and predicted class.

    Parameters
    ----------
    scene : PointCloud
        The scene, with `label` and `core`.
    labels : mapping
        ``label`` int16 (n,), of the scheme that the method was trained on.
    trained, scored : ClassScheme
        The schemes.

    Returns
    -------
    dict of str to ndarray
        ``matrix`` int64 (C, C + 1).

    Raises
    ------
    MissingColumnError
        If the scene has no labels.
    UnknownClassError
        If a label is not in the scheme.
    """
    core = scene["core"]
    truth = scored.encode(scene["label"][core], source=scene.source)
    predicted = coarse_labels(labels["label"][core], trained, scored)
    return {"matrix": confusion_matrix(truth, predicted, len(scored))}


def sum_by_split(matrices: Mapping[str, Mapping[str, NDArray]]) -> dict[str, NDArray[np.int64]]:
    """Add the matrices of each split.

    Parameters
    ----------
    matrices : mapping of str to mapping
        Scene name, which begins with its split and a dot, to what `count_scene` gave.

    Returns
    -------
    dict of str to ndarray
        Split to matrix.
    """
    total: dict[str, NDArray[np.int64]] = {}
    for key, counted in matrices.items():
        split = SceneKey.parse(key).split
        total[split] = total.get(split, 0) + counted["matrix"]
    return total


def given_classes(metadata: Mapping[str, Any], trained: ClassScheme, scored: ClassScheme) -> list[str]:
    """Name the classes that a model can give, in the scheme that it is scored on.

    Parameters
    ----------
    metadata : mapping
        Metadata of the model; ``classes_given`` names classes of `trained`, without it all can be given.
    trained, scored : ClassScheme
        The schemes; the first nests in the second.

    Returns
    -------
    list of str
        Classes of `scored` in label order.

    Raises
    ------
    ParameterError
        If the schemes do not nest.
    """
    if "classes_given" not in metadata:
        return list(scored.classes)
    own = np.array([trained.classes.index(name) for name in metadata["classes_given"]], np.int16)
    return [scored.classes[label] for label in np.unique(coarse_labels(own, trained, scored)) if label != IGNORE]


def scores_table(
    matrices: Mapping[str, NDArray[np.int64]], *, method: str, scheme: ClassScheme, given: Sequence[str] | None = None
) -> pd.DataFrame:
    """Score a method on all splits.

    Parameters
    ----------
    matrices : mapping of str to ndarray
        Split to confusion matrix.
    method : str
        The method's slug.
    scheme : ClassScheme
        The scheme of the matrices.
    given : sequence of str, optional
        The classes that the method can give; None is all.

    Returns
    -------
    DataFrame
        The table of scores.
    """
    tables = [
        labelling_scores(matrix, method=method, split=split, classes=scheme.classes, given=given)
        for split, matrix in matrices.items()
    ]
    return pd.concat(tables, ignore_index=True)
