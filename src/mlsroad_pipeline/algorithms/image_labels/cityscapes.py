"""Cityscapes' classes and categories, what they are in the ten classes of a street, and the scores of images."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.metrics.confusion import scores

CITYSCAPES: dict[str, tuple[str, str | None]] = {
    "road": ("flat", "man-made terrain"),
    "sidewalk": ("flat", "man-made terrain"),
    "building": ("construction", "building"),
    "wall": ("construction", "hard scape"),
    "fence": ("construction", "man-made object"),
    "pole": ("object", "pole object"),
    "traffic light": ("object", "pole object"),
    "traffic sign": ("object", "pole object"),
    "vegetation": ("nature", "vegetation"),
    "terrain": ("nature", "natural terrain"),
    "sky": ("sky", None),
    "person": ("human", "human"),
    "rider": ("human", "human"),
    "car": ("vehicle", "vehicle"),
    "truck": ("vehicle", "vehicle"),
    "bus": ("vehicle", "vehicle"),
    "train": ("vehicle", "vehicle"),
    "motorcycle": ("vehicle", "bicycle"),
    "bicycle": ("vehicle", "bicycle"),
}
"""Class to its category (Cordts et al. 2016, Table 1) and its class in ``tomic2019``, in the order of the train ids."""

SKY = "sky"
"""Class of images that no point has; its pixels are 0, unlabelled, in simulated label images."""


def image_classes(scheme: ClassScheme) -> tuple[str, ...]:
    """Return the classes of images that are segmented into a scheme's classes.

    Parameters
    ----------
    scheme : ClassScheme
        The classes of points.

    Returns
    -------
    tuple of str
        The scheme's classes, and the sky.
    """
    return (*scheme.classes, SKY)


def encode_label_image(codes: NDArray[np.integer], scheme: ClassScheme, *, source: str = "labels") -> NDArray[np.int16]:
    """Turn taxonomy codes of pixels into labels of `image_classes`.

    Parameters
    ----------
    codes : ndarray of int, shape (height, width)
        Taxonomy codes; 0 is the sky.
    scheme : ClassScheme
        The classes of points.
    source : str, default "labels"
        What messages call the image.

    Returns
    -------
    ndarray of int16, shape (height, width)
        Labels; the sky is the last, -1 what the scheme ignores.

    Raises
    ------
    UnknownClassError
        If the scheme does not name a code.
    """
    return np.where(codes == 0, np.int16(len(scheme)), scheme.encode(codes, source=source)).astype(np.int16)


def point_probabilities(
    probabilities: NDArray[np.floating], classes: Sequence[str], scheme: ClassScheme
) -> NDArray[np.float32]:
    """Turn probabilities of an image's classes into those of a scheme's.

    Parameters
    ----------
    probabilities : ndarray of float, shape (n, len(classes))
        Probabilities of Cityscapes' classes or of `image_classes`.
    classes : sequence of str
        Their names: the scheme's own and the sky, or Cityscapes' 19.
    scheme : ClassScheme
        The classes of points; `tomic2019` for Cityscapes' names.

    Returns
    -------
    ndarray of float32, shape (n, len(scheme))
        Sums over the classes that become one; the share of the sky is left out and the rest scaled to 1. Rows that are
        all sky are even.

    Raises
    ------
    DataError
        If the number of classes is not that of the probabilities.
    ParameterError
        If a class is neither the scheme's nor Cityscapes'.
    """
    if probabilities.ndim != 2 or probabilities.shape[1] != len(classes):
        raise DataError(f"probabilities must have shape (n, {len(classes)}), got {probabilities.shape}")
    own = set(classes) <= set(image_classes(scheme))
    out = np.zeros((len(probabilities), len(scheme)), dtype=np.float32)
    for column, name in enumerate(classes):
        if not own and name not in CITYSCAPES:
            raise ParameterError(f"image class {name!r} is neither Cityscapes' nor of scheme {scheme.name!r}")
        becomes = (None if name == SKY else name) if own else CITYSCAPES[name][1]
        if becomes is not None:
            out[:, scheme.labels_of([becomes])[0]] += probabilities[:, column]
    total = out.sum(axis=1, keepdims=True)
    even = np.float32(1 / len(scheme))
    return np.divide(out, total, out=np.full_like(out, even), where=total > 1e-6)


def segmentation_table(
    matrix: NDArray[np.integer], classes: Sequence[str], categories: Sequence[str] | None = None
) -> pd.DataFrame:
    """Return IoU per class and per category, with their means, as in Table 1 of Tomic et al. 2019.

    Parameters
    ----------
    matrix : ndarray of int, shape (classes, classes + 1)
        What `confusion_matrix` gives for pixels, summed over images.
    classes : sequence of str
        Names of the classes.
    categories : sequence of str, optional
        Category of each class; none for a table of classes alone.

    Returns
    -------
    pandas.DataFrame
        Columns ``kind`` (class or category), ``name``, ``iou`` and ``pixels``; the mean, over those that have pixels,
        is called ``mean``. A class without pixels has no IoU.

    Raises
    ------
    DataError
        If the matrix does not fit the classes.
    """
    if matrix.shape != (len(classes), len(classes) + 1):
        raise DataError(f"the matrix must have shape {(len(classes), len(classes) + 1)}, got {matrix.shape}")
    rows = _iou_rows("class", matrix, classes)
    if categories is not None:
        names = list(dict.fromkeys(categories))
        groups = np.array([names.index(category) for category in categories])
        merged = np.zeros((len(names), len(names) + 1), dtype=np.int64)
        columns = np.append(groups, len(names))
        np.add.at(merged, (groups[:, None], columns[None, :]), matrix)
        rows += _iou_rows("category", merged, names)
    return pd.DataFrame(rows, columns=["kind", "name", "iou", "pixels"])


def _iou_rows(kind: str, matrix: NDArray[np.integer], names: Sequence[str]) -> list[tuple[str, str, float, int]]:
    support = matrix.sum(axis=1)
    iou = np.where(support > 0, scores(matrix).iou, np.nan)
    rows = [(kind, name, float(value), int(n)) for name, value, n in zip(names, iou, support, strict=True)]
    mean = float(np.nanmean(iou)) if (support > 0).any() else float("nan")
    return [*rows, (kind, "mean", mean, int(support.sum()))]
