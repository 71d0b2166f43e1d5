"""Results printed in Tomic et al. 2019."""

from __future__ import annotations

import pandas as pd

from mlsroad_pipeline.algorithms.cameras.cityscapes import CITYSCAPES, SKY

CLASSES = (
    "man-made terrain", "natural terrain", "vegetation", "building", "hard scape", "pole object", "bicycle", "vehicle",
    "man-made object", "human",
)  # fmt: skip

_NAN = float("nan")
_CITYSCAPES_IOU = (
    0.972, 0.781, 0.888, 0.531, 0.502, 0.342, 0.413, 0.607, 0.880, 0.611, 0.923, 0.611, 0.302, 0.919, 0.698, 0.747,
    0.651, 0.370, 0.622,
)  # fmt: skip
_CATEGORY_IOU = {
    "sky": 0.917, "human": 0.630, "vehicle": 0.885, "flat": 0.976, "object": 0.432, "construction": 0.882,
    "nature": 0.885, "mean": 0.801,
}  # fmt: skip
CITYSCAPES_MEAN = 0.651
"""Mean IoU over Cityscapes' 19 classes (Table 1)."""

_TABLE_2 = (
    (0.840, 0.259, 0.421, 0.618, 0.263, 0.011, 0.006, 0.620, 0.031, _NAN),
    (0.931, 0.080, 0.433, 0.857, 0.014, 0.321, 0.246, 0.858, 0.040, 0.164),
)

# Precision, recall, IoU and F1 of each class on test set 2, then overall accuracy and kappa.
_TABLE_3 = (
    (0.958, 0.762, 0.738, 0.849), (0.231, 0.094, 0.072, 0.134), (0.245, 0.800, 0.231, 0.375),
    (0.674, 0.772, 0.562, 0.720), (0.787, 0.135, 0.130, 0.230), (0.001, 0.046, 0.001, 0.002),
    (0.078, 0.002, 0.002, 0.005), (0.447, 0.488, 0.304, 0.466), (0.415, 0.010, 0.010, 0.019),
    (_NAN, _NAN, _NAN, _NAN), (0.721, 0.553),
)  # fmt: skip
_TABLE_4 = (
    (0.961, 0.858, 0.829, 0.906), (0.089, 0.000, 0.000, 0.001), (0.376, 0.096, 0.083, 0.153),
    (0.838, 0.488, 0.446, 0.617), (0.026, 0.000, 0.000, 0.001), (0.336, 0.160, 0.122, 0.217),
    (0.338, 0.155, 0.119, 0.213), (0.747, 0.671, 0.546, 0.707), (0.529, 0.062, 0.059, 0.111),
    (0.070, 0.068, 0.036, 0.069), (0.649, 0.484),
)  # fmt: skip
_TABLE_5 = (
    (0.955, 0.957, 0.916, 0.956), (0.154, 0.033, 0.028, 0.054), (0.348, 0.647, 0.292, 0.452),
    (0.878, 0.884, 0.788, 0.881), (0.366, 0.013, 0.013, 0.025), (0.011, 0.175, 0.011, 0.021),
    (0.329, 0.156, 0.119, 0.212), (0.637, 0.776, 0.539, 0.700), (0.511, 0.064, 0.060, 0.113),
    (0.070, 0.068, 0.036, 0.069), (0.868, 0.776),
)  # fmt: skip
VISIBLE_1 = {("features", "printed_forest"): 0.724, ("images", "hidden_points"): 0.885}
"""Overall accuracy of both methods on the visible points of test set 1 (section 4, third conclusion)."""

FEATURES, IMAGES, FUSION = "features", "images", "fusion"
_SCORED = {FEATURES: _TABLE_3, IMAGES: _TABLE_4, FUSION: _TABLE_5}


def table_one() -> pd.DataFrame:
    """Return Table 1 by classes of points and by categories."""
    rows: list[tuple[str, str, float, str]] = []
    iou = dict(zip(CITYSCAPES, _CITYSCAPES_IOU, strict=True))
    for name in (*CLASSES, SKY):
        own = [key for key, (_, becomes) in CITYSCAPES.items() if (becomes or SKY) == name]
        if own:
            listed = ", ".join(f"{key} {iou[key]:.3f}" for key in own)
            rows.append(("class", name, sum(iou[key] for key in own) / len(own), listed))
    rows.append(("class", "mean", CITYSCAPES_MEAN, "all 19"))
    rows += [("category", name, value, "") for name, value in _CATEGORY_IOU.items()]
    return pd.DataFrame(rows, columns=["kind", "name", "paper", "paper_classes"])


def table_two() -> pd.DataFrame:
    """Return Table 2."""
    return pd.DataFrame({"class": CLASSES, "paper_features": _TABLE_2[0], "paper_images": _TABLE_2[1]})


def table_of_scores(method: str) -> pd.DataFrame:
    """Return Table 3, 4 or 5."""
    *each, overall = _SCORED[method]
    metrics = ("precision", "recall", "iou", "f1")
    rows = [
        (name, metric, value)
        for name, values in zip(CLASSES, each, strict=True)
        for metric, value in zip(metrics, values, strict=True)
    ]
    rows += [("all", metric, value) for metric, value in zip(("overall_accuracy", "kappa"), overall, strict=True)]
    known = [values[-1] for values in each if values[-1] == values[-1]]
    return pd.DataFrame([*rows, ("all", "mean_f1", sum(known) / len(known))], columns=["class", "metric", "paper"])
