"""Comparison of methods over test streets: planted scores, SciPy, refused comparisons."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.metrics.scores import COLUMNS
from mlsroad_pipeline.papers.comparison import streets as comparison
from mlsroad_pipeline.papers.comparison.streets import compare_task, comparison_sections, costs_table

LABELLING = comparison.TASKS[0]
MEANS = {"a": [0.8, 0.7, 0.9], "b": [0.85, 0.8, 0.92], "c": [0.5, 0.9, 0.1]}


@pytest.fixture
def scores():
    rows = []
    for method, values in MEANS.items():
        for seed, value in enumerate(values):
            split = f"test_{seed}"
            rows += [(method, split, "all", metric, value, 100) for metric in LABELLING.metrics]
            rows += [(method, split, name, "f1", value / 2, 50 * (seed > 0)) for name in ("road", "pole")]
            rows.append((method, split, "wire", "f1", np.nan, 0))
        rows.append((method, "validation", "all", "mean_f1", 1.0, 100))
    rows.append(("a", "test_of_a_alone", "all", "mean_f1", 1.0, 100))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def test_means_and_spread_are_over_the_streets_that_all_methods_know(scores):
    assert comparison.common_test_streets(scores) == ["test_0", "test_1", "test_2"]
    found = comparison.overview(scores, LABELLING)
    assert found["method"].tolist() == ["b", "a", "c"]
    for row in found.itertuples():
        assert row.mean_f1 == pytest.approx(np.mean(MEANS[row.method]))
        assert row.kappa_spread == pytest.approx(np.std(MEANS[row.method], ddof=1))
        assert row.streets == 3
    means = comparison.mean_scores(scores)
    chosen = means[(means["method"] == "c") & (means["class"] == "all") & (means["metric"] == "mean_f1")]
    assert chosen[["split", "support"]].to_numpy().tolist() == [[comparison.MEAN, 300]]
    assert chosen["value"].item() == pytest.approx(0.5)


def test_classes_count_only_where_they_occur(scores):
    found = comparison.class_table(scores, LABELLING).set_index("method")
    assert list(found.columns) == ["road", "pole"]
    assert found.loc["a", "pole"] == pytest.approx(np.mean(MEANS["a"][1:]) / 2)  # it has no points on the first street


def test_differences_are_those_of_scipy_corrected_for_their_number(scores):
    found = comparison.paired_differences(scores, LABELLING).set_index("other")
    raw = {other: stats.ttest_rel(MEANS["b"], MEANS[other]) for other in ("a", "c")}
    interval = raw["a"].confidence_interval(0.95)
    assert found.loc["a", ["low", "high"]].tolist() == pytest.approx([interval.low, interval.high])
    ordered = sorted(raw, key=lambda other: raw[other].pvalue)
    first, second = (raw[other].pvalue for other in ordered)
    assert found.loc[ordered[0], "p"] == pytest.approx(min(2 * first, 1))
    assert found.loc[ordered[1], "p"] == pytest.approx(max(2 * first, second))
    assert found["ahead"].to_dict() == {"a": 3, "c": 2}


def test_one_street_tells_no_interval(scores):
    found = comparison.paired_differences(scores[scores["split"].isin(["test_1", "validation"])], LABELLING)
    assert found[["low", "high", "p"]].isna().all(axis=None)
    assert found["best"].tolist() == ["c", "c"]


def test_methods_without_a_common_street_are_not_compared(scores):
    other = scores[(scores["method"] == "b") & (scores["split"] == "test_1")].assign(split="test_b")
    with pytest.raises(DataError, match=r"no split whose name begins with 'test' .* b: test_b"):
        comparison.overview(pd.concat([scores[scores["method"] == "a"], other]), LABELLING)
    with pytest.raises(DataError, match="two values"):
        comparison.of_methods([scores, scores])


def test_costs_go_to_the_method_that_is_made():
    nodes = ["train_graph", "refine", "label_with_patch_graph_mrf", "cut_scenes"]
    makes = ["patch_graph.model", "patch_graph_mrf.model", "patch_graph_mrf.labels", "scenes"]
    costs = pd.DataFrame(
        {"node": nodes, "makes": makes, "seconds": [1.0, 2.0, 3.0, 9.0], "cpu_seconds": 1.0, "peak_gib": [1, 2, 3, 4.0]}
    )
    found = costs_table(costs, ["patch_graph", "patch_graph_mrf"]).set_index("method")
    assert found["seconds"].to_dict() == {"cut_scenes": 9.0, "patch_graph_mrf": 5.0, "patch_graph": 1.0}
    assert found.loc["patch_graph_mrf", "peak_gib"] == 3.0


def test_the_page_shows_every_part(scores):
    compared = compare_task(scores, LABELLING)
    axes = compared.figure.axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["b", "a", "c"]
    assert [line.get_label() for line in axes.lines] == ["test_0", "test_1", "test_2", "mean"]
    picture = np.zeros((4, 5, 3), np.uint8)
    sections = comparison_sections(
        {"survey": "x"}, [compared], pd.DataFrame({"method": ["a"]}), {"Maps": {"a": picture}}
    )
    titles = [section.title for section in sections]
    assert titles[0] == "Runs" and titles[-2:] == ["Times and memory", "Maps"]
    assert len(titles) == 7
    assert all(section.body for section in sections)
