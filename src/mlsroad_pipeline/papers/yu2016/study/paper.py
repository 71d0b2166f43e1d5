"""Results printed in Yu et al. 2016."""

from __future__ import annotations

import pandas as pd

SURVEYS = ("RRS", "SPP")
"""Surveys of Tables II to V: Ring Road South and Software Park Phase II."""

CLASSES = ("light pole", "traffic sign", "car")
"""Classes that are detected."""

_OBJECTS = {"RRS": (647, 241, 159), "SPP": (167, 25, 780)}
_FOUND = {"RRS": (628, 235, 143), "SPP": (158, 22, 731)}
_FALSE = {"RRS": 31, "SPP": 29}

_FIGURES = ("recall", "precision", "quality", "f_score")
_TABLE_3 = {
    "RRS": (0.961, 0.970, 0.933, 0.965),
    "SPP": (0.937, 0.969, 0.910, 0.953),
    "average": (0.949, 0.970, 0.922, 0.959),
}
_STEPS = ("ground removal", "segmentation", "quantisation", "detection")
_TABLE_4 = {"RRS": (31, 133, 2318, 29), "SPP": (12, 36, 1585, 17)}
_POINTS = {"RRS": 1728e6, "SPP": 626e6}
THREADS = 16
"""Threads of the paper's computer."""

# True and false positives of cars; the number of objects is in Table II.
_TABLE_5 = {
    "RRS": {
        "hough_forest": (138, 10), "object_matching": (141, 8), "bottom_up_top_down": (139, 7), "visual_words": (143, 8)
    },
    "SPP": {
        "hough_forest": (711, 25), "object_matching": (723, 20), "bottom_up_top_down": (718, 23),
        "visual_words": (731, 21),
    },
}  # fmt: skip


def table_two() -> pd.DataFrame:
    """Return Table II."""
    rows: list[tuple[str, str, int, int, int | None]] = []
    for survey in SURVEYS:
        rows += [
            (survey, name, objects, found, None)
            for name, objects, found in zip(CLASSES, _OBJECTS[survey], _FOUND[survey], strict=True)
        ]
        rows.append((survey, "all", sum(_OBJECTS[survey]), sum(_FOUND[survey]), _FALSE[survey]))
    return pd.DataFrame(rows, columns=["survey", "class", "paper_objects", "paper_found", "paper_false"])


def table_three() -> pd.DataFrame:
    """Return Table III."""
    rows = [(s, m, v) for s, values in _TABLE_3.items() for m, v in zip(_FIGURES, values, strict=True)]
    return pd.DataFrame(rows, columns=["survey", "metric", "paper"])


def table_four() -> pd.DataFrame:
    """Return Table IV as points per second and thread."""
    rows = []
    for survey, seconds in _TABLE_4.items():
        each = zip((*_STEPS, "all"), (*seconds, sum(seconds)), strict=True)
        rows += [(survey, step, _POINTS[survey] / value / THREADS) for step, value in each]
    return pd.DataFrame(rows, columns=["survey", "step", "paper"])


def table_five() -> pd.DataFrame:
    """Return Table V."""
    rows = []
    for survey, methods in _TABLE_5.items():
        objects = _OBJECTS[survey][CLASSES.index("car")]
        for method, (tp, fp) in methods.items():
            rows.append((survey, method, tp / objects, tp / (tp + fp), 2 * tp / (tp + fp + objects)))
    return pd.DataFrame(rows, columns=["survey", "method", "paper_recall", "paper_precision", "paper_f_score"])
