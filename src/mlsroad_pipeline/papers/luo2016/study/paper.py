"""Results printed in Luo et al. 2016."""

from __future__ import annotations

import pandas as pd

CLASSES = ("road", "grass", "palm tree", "cycas", "brushwood", "light pole", "vehicle")
"""The seven classes of Table I that means are taken over; `other` is excluded."""

OBJECTS = CLASSES[2:]
"""The five classes of objects, the only ones that shape-based recognition predicts."""

# Table III. The paper's equations 12 and 13 swap the names: its precision, TP / (TP + FN), is recall.
_RECALL = {
    "patch_svm": (0.95, 0.839, 0.677, 0.745, 0.61, 0.726, 0.489),
    "patch_forest": (0.965, 0.71, 0.708, 0.83, 0.624, 0.854, 0.678),
    "shape_based": (None, None, 0.907, 0.648, 0.136, 0.731, 0.56),
    "max_margin_markov": (0.971, 0.933, 0.891, 0.80, 0.538, 0.526, 0.65),
    "patch_graph": (0.975, 0.95, 0.856, 0.802, 0.481, 0.682, 0.478),
    "patch_graph_mrf": (0.971, 0.955, 0.96, 0.926, 0.564, 0.742, 0.762),
}
_PRECISION = {
    "patch_svm": (0.987, 0.846, 0.939, 0.595, 0.315, 0.289, 0.387),
    "patch_forest": (0.986, 0.862, 0.931, 0.598, 0.229, 0.362, 0.433),
    "shape_based": (None, None, 0.773, 0.532, 0.455, 0.958, 0.598),
    "max_margin_markov": (0.988, 0.876, 0.867, 0.718, 0.624, 0.862, 0.852),
    "patch_graph": (0.986, 0.881, 0.913, 0.678, 0.761, 0.697, 0.772),
    "patch_graph_mrf": (0.989, 0.883, 0.962, 0.793, 0.81, 0.881, 0.956),
}
_REFINED = (0.98, 0.918, 0.961, 0.855, 0.665, 0.805, 0.847)
_F1 = {
    "patch_svm": (0.968, 0.842, 0.787, 0.662, 0.416, 0.414, 0.432),
    "patch_forest": (0.976, 0.778, 0.804, 0.696, 0.335, 0.509, 0.528),
    "shape_based": (None, None, 0.835, 0.585, 0.209, 0.83, 0.578),
    "max_margin_markov": (0.98, 0.904, 0.879, 0.757, 0.578, 0.653, 0.737),
    "patch_graph": (0.98, 0.914, 0.884, 0.735, 0.59, 0.689, 0.59),
    "patch_graph_mrf": _REFINED,
}
FIGURE_7 = {
    0.2: {**dict(zip(CLASSES, _REFINED, strict=True)), "mean of seven": 0.862},
    0.35: {"vehicle": 0.69},
}
"""Patch size, metres, to F1 from Table III and from the text on Figure 7 (0.85 for vehicles at 0.2 m)."""

FIGURE_9 = {1.0: FIGURE_7[0.2]}
"""Local search radius, metres, to F1 from Table III."""

HOURS = {
    "patch_svm": (1.5, 4.4),
    "patch_forest": (0.5, 3.8),
    "shape_based": (0.8, 4.2),
    "max_margin_markov": (2.4, 5.8),
    "patch_graph_mrf": (5.5, 8.6),
}
"""Hours of training (20 scenes) and labelling (122 scenes) on one core at 3.3 GHz, section IV-C."""


_TABLE_1 = {
    "road": (90_561_689, None, None),
    "grass": (28_429_942, None, None),
    "palm tree": (8_131_790, 278, 240),
    "cycas": (4_611_530, 131, 65),
    "brushwood": (3_175_866, 220, 50),
    "light pole": (658_189, 90, 7),
    "vehicle": (479_799, 99, 0),
    "other": (205_850, None, None),
}


def table_one_of_paper() -> pd.DataFrame:
    """Return the points, objects and overlapping objects of Table I."""
    rows = [(name, *counts) for name, counts in _TABLE_1.items()]
    return pd.DataFrame(rows, columns=["class", "paper_points", "paper_objects", "paper_overlapping"])


def paper_scores() -> pd.DataFrame:
    """Return Table III with precision and recall by their usual definitions."""
    printed = {"precision": _PRECISION, "recall": _RECALL, "f1": _F1}
    rows = [
        (method, name, metric, float("nan") if value is None else value)
        for metric, table in printed.items()
        for method, values in table.items()
        for name, value in zip(CLASSES, values, strict=True)
    ]
    return pd.DataFrame(rows, columns=["method", "class", "metric", "paper"])
