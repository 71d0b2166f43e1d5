"""Sections of the report of a comparison."""

import numpy as np
import pandas as pd
import pytest

from mlsroad_pipeline.reporting.comparison_page import STAGE_TITLES, comparison_sections, per_class


def scores_of(method, split, values):
    """Return a table of scores: class to (precision, recall, support)."""
    rows = [
        (method, split, name, metric, value, support)
        for name, (precision, recall, support) in values.items()
        for metric, value in (("precision", precision), ("recall", recall))
    ]
    rows.append((method, split, "all", "mean_f1", 0.5, 100))
    return pd.DataFrame(rows, columns=["method", "split", "class", "metric", "value", "support"])


TABLE = scores_of("one", "test", {"car": (0.5, 0.25, 40), "pole": (np.nan, 0.0, 60), "sign": (np.nan, np.nan, 0)})


def test_scores_per_class_have_one_row_for_each_class_that_occurs():
    wide = per_class(TABLE)
    assert list(wide.columns) == ["split", "class", "support", "precision", "recall"]
    assert wide["class"].tolist() == ["car", "pole"] and wide["support"].tolist() == [40, 60]
    assert wide["recall"].tolist() == [0.25, 0.0] and np.isnan(wide["precision"][1])


def test_scores_of_several_methods_in_one_table_stay_apart():
    wide = per_class(pd.concat([TABLE, scores_of("other", "test", {"car": (1.0, 0.75, 40)})]))
    assert wide[["method", "class"]].to_numpy().tolist() == [["one", "car"], ["one", "pole"], ["other", "car"]]
    assert wide["recall"].tolist() == pytest.approx([0.25, 0.0, 0.75])


def test_page_has_the_tables_of_the_tasks_then_the_methods_then_the_stages():
    tables = {name: pd.DataFrame({"x": [1]}) for name in ("comparison", "image_comparison", *STAGE_TITLES)}
    picture = np.zeros((2, 2, 3), np.uint8)
    sections = comparison_sections(
        {"survey": "s"},
        tables,
        {"one": TABLE},
        {"one": {"confusion": picture}},
        tasks=["comparison", "image_comparison"],
    )
    titles = [section.title for section in sections]
    assert titles[:3] == ["Run", "Labelling methods", "Image-based labelling and fusion"]
    assert titles[3:5] == ["one", "one: scores per class"] and set(titles[5:]) == set(STAGE_TITLES.values())
    assert "Confusion matrix" in sections[3].body
