"""Results printed in Luo et al. 2019."""

from __future__ import annotations

import pandas as pd

OBJECTS: dict[str, dict[str, int]] = {
    "hdr9": {
        "bus station": 1143, "light pole": 4175, "road sign": 1281, "station sign": 2062, "traffic light": 1728,
        "traffic sign": 4687, "trashcan": 1456, "palm": 4200, "cycas": 1920,
    },
    "smd6": {
        "car": 1265, "light pole": 2500, "pedestrian": 740, "road sign": 855, "traffic sign": 2930, "tree": 1203,
    },
}  # fmt: skip
"""Objects of each class of HDRObject9 and SMDObject6 (section 4.1), by the names of the class schemes."""

SPLITS = {"train": 0.7, "validation": 0.1, "test": 0.2}
"""Shares of the splits."""

# Model size and GPU memory in MB, one backward and one forward pass in ms, recognition of both test sets in s.
_TABLE_1 = {
    "sub-networks": (159, 14264, 38.06, 11.53, 17.16, 4.54),
    "jointnet": (223, 15647, 109.13, 33.91, 29.21, 7.69),
}
_TABLE_2 = {
    "hierarchy_descriptor": ((80.0, 80.8, 80.4), (66.5, 68.2, 65.6), (54.7, 59.8, 53.6)),
    "spin_image": ((84.5, 84.3, 84.4), (71.1, 71.4, 69.9), (55.5, 65.3, 58.2)),
    "shot": ((88.3, 86.4, 87.3), (77.2, 77.4, 77.1), (55.2, 54.6, 51.6)),
    "pointnet": ((92.6, 92.4, 92.5), (89.5, 83.2, 83.4), (67.1, 58.1, 58.7)),
    "jointnet": ((95.9, 95.7, 95.8), (94.7, 91.0, 92.3), (70.3, 76.9, 70.7)),
}
_TABLE_3 = {
    "GFH + SVM (De Deuge et al. 2013)": 0.67, "GFH + SVM (Chen et al. 2014)": 0.71, "VoxNet": 0.72, "BV-CNNs": 0.755,
    "ORION": 0.778, "LightNet": 0.798, "jointnet": 0.749,
}  # fmt: skip
# Dimension, then the columns of Table 1.
_TABLE_4: dict[str, tuple[float | None, ...]] = {
    "hierarchy_descriptor": (100, None, None, None, None, 173, 57),
    "spin_image": (153, None, None, None, None, 259, 79),
    "shot": (352, None, None, None, None, 1730, 391),
    "pointnet": (None, 42, 2842, 120.62, 88.05, 22.81, 7.26),
    "jointnet": (None, 223, 15647, 109.13, 33.91, 29.21, 7.69),
}
_TIMES = ("model_mb", "memory_mb", "backward_ms", "forward_ms", "hdr9_s", "smd6_s")


def table_one() -> pd.DataFrame:
    """Return Table 1."""
    rows = [(method, *values) for method, values in _TABLE_1.items()]
    return pd.DataFrame(rows, columns=["method", *(f"paper_{name}" for name in _TIMES)])


def table_two() -> pd.DataFrame:
    """Return Table 2."""
    rows = [
        (name, method, *(figure / 100 for figure in figures))
        for method, each in _TABLE_2.items()
        for name, figures in zip((*OBJECTS, "sydney"), each, strict=True)
    ]
    return pd.DataFrame(rows, columns=["set", "method", "paper_precision", "paper_recall", "paper_f1"])


def table_three() -> pd.DataFrame:
    """Return Table 3: the F1 score on the Sydney Urban Objects, mean over four folds."""
    return pd.DataFrame(list(_TABLE_3.items()), columns=["method", "paper"])


def table_four() -> pd.DataFrame:
    """Return Table 4; a descriptor has four bytes per dimension, as printed."""
    rows = [(method, *values) for method, values in _TABLE_4.items()]
    table = pd.DataFrame(rows, columns=["method", "paper_dimension", *(f"paper_{name}" for name in _TIMES)])
    table.insert(2, "paper_footprint_bytes", 4 * table["paper_dimension"])
    return table
