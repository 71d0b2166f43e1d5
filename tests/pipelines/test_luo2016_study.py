"""Study of luo2016 at its fast scale: tables, and a second run that computes nothing."""

import mlflow
import numpy as np
import pandas as pd
import pytest
from helpers.wiring import make_project, run, stage_counts, tracked_runs

from mlsroad_pipeline.papers.luo2016.study.runs import METHODS

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

GRID = {"smoothness": [0.1, 0.8, 6.4], "colour_decay": [0.0]}
FAST = {
    "luo2016_study": {"scale": "fast"},
    "patch_graph_mrf": GRID,
    "patch_graph_mrf_printed": GRID,
    "execution": {"backend": "sequential"},
}


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = make_project(tmp_path_factory.mktemp("study"))
    run(folder, "luo2016_study", **FAST)
    return folder


def table(project, name):
    return pd.read_csv(project / f"data/08_reporting/luo2016_study/{name}.csv")


def test_tables_hold_every_method_and_setting(project):
    three = table(project, "table_3")
    assert list(dict.fromkeys(three["method"])) == list(METHODS)
    by_shape = three["method"].isin(["shape_based", "shape_based_printed"])
    dash = three[by_shape & three["class"].isin(["road", "grass", "mean of seven"])]
    assert len(dash) == 18 and dash["mean"].isna().all()
    road = three[(three["class"] == "road") & (three["metric"] == "f1") & ~by_shape]
    assert (road["mean"] > 0.5).all() and (road["repetitions"] == 2).all()
    assert table(project, "patch_size")["value"].tolist() == [0.2, 0.4]
    assert table(project, "search_radius")["value"].tolist() == [0.5, 1.0]
    one = table(project, "table_1").set_index("class")
    assert one["points"].sum() > 10_000 and one.loc["vehicle", "paper_objects"] == 99
    pairs = table(project, "pairs")
    assert len(pairs) == len(METHODS) * (len(METHODS) - 1) / 2
    times = table(project, "times").set_index("method")
    assert list(times.index) == list(METHODS)
    assert times.loc["patch_graph_mrf", "train_seconds"] >= times.loc["patch_graph", "train_seconds"] > 0


def test_the_mean_in_the_scores_is_that_of_its_classes_without_other(project):
    scores = table(project, "scores")
    mine = scores[(scores["method"] == "patch_forest") & (scores["split"] == "test_11")]
    f1 = mine[(mine["metric"] == "f1")].set_index("class")["value"]
    assert "other" not in f1.index and len(f1) == 7
    assert mine[mine["metric"] == "mean_f1"]["value"].item() == pytest.approx(np.nanmean(f1))


def test_report_and_tracked_run_hold_the_figures(project):
    page = (project / "data/08_reporting/luo2016_study/report.html").read_text(encoding="utf-8")
    assert "(0.862)" in page and page.count("data:image/") == 4
    runs, client = tracked_runs(project), mlflow.MlflowClient(f"sqlite:///{project / 'mlflow.db'}")
    steps = client.get_metric_history(runs["luo2016_study"].info.run_id, "by_size/patch_size_objective")
    scores = table(project, "scores").set_index(["method", "split", "class", "metric"])["value"]
    found = client.search_runs(
        [runs["luo2016_study"].info.experiment_id],
        "tags.`mlsroad.method` = 'patch_graph_mrf' and tags.`mlsroad.data` = 'test_11'",
    )
    assert [run.info.run_name for run in found] == ["patch_graph_mrf on test_11"] and len(found[0].data.params) <= 60
    assert found[0].data.metrics["f1/grass"] == pytest.approx(scores["patch_graph_mrf", "test_11", "grass", "f1"])
    assert [step.step for step in steps] == [200, 400]


def test_a_second_run_computes_nothing_and_a_tried_setting_only_what_is_new(project, caplog):
    caplog.set_level("INFO")
    tuning = {"patch_forest": [{"max_depth": 2}, {"max_depth": 15}]}
    study = {**FAST["luo2016_study"], "scales": {"fast": {"tuning": tuning}}}
    run(project, "luo2016_study", **{**FAST, "luo2016_study": study})
    counts = stage_counts(caplog.messages)
    assert counts["streets"] == (0, 4) and counts["tried"] == (2, 0)
    assert counts["runs"][0] <= 1  # the forest, if the setting that was chosen is not the one before
    tried = table(project, "tuning")
    assert len(tried) == 2 and tried["chosen"].sum() == 1
    assert tried.loc[tried["chosen"], "mean_f1"].item() == tried["mean_f1"].max()
