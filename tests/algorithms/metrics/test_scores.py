"""The contract of the scores table."""

import numpy as np
import pandas as pd
import pytest
from mlflow.utils.validation import _validate_metric_name

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.metrics import scores as module
from mlsroad_pipeline.algorithms.metrics.scores import check_scores, labelling_scores, scores_to_metrics, summary

MATRIX = np.array([[8, 2, 0], [1, 9, 0], [0, 0, 0]])
CLASSES = ("road", "car & van", "wire")


@pytest.fixture
def table():
    return labelling_scores(MATRIX, method="detrended_forest", split="test", classes=CLASSES)


def test_table_has_the_columns_metrics_and_values_of_the_contract(table):
    assert list(table.columns) == ["method", "split", "class", "metric", "value", "support"]
    assert set(table["metric"]) == {
        "precision", "recall", "f1", "iou", "overall_accuracy", "kappa", "mean_f1", "mean_iou",
    }  # fmt: skip
    row = table[(table["class"] == "road") & (table["metric"] == "recall")].iloc[0]
    assert (row["value"], row["support"]) == (0.8, 10)
    row = table[(table["class"] == "all") & (table["metric"] == "overall_accuracy")].iloc[0]
    assert (row["value"], row["support"]) == (0.85, 20)
    assert table.loc[table["class"] == "wire", "value"].isna().all()


def test_csv_round_trip_writes_undefined_values_as_empty_cells(table):
    text = table.to_csv(index=False)
    assert "detrended_forest,test,wire,f1,,0\n" in text
    from io import StringIO

    pd.testing.assert_frame_equal(check_scores(pd.read_csv(StringIO(text))), table)


def test_metrics_of_a_method_are_named_by_split_metric_class_and_leave_undefined_ones_out(table):
    other = labelling_scores(MATRIX.T[:, :3] * 2, method="baseline", split="test", classes=CLASSES)
    by_method = scores_to_metrics(pd.concat([table, other]))
    assert list(by_method) == ["detrended_forest", "baseline"]
    metrics = by_method["detrended_forest"]
    assert metrics["test/recall/road"] == 0.8
    assert metrics["test/mean_f1"] == pytest.approx(table["value"].iloc[-2])
    assert metrics["test/f1/car _ van"] > 0
    assert not any("wire" in name for name in metrics)
    for name in metrics:
        _validate_metric_name(name)


def test_a_slash_in_a_class_name_does_not_add_a_level():
    table = labelling_scores(np.eye(1, dtype=int), method="m", split="s", classes=["pole/sign"])
    assert "s/f1/pole_sign" in scores_to_metrics(table)["m"]


def test_two_classes_of_one_metric_name_are_refused():
    table = labelling_scores(np.eye(2, dtype=int), method="m", split="s", classes=["a&b", "a%b"])
    with pytest.raises(DataError, match="two scores of m are called 's/precision/a_b'"):
        scores_to_metrics(table)


def test_summary_has_one_row_per_method_and_split(table):
    other = labelling_scores(MATRIX.T[:, :3] * 2, method="a_rival", split="test", classes=CLASSES)
    wide = summary(pd.concat([table, other]))
    assert list(wide.index) == [("detrended_forest", "test"), ("a_rival", "test")]
    assert list(wide.columns) == ["overall_accuracy", "kappa", "mean_f1", "mean_iou"]
    assert wide.loc[("detrended_forest", "test"), "overall_accuracy"] == 0.85


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.drop(columns="support"), "columns must be method,split,class,metric,value,support"),
        (lambda t: t.assign(method=None), "row 0 has no method"),
        (lambda t: t.assign(metric="accuracy"), "unknown metric 'accuracy'"),
        (lambda t: t.assign(value=np.inf), "value inf"),
        (lambda t: t.assign(value="high"), "must be numbers"),
        (lambda t: t.assign(support=-1), "support -1"),
        (lambda t: pd.concat([t, t.head(1)]), "two values for .*'road', 'precision'"),
    ],
)
def test_what_breaks_the_contract_is_named(table, change, message):
    with pytest.raises(DataError, match=f"demo.csv: .*{message}"):
        check_scores(change(table), source="demo.csv")


def test_names_must_fit_the_matrix_and_none_may_be_all():
    with pytest.raises(DataError, match="2 class names for a confusion matrix of 3"):
        labelling_scores(MATRIX, method="m", split="s", classes=CLASSES[:2])
    with pytest.raises(DataError, match="no class may be called 'all'"):
        labelling_scores(MATRIX, method="m", split="s", classes=("all", "b", "c"))


def test_every_documented_metric_is_known():
    assert set(module.DETECTION_METRICS) == {"precision", "recall", "quality", "f_score", "tp", "fp", "fn"}


def test_classes_that_a_method_cannot_give_are_undefined_and_in_no_mean():
    matrix = np.array([[0, 0, 0, 10], [0, 6, 2, 0], [0, 0, 4, 0]])
    table = labelling_scores(matrix, method="m", split="s", classes=("ground", "pole", "car"), given=("pole", "car"))
    value = table.set_index(["class", "metric"])["value"]
    assert value["ground"].isna().all() and table.loc[table["class"] == "ground", "support"].eq(10).all()
    f1 = (12 / 14, 8 / 10)
    assert value["pole", "f1"] == pytest.approx(f1[0]) and value["all", "mean_f1"] == pytest.approx(np.mean(f1))
    assert value["all", "mean_iou"] == pytest.approx(np.mean([6 / 8, 4 / 6]))
    assert value["all", "overall_accuracy"] == pytest.approx(10 / 22)  # its points still count
    with pytest.raises(DataError, match="wire cannot be given"):
        labelling_scores(matrix, method="m", split="s", classes=("ground", "pole", "car"), given=("wire",))
