"""Scores, figures and reports as files."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from kedro.io import DatasetError

from mlsroad_pipeline.algorithms.metrics.scores import labelling_scores
from mlsroad_pipeline.datasets.report_files import FigureDataset, HtmlReportDataset, MetricSeriesDataset, ScoresDataset
from mlsroad_pipeline.reporting.figures import oob_figure


@pytest.fixture
def table():
    matrix = np.array([[8, 2, 0], [1, 9, 0], [0, 0, 0]])
    return labelling_scores(matrix, method="m", split="test", classes=("road", "nan", "None"))


@pytest.mark.parametrize("where", ["file", "memory"])
def test_scores_come_back_as_they_were(table, tmp_path, where):
    path = str(tmp_path / "scores" / "m.csv") if where == "file" else "memory://scores/m.csv"
    dataset = ScoresDataset(filepath=path)
    dataset.save(table)
    pd.testing.assert_frame_equal(dataset.load(), table)
    assert dataset.exists()


def test_scores_on_disk_keep_the_contract(table, tmp_path):
    ScoresDataset(filepath=str(tmp_path / "m.csv")).save(table)
    lines = (tmp_path / "m.csv").read_text().splitlines()
    assert lines[0] == "method,split,class,metric,value,support"
    assert lines[1] == "m,test,road,precision,0.8888888888888888,10"
    assert "m,test,None,f1,,0" in lines
    assert [path.name for path in tmp_path.iterdir()] == ["m.csv"]


def test_the_next_save_removes_the_part_of_a_killed_one(table, tmp_path):
    path = tmp_path / "m.csv"
    script = (
        "import os, sys; from mlsroad_pipeline.datasets.report_files import ScoresDataset\n"
        "os.replace = lambda *_: os.kill(os.getpid(), 9)\n"
        "ScoresDataset(filepath=sys.argv[1]).write_bytes(b'half')"
    )
    subprocess.run([sys.executable, "-c", script, str(path)], check=False)
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".m.csv.")
    ScoresDataset(filepath=str(path)).save(table)
    assert [found.name for found in tmp_path.iterdir()] == ["m.csv"]


def test_broken_scores_are_refused_on_both_ways_and_named(table, tmp_path):
    dataset = ScoresDataset(filepath=str(tmp_path / "m.csv"))
    with pytest.raises(DatasetError, match=r"m.csv: unknown metric 'accuracy'"):
        dataset.save(table.assign(metric="accuracy"))
    assert not dataset.exists()
    for text, message in (("", "not a table of scores"), ("a,b\n1,2\n", "columns must be"), ("a\n1,2,3\n", "m.csv")):
        (tmp_path / "m.csv").write_text(text)
        with pytest.raises(DatasetError, match=message):
            dataset.load()


def test_series_come_back_and_others_are_refused(tmp_path):
    dataset = MetricSeriesDataset(filepath=str(tmp_path / "objective.csv"))
    series = pd.DataFrame({"iteration": [0, 1, 2], "objective": [9.0, 4.5, 1 / 3]})
    dataset.save(series)
    pd.testing.assert_frame_equal(dataset.load(), series)
    dataset.save(series[:0])  # nothing was measured
    pd.testing.assert_frame_equal(dataset.load(), series[:0], check_index_type=False)
    for wrong in (series[["iteration"]], series[["objective", "iteration"]], series.assign(objective="low")):
        with pytest.raises(DatasetError, match=r"objective.csv: needs a column of integer steps"):
            dataset.save(wrong)
    (tmp_path / "objective.csv").write_text("")
    with pytest.raises(DatasetError, match=r"objective.csv: not a table of metrics by step"):
        dataset.load()


@pytest.mark.parametrize("dataset", [ScoresDataset, FigureDataset, HtmlReportDataset, MetricSeriesDataset])
def test_a_missing_file_is_named(dataset, tmp_path):
    with pytest.raises(DatasetError, match=r"gone.* does not exist"):
        dataset(filepath=str(tmp_path / "gone")).load()


def test_a_failed_write_leaves_the_old_file(table, tmp_path, monkeypatch):
    dataset = ScoresDataset(filepath=str(tmp_path / "m.csv"))
    dataset.save(table)
    before = (tmp_path / "m.csv").read_bytes()

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr("mlsroad_pipeline.formats.files.os.replace", fail)
    with pytest.raises(DatasetError, match="disk full"):
        dataset.save(table.head(4))
    assert (tmp_path / "m.csv").read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1


def test_pictures_come_back_and_figures_keep_their_resolution(rng, tmp_path):
    dataset = FigureDataset(filepath=str(tmp_path / "a.png"))
    picture = rng.integers(0, 256, (5, 8, 3), dtype=np.uint8)
    dataset.save(picture)
    np.testing.assert_array_equal(dataset.load(), picture)
    dataset.save(oob_figure([1, 2], [0.2, 0.1]))
    assert dataset.load().shape[1] == 6.5 * 150
    small = FigureDataset(filepath=str(tmp_path / "a.png"), dpi=50)
    small.save(oob_figure([1, 2], [0.2, 0.1]))
    assert small.load().shape[1] == 6.5 * 50


def test_the_same_figure_gives_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        FigureDataset(filepath=str(tmp_path / f"{name}.png")).save(oob_figure([1, 2], [0.2, 0.1]))
    content = (tmp_path / "a.png").read_bytes()
    assert content == (tmp_path / "b.png").read_bytes()
    assert b"atplotlib" not in content


@pytest.mark.parametrize("data", [np.zeros((2, 2, 3)), np.zeros((2, 2), np.uint8), "a.png"])
def test_what_is_no_figure_is_refused(data, tmp_path):
    with pytest.raises(DatasetError, match="needs a figure or a uint8 array"):
        FigureDataset(filepath=str(tmp_path / "a.png")).save(data)


def test_a_file_that_is_no_picture_is_named(tmp_path):
    (tmp_path / "a.png").write_text("no")
    with pytest.raises(DatasetError, match=r"a.png is not a picture"):
        FigureDataset(filepath=str(tmp_path / "a.png")).load()


def test_reports_come_back_and_other_text_is_refused(tmp_path):
    dataset = HtmlReportDataset(filepath=str(tmp_path / "r.html"))
    page = "<!DOCTYPE html>\n<html>Straße</html>\n"
    dataset.save(page)
    assert dataset.load() == page
    with pytest.raises(DatasetError, match=r"r.html: .*got 'plain'"):
        dataset.save("plain")
