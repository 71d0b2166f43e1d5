"""Classes of Cityscapes, their mapping to the classes of points, and the scores of segmented images."""

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
"""Class to category (Cordts et al. 2016, Table 1) and class in ``tomic2019``, in the order of the train ids."""

SKY = "sky"
"""Class of images without points; its pixels have the code 0 (unlabelled) in simulated label images."""


def image_classes(scheme: ClassScheme) -> tuple[str, ...]:
    """Return the classes of images for a scheme."""
    return (*scheme.classes, SKY)


def encode_label_image(codes: NDArray[np.integer], scheme: ClassScheme, *, source: str = "labels") -> NDArray[np.int16]:
    """Convert taxonomy codes of pixels to labels of `image_classes`."""
    return np.where(codes == 0, np.int16(len(scheme)), scheme.encode(codes, source=source)).astype(np.int16)


def point_probabilities(
    probabilities: NDArray[np.floating], classes: Sequence[str], scheme: ClassScheme
) -> NDArray[np.float32]:
    """Convert probabilities of the classes of images to those of a scheme."""
    if probabilities.ndim != 2 or probabilities.shape[1] != len(classes):
        raise DataError(f"probabilities must have shape (n, {len(classes)}), got {probabilities.shape}")
    own = set(classes) <= set(image_classes(scheme))
    out = np.zeros((len(probabilities), len(scheme)), dtype=np.float32)
    for column, name in enumerate(classes):
        if not own and name not in CITYSCAPES:
            raise ParameterError(f"image class {name!r} is neither Cityscapes' nor of scheme {scheme.name!r}")
        target = (None if name == SKY else name) if own else CITYSCAPES[name][1]
        if target is not None:
            out[:, scheme.labels_of([target])[0]] += probabilities[:, column]
    total = out.sum(axis=1, keepdims=True)
    even = np.float32(1 / len(scheme))
    return np.divide(out, total, out=np.full_like(out, even), where=total > 1e-6)


def segmentation_table(
    matrix: NDArray[np.integer], classes: Sequence[str], categories: Sequence[str] | None = None
) -> pd.DataFrame:
    """Return IoU per class and per category, with their means, as in Table 1 of Tomic et al. 2019."""
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
