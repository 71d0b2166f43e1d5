"""Shared parts of the studies: intervals against SciPy, means by hand, named scales, positions of bars."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.papers.shared.studies.parameters import chosen_scale
from mlsroad_pipeline.papers.shared.studies.streets import timed
from mlsroad_pipeline.papers.shared.studies.study import (
    Shown,
    Study,
    draw_bars,
    draw_curves,
    draw_lines,
    draw_panels,
    mean_and_spread,
    name_axes,
    paired_interval,
)


def test_interval_is_that_of_the_paired_t_test_over_what_is_defined():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 9))
    expected = stats.ttest_rel(first, second).confidence_interval(0.9)
    apart = np.append(first - second, [np.nan, np.inf])
    mean, low, high, n = paired_interval(apart, 0.9)
    assert (low, high) == pytest.approx(tuple(expected)) and n == 9
    assert mean == pytest.approx((low + high) / 2)


def test_fewer_than_two_differences_have_no_interval():
    assert paired_interval(np.array([0.25, np.nan]))[::3] == (0.25, 1)
    assert np.isnan(paired_interval(np.array([0.25]))[1:3]).all()
    mean, _, _, n = paired_interval(np.zeros(0))
    assert np.isnan(mean) and n == 0


def test_mean_and_spread_by_hand():
    rows = pd.DataFrame({"kind": ["b", "b", "a"], "size": [1.0, 3.0, 5.0]})
    found = mean_and_spread(rows, ["kind"], ["size"])
    assert found["kind"].tolist() == ["b", "a"] and found["size"].tolist() == [2.0, 5.0]
    assert found["size_spread"][0] == pytest.approx(np.sqrt(2)) and np.isnan(found["size_spread"][1])


@dataclass(frozen=True)
class Two:
    first: int
    second: int


def test_a_scale_has_the_values_of_its_name():
    assert chosen_scale(Two, "study", "b", {"a": {}, "b": {"second": 2, "first": 1}}) == Two(1, 2)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("c", r"study.scale 'c' is unknown \(scales: a\)"),
        ("a", r"scales.a must have \['first', 'second'\], got \['x'\]"),
    ],
)
def test_wrong_scales_are_named(name, message):
    with pytest.raises(ParameterError, match=message):
        chosen_scale(Two, "study", name, {"a": {"x": 1}})


def test_bars_stand_side_by_side_and_diamonds_on_them():
    _, (axes,) = draw_panels(1)
    nothing = {"a": [np.nan, 0.1], "b": [0.1, 0.1]}
    draw_bars(axes, ["x", "y"], {"a": [0.2, 0.4], "b": [np.nan, 0.6]}, spread=nothing, paper={"a": [1, 1], "b": [1, 0]})
    bars = [[(bar.get_x() + bar.get_width() / 2, bar.get_height()) for bar in group] for group in axes.containers[::2]]
    np.testing.assert_allclose(bars, [[(-0.2, 0.2), (0.8, 0.4)], [(0.2, 0.0), (1.2, 0.6)]])
    assert [text.get_text() for text in axes.get_xticklabels()] == ["x", "y"]
    marks = [line for line in axes.get_lines() if line.get_marker() == "D"]
    np.testing.assert_allclose(marks[1].get_xydata(), [(0.2, 1), (1.2, 0)])


def test_lines_and_curves_hold_their_values():
    _, (left, right) = draw_panels(2, sharey=True)
    draw_lines(left, [1, 2], {"a": [3, 4], "mean": [5, 6]}, bold=("mean",))
    draw_curves(right, {"c": ([0, 1], [1, 0])})
    name_axes(left, x="size", y="F1", unit_range="y")
    thin, thick = left.get_lines()
    assert thin.get_ydata().tolist() == [3, 4] and thick.get_linewidth() > thin.get_linewidth()
    assert right.get_legend().get_texts()[0].get_text() == "c" and right.get_ylim() == left.get_ylim() == (0, 1.02)
    assert left.get_xlabel() == "size"


def test_time_is_that_of_the_processor():
    total, seconds = timed(sum, range(300_000))
    assert total == 44_999_850_000 and 0 < seconds < 5


def test_a_page_has_facts_figures_and_the_tables_that_have_rows():
    study = Study(
        "p", "Paper", parameters=(), plan=dict, stages=[], results=[], tables=("one", "two"), tabulate=dict,
        captions={"bars": "Bars of two"}, draw=tuple, facts=lambda plan: {"scale": plan},
        page=lambda plan, tables: [Shown(f"Table {name}", table, "By hand") for name, table in tables.items()],
    )  # fmt: skip
    tables = {"one": pd.DataFrame({"value": [0.25]}), "two": pd.DataFrame({"value": []})}
    page = study.report("fast", tables, [draw_panels(1)[0]])
    assert "fast" in page and "Bars of two" in page and "Table one" in page and "0.25" in page
    assert "Table two" not in page
