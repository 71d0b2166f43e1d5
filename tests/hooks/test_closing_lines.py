"""The last lines of a run: scores of few methods, and the paths of its reports."""

import logging

import numpy as np
from kedro.io import DataCatalog

from mlsroad_pipeline.algorithms.metrics.scores import labelling_scores
from mlsroad_pipeline.datasets.report_files import HtmlReportDataset, ScoresDataset
from mlsroad_pipeline.hooks.progress import MOST_METHODS, ClosingLinesHooks


def lines_of_a_run(tmp_path, caplog, names):
    catalog = DataCatalog({name: ScoresDataset(filepath=str(tmp_path / f"{name}.csv")) for name in names})
    catalog["report"] = HtmlReportDataset(filepath=str(tmp_path / "report.html"))
    hooks = ClosingLinesHooks()
    caplog.set_level(logging.INFO, "mlsroad_pipeline")
    hooks.before_pipeline_run(catalog)
    for name in names:
        matrix = np.array([[8, 2], [0, 5]])
        table = labelling_scores(matrix, method=name, split="test", classes=["ground", "pole"])
        hooks.after_dataset_saved(name, table)
    hooks.after_dataset_saved("report", "<!doctype html>")
    caplog.clear()
    hooks.after_pipeline_run()
    return [record.getMessage() for record in caplog.records]


def test_scores_and_report_are_the_last_lines(tmp_path, caplog):
    """F1 of ground: 2 * 8 / (10 + 8); of pole: 2 * 5 / (5 + 7)."""
    scores, report = lines_of_a_run(tmp_path, caplog, ["forest"])
    assert scores.startswith("forest, test: overall accuracy 0.867, mean F1 0.861, ")
    assert scores.endswith("F1: ground 0.89, pole 0.83")
    assert report == f"Report: {tmp_path / 'report.html'}"


def test_many_methods_have_the_report_alone(tmp_path, caplog):
    found = lines_of_a_run(tmp_path, caplog, [f"m{k}" for k in range(MOST_METHODS + 1)])
    assert len(found) == 1 and found[0].startswith("Report: ")
